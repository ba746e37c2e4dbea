"""Camera models and the maps between them.

Convention: pixel (u, v) has its origin in the centre of the top-left pixel, u to the right, v down, so the pixel in
row i and column j is sampled at exactly (j, i). Camera axes are x right, y down, z forward. Rays are unit vectors.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.poses import Array

Mask = NDArray[np.bool_]
C = TypeVar("C", bound="Camera")


class Camera(Protocol):
    """What every camera model answers; all models are frozen and hashable."""

    @property
    def width(self) -> int:
        """Image width in pixels."""
        ...

    @property
    def height(self) -> int:
        """Image height in pixels."""
        ...

    def project(self, points_camera: Array) -> tuple[Array, Mask]:
        """Pixels (..., 2) of points (..., 3) and whether each lies in the model's range and inside the image."""
        ...

    def rays(self, pixels: Array) -> Array:
        """Unit rays (..., 3) through pixels (..., 2)."""
        ...

    def resized(self, width: int, height: int) -> Self:
        """The camera of the same view in an image of another size."""
        ...

    def cropped(self, left: int, top: int, width: int, height: int) -> Self:
        """The camera of the image part that starts at column `left` and row `top`; it may reach outside."""
        ...


@dataclass(frozen=True)
class PinholeCamera:
    """An ideal perspective camera.

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

    @classmethod
    def from_field_of_view(cls, width: int, height: int, horizontal_fov: float) -> "PinholeCamera":
        """A centred camera with square pixels and the given horizontal field of view in radians.

        Raises:
            InputError: the field of view is not between 0 and 175 degrees.
        """
        if not 0.0 < horizontal_fov < np.radians(175.0):
            raise InputError(
                f"field of view {np.degrees(horizontal_fov):.1f} degrees: a pinhole camera needs more than 0 and less "
                "than 175; use an f-theta camera for wider lenses"
            )
        focal = 0.5 * width / np.tan(0.5 * horizontal_fov)
        return cls(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    def project(self, points_camera: Array) -> tuple[Array, Mask]:
        """See `Camera.project`; points behind the camera are invalid."""
        z = points_camera[..., 2]
        in_front = z > 1e-9
        safe = np.where(in_front, z, 1.0)
        pixels = np.stack(
            [
                self.fx * points_camera[..., 0] / safe + self.cx,
                self.fy * points_camera[..., 1] / safe + self.cy,
            ],
            axis=-1,
        )
        return pixels, in_front & _inside(pixels, self.width, self.height)

    def rays(self, pixels: Array) -> Array:
        """See `Camera.rays`."""
        x = (pixels[..., 0] - self.cx) / self.fx
        y = (pixels[..., 1] - self.cy) / self.fy
        ray = np.stack([x, y, np.ones_like(x)], axis=-1)
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True)

    def resized(self, width: int, height: int) -> "PinholeCamera":
        """See `Camera.resized`."""
        sx, sy = width / self.width, height / self.height
        return PinholeCamera(
            width, height, self.fx * sx, self.fy * sy, (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5
        )

    def cropped(self, left: int, top: int, width: int, height: int) -> "PinholeCamera":
        """See `Camera.cropped`."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)


@dataclass(frozen=True)
class FthetaCamera:
    """A fisheye camera whose image radius is a polynomial of the angle from the optical axis.

    Attributes:
        width, height: image size in pixels.
        cx, cy: principal point in pixels.
        fw_poly: angle (rad) to radius (px), ascending powers, constant term 0.
        bw_poly: radius (px) to angle (rad), ascending powers, constant term 0; the inverse of `fw_poly`.
        max_angle: largest angle from the axis, radians, at which the model is trusted.
        aspect: height of a pixel over its width; other than 1 only in images stretched on one side.

    The names are those of the PhysicalAI-AV calibration tables (facts sheet pai_dataset, section 7).
    """

    width: int
    height: int
    cx: float
    cy: float
    fw_poly: tuple[float, ...]
    bw_poly: tuple[float, ...]
    max_angle: float = np.pi / 2
    aspect: float = 1.0

    @classmethod
    def equidistant(cls, width: int, height: int, cx: float, cy: float, pixels_per_radian: float) -> "FthetaCamera":
        """The lens whose radius is proportional to the angle; both polynomials are exact inverses."""
        forward = (0.0, pixels_per_radian, 0.0, 0.0, 0.0)
        return cls(width, height, cx, cy, forward, (0.0, 1.0 / pixels_per_radian, 0.0, 0.0, 0.0))

    def project(self, points_camera: Array) -> tuple[Array, Mask]:
        """See `Camera.project`; points beyond `max_angle` are invalid."""
        x, y, z = points_camera[..., 0], points_camera[..., 1], points_camera[..., 2]
        across = np.hypot(x, y)
        angle = np.arctan2(across, z)
        # On the axis the direction is undefined and the radius is 0: any divisor serves.
        scale = np.polynomial.polynomial.polyval(angle, self.fw_poly) / np.where(across > 0.0, across, 1.0)
        pixels = np.stack([self.cx + scale * x, self.cy + scale * y / self.aspect], axis=-1)
        in_range = (angle <= self.max_angle) & ((across > 0.0) | (z > 0.0))
        return pixels, in_range & _inside(pixels, self.width, self.height)

    def rays(self, pixels: Array) -> Array:
        """See `Camera.rays`."""
        x = pixels[..., 0] - self.cx
        y = (pixels[..., 1] - self.cy) * self.aspect
        radius = np.hypot(x, y)
        angle = np.polynomial.polynomial.polyval(radius, self.bw_poly)
        scale = np.sin(angle) / np.where(radius > 0.0, radius, 1.0)
        return np.stack([scale * x, scale * y, np.cos(angle)], axis=-1)

    def resized(self, width: int, height: int) -> "FthetaCamera":
        """See `Camera.resized`; unequal factors are kept exact through `aspect`."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
            fw_poly=tuple(c * sx for c in self.fw_poly),
            bw_poly=tuple(c / sx**power for power, c in enumerate(self.bw_poly)),
            aspect=self.aspect * sx / sy,
        )

    def cropped(self, left: int, top: int, width: int, height: int) -> "FthetaCamera":
        """See `Camera.cropped`."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)


def fit_camera(camera: C, width: int, height: int) -> C:
    """The camera of an image scaled by one factor until it covers (width, height), then cropped about its centre.

    Pixels keep their shape, so an f-theta camera stays one that calibration tables can hold.
    """
    factor = max(width / camera.width, height / camera.height)
    scaled = camera.resized(round(camera.width * factor), round(camera.height * factor))
    return scaled.cropped((scaled.width - width) // 2, (scaled.height - height) // 2, width, height)


def _inside(pixels: Array, width: int, height: int) -> Mask:
    u, v = pixels[..., 0], pixels[..., 1]
    return (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)


@lru_cache(maxsize=32)
def pixel_rays(camera: Camera) -> Array:
    """Unit rays (height, width, 3) through the centre of every pixel; cached and read-only."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
    rays = camera.rays(np.stack([u, v], axis=-1))
    rays.flags.writeable = False
    return rays


def remap_table(source: Camera, target: Camera, R_source_target: Array) -> tuple[NDArray[np.float32], Mask]:
    """Where each pixel of `target` is found in `source` when both share one centre.

    Args:
        source: camera that took the image.
        target: camera whose image is wanted.
        R_source_target: (3, 3) rotation from target axes to source axes.

    Returns:
        A table (height, width, 2) of source pixels as `cv2.remap` takes it, and the mask (height, width) of target
        pixels that the source sees.
    """
    pixels, seen = source.project(pixel_rays(target) @ R_source_target.T)
    return np.where(seen[..., None], pixels, -1e4).astype(np.float32), seen
