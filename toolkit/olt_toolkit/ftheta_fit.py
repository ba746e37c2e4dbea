"""Camera models as the f-theta polynomials that calibration tables hold.

PhysicalAI-AV tables hold two polynomials of degree 4 without constant term: angle to radius and radius to angle (facts
sheet pai_dataset, section 7). An f-theta camera of that degree goes in unchanged. A pinhole camera, whose radius is
f tan(angle), is fitted over the radii that its image reaches.
"""

from dataclasses import dataclass, replace

import numpy as np

from olt_generator.cameras import Camera, FthetaCamera, PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import Array

DEGREE = 4
# A pixel that is not square may move no image point further than this, and a fitted lens none further than that.
PIXEL_SHAPE_TOLERANCE = 0.5
LENS_TOLERANCE = 1.0
_NODES = 400


@dataclass(frozen=True)
class FthetaFit:
    """A camera as f-theta polynomials of degree 4.

    Attributes:
        camera: the camera; its `max_angle` is that of the furthest image corner.
        error: largest distance in pixels between the original lens and this one, in either direction.
        round_trip: largest distance in pixels between a pixel and itself through both polynomials.
    """

    camera: FthetaCamera
    error: float
    round_trip: float


def fit_ftheta(camera: Camera) -> FthetaFit:
    """Express a camera in f-theta polynomials of degree 4.

    Raises:
        InputError: its pixels are not square, its polynomials have a higher degree, or its lens is too wide for them.
    """
    if isinstance(camera, PinholeCamera):
        return _fit_pinhole(camera)
    if isinstance(camera, FthetaCamera):
        return _convert_ftheta(camera)
    raise InputError(f"{type(camera).__name__}: calibration tables hold f-theta and pinhole cameras only")


def _convert_ftheta(camera: FthetaCamera) -> FthetaFit:
    shape_error = _shape_error(camera, camera.aspect)
    polynomials = camera.fw_poly, camera.bw_poly
    if any(any(coefficients[DEGREE + 1 :]) or coefficients[0] for coefficients in polynomials):
        raise InputError("f-theta camera: calibration tables hold polynomials of degree 4 without constant term")
    forward, backward = (_padded(coefficients) for coefficients in polynomials)
    radii = np.linspace(0.0, _reach(camera), _NODES)
    angles = _evaluate(backward, radii)
    converted = replace(camera, fw_poly=forward, bw_poly=backward, max_angle=float(angles[-1]), aspect=1.0)
    return FthetaFit(converted, shape_error, float(np.abs(_evaluate(forward, angles) - radii).max()))


def _fit_pinhole(camera: PinholeCamera) -> FthetaFit:
    shape_error = _shape_error(camera, camera.fx / camera.fy)
    focal = float(np.sqrt(camera.fx * camera.fy))
    reach = _reach(camera)
    max_angle = float(np.arctan(reach / focal))
    # Least squares at Chebyshev nodes comes close to the smallest largest error.
    nodes = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    angles, radii = max_angle * nodes, reach * nodes
    forward = _fit(angles, focal * np.tan(angles), np.ones(_NODES))
    # An error of the angle counts by how far it moves a pixel: dr/dangle = f (1 + (r/f)^2).
    backward = _fit(radii, np.arctan(radii / focal), focal * (1.0 + (radii / focal) ** 2))
    fitted = FthetaCamera(camera.width, camera.height, camera.cx, camera.cy, forward, backward, max_angle)
    angles, radii = np.linspace(0.0, max_angle, _NODES), np.linspace(0.0, reach, _NODES)
    through = _evaluate(backward, radii)
    error = max(
        np.abs(_evaluate(forward, angles) - focal * np.tan(angles)).max(), np.abs(focal * np.tan(through) - radii).max()
    )
    if error > LENS_TOLERANCE:
        raise InputError(
            f"pinhole camera of {np.degrees(2 * max_angle):.0f} degrees across its corners: polynomials of degree 4 "
            f"miss it by {error:.1f} px; give an f-theta camera, a smaller field of view, or a narrower crop"
        )
    round_trip = np.abs(_evaluate(forward, through) - radii).max()
    return FthetaFit(fitted, float(error + shape_error), float(round_trip))


def _shape_error(camera: FthetaCamera | PinholeCamera, aspect: float) -> float:
    """How far (px) a pixel of this aspect moves the image's furthest row or column when it is taken as square."""
    furthest = max(camera.cx, camera.width - camera.cx, camera.cy, camera.height - camera.cy)
    error = abs(aspect - 1.0) * furthest
    if error > PIXEL_SHAPE_TOLERANCE:
        raise InputError(
            f"camera with pixels of aspect {aspect:.4f}: calibration tables hold square pixels only; scale the images "
            "by one factor in both directions"
        )
    return float(error)


def _reach(camera: FthetaCamera | PinholeCamera) -> float:
    """Distance (px) from the principal point to the furthest image corner."""
    across = max(camera.cx + 0.5, camera.width - 0.5 - camera.cx)
    down = max(camera.cy + 0.5, camera.height - 0.5 - camera.cy)
    return float(np.hypot(across, down))


def _fit(x: Array, y: Array, weights: Array) -> tuple[float, ...]:
    """Weighted least-squares polynomial of degree 4 through the origin, ascending powers."""
    scale = x.max()
    design = np.stack([(x / scale) ** power for power in range(1, DEGREE + 1)], axis=-1)
    coefficients = np.linalg.lstsq(design * weights[:, None], y * weights, rcond=None)[0]
    return (0.0, *(float(value / scale**power) for power, value in enumerate(coefficients, start=1)))


def _evaluate(coefficients: tuple[float, ...], x: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval(x, coefficients), np.float64)


def _padded(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    return (tuple(coefficients) + (0.0,) * DEGREE)[: DEGREE + 1]
