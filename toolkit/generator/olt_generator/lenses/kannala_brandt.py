"""The Kannala-Brandt fisheye camera, as OpenCV's fisheye module and most calibration tools use it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from olt_generator.errors import InputError
from olt_generator.lenses.camera_model import FocalCamera, Mask, inside_image
from olt_generator.lenses.lens_curves import (
    Polynomial,
    curve_of,
    derivative,
    evaluate,
    invert_rising,
    smallest_positive_root,
)
from olt_generator.poses import Array


@dataclass(frozen=True)
class KannalaBrandtCamera(FocalCamera):
    """A fisheye camera: the image radius is f (a + k1 a^3 + k2 a^5 + k3 a^7 + k4 a^9) at angle a from the axis.

    Kannala and Brandt, "A generic camera model and calibration method for conventional, wide-angle, and fish-eye
    lenses", PAMI 2006, its radially symmetric part.

    Attributes:
        k1, k2, k3, k4: coefficients of the odd powers.
        max_angle: largest angle from the axis, radians, at which the model is trusted; inf for as far as the
            polynomial rises. Nothing lies beyond half a turn.

    Raises:
        InputError: the polynomial does not rise as far as `max_angle`.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    max_angle: float = np.inf

    def __post_init__(self) -> None:
        rises_to = min(smallest_positive_root(derivative(self._polynomial)), np.pi)
        if np.isfinite(self.max_angle) and self.max_angle > rises_to * (1.0 + 1e-9):
            raise InputError(
                f"Kannala-Brandt lens: its radius grows only to {np.degrees(rises_to):.1f} degrees from the axis, not "
                f"to {np.degrees(self.max_angle):.1f}; give a smaller max_angle or other coefficients"
            )

    def project(self, points_camera: Array) -> tuple[Array, Mask]:
        """See `Camera.project`; the range is `max_angle` and where the polynomial rises."""
        x, y, z = points_camera[..., 0], points_camera[..., 1], points_camera[..., 2]
        pixels = np.empty((*z.shape, 2))
        with np.errstate(invalid="ignore", over="ignore"):
            across = np.sqrt(x * x + y * y)
            angle = np.arctan2(across, z)
            # On the axis the direction is undefined and the radius is 0: any divisor serves.
            scale = evaluate(self._polynomial, angle) / np.where(across > 0.0, across, 1.0)
            pixels[..., 0] = self.cx + self.fx * scale * x
            pixels[..., 1] = self.cy + self.fy * scale * y
        in_range = (angle <= self._limits[0]) & ((across > 0.0) | (z > 0.0))
        return pixels, in_range & inside_image(pixels[..., 0], pixels[..., 1], self.width, self.height)

    def rays(self, pixels: Array) -> Array:
        """See `Camera.rays`."""
        x, y = (pixels[..., 0] - self.cx) / self.fx, (pixels[..., 1] - self.cy) / self.fy
        radius = np.hypot(x, y)
        max_angle, max_radius = self._limits
        inside = np.where(radius <= max_radius, radius, np.nan)
        angle = invert_rising(curve_of(self._polynomial), inside, inside, max_angle)
        scale = np.sin(angle) / np.where(radius > 0.0, radius, 1.0)
        return np.stack([scale * x, scale * y, np.cos(angle)], axis=-1)

    @property
    def _polynomial(self) -> Polynomial:
        return (0.0, 1.0, 0.0, self.k1, 0.0, self.k2, 0.0, self.k3, 0.0, self.k4)

    @cached_property
    def _limits(self) -> tuple[float, float]:
        """Angle (rad) and normalised radius at the end of the model's range."""
        angle = min(self.max_angle, smallest_positive_root(derivative(self._polynomial)), np.pi)
        return angle, float(evaluate(self._polynomial, np.array(angle)))
