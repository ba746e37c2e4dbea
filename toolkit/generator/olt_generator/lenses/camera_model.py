"""What every camera model answers, and what is the same for all of them.

Convention: pixel (u, v) has its origin in the centre of the top-left pixel, u to the right, v down, so the pixel in
row i and column j is sampled at exactly (j, i). Camera axes are x right, y down, z forward. Rays are unit vectors.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array

Mask = NDArray[np.bool_]
C = TypeVar("C", bound="Camera")


class Camera(ABC):
    """What every camera model answers; all models are frozen and hashable.

    Attributes:
        width, height: image size in pixels.
        cx, cy: column and row in pixels at which the optical axis meets the image.
    """

    width: int
    height: int
    cx: float
    cy: float

    @property
    @abstractmethod
    def pixels_per_radian(self) -> tuple[float, float]:
        """Magnification on the optical axis, along rows of pixels (to the right) and along columns (down)."""

    @abstractmethod
    def project(self, points_camera: Array) -> tuple[Array, Mask]:
        """Pixels (..., 2) of points (..., 3) and whether each lies in the model's range and inside the image.

        Points behind the camera, beyond the model's range, at the camera itself, or not finite are not seen; their
        pixels mean nothing and may be NaN.
        """

    @abstractmethod
    def rays(self, pixels: Array) -> Array:
        """Unit rays (..., 3) through pixels (..., 2); NaN where the model's range does not reach."""

    @abstractmethod
    def redrawn(self, width: int, height: int, scale: tuple[float, float], centre: tuple[float, float]) -> Self:
        """The same lens on an image of another size.

        Args:
            width, height: size of the image in pixels.
            scale: pixels to the right and down for each pixel of this camera.
            centre: where the optical axis meets the image, (u, v).
        """

    def resized(self, width: int, height: int) -> Self:
        """The camera of the same view in an image of another size."""
        sx, sy = width / self.width, height / self.height
        return self.redrawn(width, height, (sx, sy), ((self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5))

    def cropped(self, left: int, top: int, width: int, height: int) -> Self:
        """The camera of the image part that starts at column `left` and row `top`; it may reach outside."""
        return self.redrawn(width, height, (1.0, 1.0), (self.cx - left, self.cy - top))


@dataclass(frozen=True)
class FocalCamera(Camera):
    """A camera with a focal length (pixels) in each direction.

    Attributes:
        width, height: image size in pixels.
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def pixels_per_radian(self) -> tuple[float, float]:
        """See `Camera.pixels_per_radian`."""
        return self.fx, self.fy

    def redrawn(self, width: int, height: int, scale: tuple[float, float], centre: tuple[float, float]) -> Self:
        """See `Camera.redrawn`."""
        fx, fy = self.fx * scale[0], self.fy * scale[1]
        return replace(self, width=width, height=height, fx=fx, fy=fy, cx=centre[0], cy=centre[1])


def fit_camera(camera: C, width: int, height: int) -> C:
    """The camera of an image scaled by one factor until it covers (width, height), then cropped about its centre.

    Pixels keep their shape, so an f-theta camera stays one that calibration tables can hold.
    """
    factor = max(width / camera.width, height / camera.height)
    scaled = camera.resized(round(camera.width * factor), round(camera.height * factor))
    return scaled.cropped((scaled.width - width) // 2, (scaled.height - height) // 2, width, height)


@lru_cache(maxsize=32)
def pixel_rays(camera: Camera) -> Array:
    """Unit rays (height, width, 3) through the centre of every pixel; cached and read-only."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
    rays = camera.rays(np.stack([u, v], axis=-1))
    rays.flags.writeable = False
    return rays


def inside_image(u: Array, v: Array, width: int, height: int) -> Mask:
    """Which pixels (u, v), each (...), lie in an image, from the outer edge of its first to that of its last pixel."""
    return (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
