"""The Brown-Conrady camera: perspective with radial and tangential distortion, OpenCV's default model."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from olt_generator.lenses.camera_model import FocalCamera, Mask, inside_image
from olt_generator.lenses.lens_curves import Polynomial, derivative, evaluate, invert_rising, smallest_positive_root
from olt_generator.lenses.pinhole import NEAREST_DEPTH, WIDEST_FIELD_OF_VIEW
from olt_generator.poses import Array

_MAX_STEPS = 50
_CONVERGED = 1e-14
# Share of the largest distorted radius up to which the search may start where the radial terms alone put it.
_SURELY_REACHED = 0.999
# A pixel whose ray misses it by more than this share of a focal length has no ray.
_MISSED = 1e-11


@dataclass(frozen=True)
class BrownConradyCamera(FocalCamera):
    """A perspective camera whose lens bends straight lines.

    With x, y on the image plane at depth 1 and s = x^2 + y^2 the distorted point is (OpenCV, calib3d)
        x g(s) + 2 p1 x y + p2 (s + 2 x^2),  y g(s) + p1 (s + 2 y^2) + 2 p2 x y,
        g(s) = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3).

    Beyond some angle most such polynomials turn back, and points from outside the view would fold into the image:
    the model ends where the radius stops growing, and nothing beyond is seen.

    Attributes:
        k1, k2, p1, p2, k3, k4, k5, k6: distortion in OpenCV's order.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0

    def project(self, points_camera: Array) -> tuple[Array, Mask]:
        """See `Camera.project`; the range ends where the lens would fold."""
        z = points_camera[..., 2]
        in_front = z > NEAREST_DEPTH
        safe = np.where(in_front, z, 1.0)
        pixels = np.empty((*z.shape, 2))
        with np.errstate(invalid="ignore", over="ignore"):
            x, y = points_camera[..., 0] / safe, points_camera[..., 1] / safe
            distorted_x, distorted_y = self._distort(x, y)
            pixels[..., 0] = self.fx * distorted_x + self.cx
            pixels[..., 1] = self.fy * distorted_y + self.cy
            in_range = in_front & self._unfolded(x, y)
        return pixels, in_range & inside_image(pixels[..., 0], pixels[..., 1], self.width, self.height)

    def rays(self, pixels: Array) -> Array:
        """See `Camera.rays`."""
        wanted_x, wanted_y = (pixels[..., 0] - self.cx) / self.fx, (pixels[..., 1] - self.cy) / self.fy
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            x, y = self._undistort(wanted_x, wanted_y)
            distorted_x, distorted_y = self._distort(x, y)
            missed = np.hypot(distorted_x - wanted_x, distorted_y - wanted_y)
            reached = (missed <= _MISSED * (1.0 + np.hypot(wanted_x, wanted_y))) & self._unfolded(x, y)
        ray = np.stack([x, y, np.ones_like(x)], axis=-1)
        return np.where(reached[..., None], ray / np.linalg.norm(ray, axis=-1, keepdims=True), np.nan)

    @property
    def _gain_polynomials(self) -> tuple[Polynomial, Polynomial]:
        """Numerator and denominator of g."""
        return (1.0, self.k1, self.k2, self.k3), (1.0, self.k4, self.k5, self.k6)

    @cached_property
    def _max_radius(self) -> float:
        """Undistorted radius at depth 1 up to which the distorted radius r g(r^2) grows."""
        numerator, denominator = (np.polynomial.Polynomial(part) for part in self._gain_polynomials)
        s = np.polynomial.Polynomial([0.0, 1.0])
        # The derivative of r g(r^2) by r has the sign of this.
        slope = numerator * denominator + 2.0 * s * (numerator.deriv() * denominator - numerator * denominator.deriv())
        turn, pole = (smallest_positive_root(tuple(part.coef.tolist())) for part in (slope, denominator))
        return min(float(np.sqrt(min(turn, pole))), float(np.tan(0.5 * WIDEST_FIELD_OF_VIEW)))

    def _gain_and_slope(self, s: Array) -> tuple[Array, Array]:
        """g(s) and its derivative."""
        numerator, denominator = self._gain_polynomials
        below = evaluate(denominator, s)
        gain = evaluate(numerator, s) / below
        return gain, (evaluate(derivative(numerator), s) - gain * evaluate(derivative(denominator), s)) / below

    def _distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        s, xy = x * x + y * y, x * y
        numerator, denominator = self._gain_polynomials
        gain = evaluate(numerator, s) / evaluate(denominator, s)
        return (
            x * gain + 2.0 * self.p1 * xy + self.p2 * (s + 2.0 * x * x),
            y * gain + self.p1 * (s + 2.0 * y * y) + 2.0 * self.p2 * xy,
        )

    def _jacobian(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Derivatives xx, xy = yx and yy of the distorted point; the matrix is symmetric."""
        gain, slope = self._gain_and_slope(x * x + y * y)
        return (
            gain + 2.0 * x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            2.0 * (x * y * slope + self.p1 * x + self.p2 * y),
            gain + 2.0 * y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        )

    def _unfolded(self, x: Array, y: Array) -> Mask:
        """Which undistorted points lie in the model's range; tangential terms move its edge a little."""
        xx, xy, yy = self._jacobian(x, y)
        return (x * x + y * y <= self._max_radius**2) & (xx * yy > xy * xy)

    def _undistort_radially(self, wanted_x: Array, wanted_y: Array) -> tuple[Array, Array]:
        """The point without tangential terms; what the lens hardly or never reaches is pulled in."""

        def curve(r: Array) -> tuple[Array, Array]:
            gain, slope = self._gain_and_slope(r * r)
            return r * gain, gain + 2.0 * r * r * slope

        wanted = np.hypot(wanted_x, wanted_y)
        within = np.minimum(wanted, _SURELY_REACHED * curve(np.array(self._max_radius))[0])
        shrink = invert_rising(curve, within, within, self._max_radius) / np.where(wanted > 0.0, wanted, 1.0)
        return wanted_x * shrink, wanted_y * shrink

    def _undistort(self, wanted_x: Array, wanted_y: Array) -> tuple[Array, Array]:
        """Newton's method in two dimensions on the points that still move."""
        x, y = (part.ravel() for part in self._undistort_radially(wanted_x, wanted_y))
        moving = np.arange(x.size)
        for _ in range(_MAX_STEPS):
            here_x, here_y = x[moving], y[moving]
            distorted_x, distorted_y = self._distort(here_x, here_y)
            error_x, error_y = distorted_x - wanted_x.ravel()[moving], distorted_y - wanted_y.ravel()[moving]
            xx, xy, yy = self._jacobian(here_x, here_y)
            determinant = xx * yy - xy * xy
            step_x = (yy * error_x - xy * error_y) / determinant
            step_y = (xx * error_y - xy * error_x) / determinant
            x[moving], y[moving] = here_x - step_x, here_y - step_y
            moving = moving[np.hypot(step_x, step_y) > _CONVERGED * (1.0 + np.hypot(here_x, here_y))]
        return x.reshape(wanted_x.shape), y.reshape(wanted_y.shape)
