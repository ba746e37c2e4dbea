"""The f-theta camera: a lens whose image radius is a polynomial of the angle from the optical axis."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from olt_generator.errors import InputError
from olt_generator.lenses.camera_model import Camera, Mask, inside_image
from olt_generator.lenses.lens_curves import (
    Polynomial,
    curve_of,
    derivative,
    evaluate,
    fit_through_origin,
    invert_rising,
    smallest_positive_root,
)
from olt_generator.poses import Array

# What calibration tables hold (docs/formats/physicalai_av.md).
TABLE_DEGREE = 4
_FIT_NODES = 400


@dataclass(frozen=True)
class FthetaCamera(Camera):
    """A fisheye camera whose image radius is a polynomial of the angle from the optical axis.

    Calibrations come with a polynomial for each direction, and the two undo each other to a hundredth of a pixel or
    so. Here one of them, the primary, is the lens; the other direction is solved from it to machine precision, and
    the other polynomial only gives the start.

    Attributes:
        width, height: image size in pixels.
        cx, cy: principal point in pixels.
        fw_poly: angle (rad) to radius (px), ascending powers, constant term 0.
        bw_poly: radius (px) to angle (rad), ascending powers, constant term 0.
        max_angle: largest angle from the axis, radians, at which the model is trusted; inf for as far as the primary
            polynomial rises. Nothing lies beyond half a turn.
        aspect: height of a pixel over its width; other than 1 only in images stretched on one side.
        primary: which polynomial is the lens. The tables of PhysicalAI-AV do not say: taken as "forward", by which
            they project. The measured rig calibrations give the backward one alone.

    The names are those of the PhysicalAI-AV calibration tables (docs/formats/physicalai_av.md).

    Raises:
        InputError: a polynomial does not start at 0, or the primary one does not rise as far as `max_angle`.
    """

    width: int
    height: int
    cx: float
    cy: float
    fw_poly: Polynomial
    bw_poly: Polynomial
    max_angle: float = np.inf
    aspect: float = 1.0
    primary: Literal["forward", "backward"] = "forward"

    def __post_init__(self) -> None:
        for polynomial in (self.fw_poly, self.bw_poly):
            if len(polynomial) < 2 or polynomial[0] != 0.0:
                raise InputError(f"f-theta lens: polynomial {polynomial} must have constant term 0 and a linear term")
        linear = self._primary_polynomial[1]
        if not linear > 0.0:
            raise InputError(f"f-theta lens: the {self.primary} polynomial falls from the axis on (linear {linear})")
        rises_to = self._rises_to
        if np.isfinite(self.max_angle) and self.max_angle > rises_to * (1.0 + 1e-9):
            raise InputError(
                f"f-theta lens: the {self.primary} polynomial rises only to {np.degrees(rises_to):.1f} degrees from "
                f"the axis, not to {np.degrees(self.max_angle):.1f}; give a smaller max_angle or another polynomial"
            )

    @classmethod
    def equidistant(cls, width: int, height: int, cx: float, cy: float, pixels_per_radian: float) -> "FthetaCamera":
        """The lens whose radius is proportional to the angle; both polynomials are exact inverses."""
        forward = (0.0, pixels_per_radian, 0.0, 0.0, 0.0)
        return cls(width, height, cx, cy, forward, (0.0, 1.0 / pixels_per_radian, 0.0, 0.0, 0.0))

    @classmethod
    def from_radius_to_angle(cls, width: int, height: int, cx: float, cy: float, bw_poly: Polynomial) -> "FthetaCamera":
        """The lens of a backward polynomial alone; the forward one is fitted to it over the image.

        Raises:
            InputError: the polynomial does not start at 0 or does not rise over the image.
        """
        reach = float(np.hypot(max(cx + 0.5, width - 0.5 - cx), max(cy + 0.5, height - 0.5 - cy)))
        if smallest_positive_root(derivative(bw_poly)) < reach:
            raise InputError(f"f-theta lens: polynomial {bw_poly} does not rise to the corner at {reach:.0f} px")
        radii = np.linspace(0.0, reach, _FIT_NODES)
        forward = fit_through_origin(evaluate(bw_poly, radii), radii, TABLE_DEGREE)
        return cls(width, height, cx, cy, forward, bw_poly, primary="backward")

    @property
    def pixels_per_radian(self) -> tuple[float, float]:
        """See `Camera.pixels_per_radian`."""
        linear = self._primary_polynomial[1]
        along_rows = linear if self.primary == "forward" else 1.0 / linear
        return along_rows, along_rows / self.aspect

    def project(self, points_camera: Array) -> tuple[Array, Mask]:
        """See `Camera.project`; the range is `max_angle` and where the primary polynomial rises."""
        x, y, z = points_camera[..., 0], points_camera[..., 1], points_camera[..., 2]
        pixels = np.empty((*z.shape, 2))
        with np.errstate(invalid="ignore", over="ignore"):
            across = np.sqrt(x * x + y * y)
            angle = np.arctan2(across, z)
            # On the axis the direction is undefined and the radius is 0: any divisor serves.
            if self.primary == "forward":
                radius = evaluate(self.fw_poly, angle)
            else:
                start = evaluate(self.fw_poly, angle)
                radius = invert_rising(curve_of(self.bw_poly), angle, start, self._limits[1])
            scale = radius / np.where(across > 0.0, across, 1.0)
            pixels[..., 0] = self.cx + scale * x
            pixels[..., 1] = self.cy + scale * y / self.aspect
        in_range = (angle <= self._limits[0]) & ((across > 0.0) | (z > 0.0))
        return pixels, in_range & inside_image(pixels[..., 0], pixels[..., 1], self.width, self.height)

    def rays(self, pixels: Array) -> Array:
        """See `Camera.rays`."""
        x = pixels[..., 0] - self.cx
        y = (pixels[..., 1] - self.cy) * self.aspect
        radius = np.hypot(x, y)
        inside = np.where(radius <= self._limits[1], radius, np.nan)
        angle = evaluate(self.bw_poly, inside)
        if self.primary == "forward":
            angle = invert_rising(curve_of(self.fw_poly), inside, angle, self._limits[0])
        scale = np.sin(angle) / np.where(radius > 0.0, radius, 1.0)
        return np.stack([scale * x, scale * y, np.cos(angle)], axis=-1)

    def redrawn(
        self, width: int, height: int, scale: tuple[float, float], centre: tuple[float, float]
    ) -> "FthetaCamera":
        """See `Camera.redrawn`; unequal factors are kept exact through `aspect`."""
        right, down = scale
        return replace(
            self,
            width=width,
            height=height,
            cx=centre[0],
            cy=centre[1],
            fw_poly=tuple(c * right for c in self.fw_poly),
            bw_poly=tuple(c / right**power for power, c in enumerate(self.bw_poly)),
            aspect=self.aspect * right / down,
        )

    @property
    def _primary_polynomial(self) -> Polynomial:
        return self.fw_poly if self.primary == "forward" else self.bw_poly

    @property
    def _rises_to(self) -> float:
        """Angle to which the primary polynomial rises, at most pi."""
        turn = smallest_positive_root(derivative(self._primary_polynomial))
        if self.primary == "forward" or not np.isfinite(turn):
            return min(turn, np.pi)
        return min(float(evaluate(self.bw_poly, np.array(turn))), np.pi)

    @cached_property
    def _limits(self) -> tuple[float, float]:
        """Angle (rad) and radius (px) at the end of the model's range."""
        angle = min(self.max_angle, self._rises_to)
        if self.primary == "forward":
            return angle, float(evaluate(self.fw_poly, np.array(angle)))
        # The radius of a point a little beyond the end is not needed exactly: it is out of range by its angle.
        turn = smallest_positive_root(derivative(self.bw_poly))
        highest = turn if np.isfinite(turn) else angle / self.bw_poly[1]
        while evaluate(self.bw_poly, np.array(highest)) < angle:
            highest *= 2.0
        return angle, float(invert_rising(curve_of(self.bw_poly), np.array(angle), np.array(highest), highest))
