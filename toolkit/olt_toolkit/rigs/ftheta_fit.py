"""Camera models as the f-theta polynomials that calibration tables hold.

PhysicalAI-AV tables hold two polynomials of degree 4 without constant term: angle to radius and radius to angle
(docs/formats/physicalai_av.md). An f-theta camera of that degree goes in unchanged. Any other lens is fitted over the
radii that its image reaches; what a radius alone cannot say, such as tangential distortion, is part of the error.
"""

from dataclasses import dataclass, replace

import numpy as np

from olt_generator.cameras import Camera, FthetaCamera
from olt_generator.errors import InputError
from olt_generator.lenses.ftheta import TABLE_DEGREE
from olt_generator.lenses.lens_curves import evaluate, fit_through_origin
from olt_generator.poses import Array

# A pixel that is not square may move no image point further than this, and a fitted lens none further than that.
PIXEL_SHAPE_TOLERANCE = 0.5
LENS_TOLERANCE = 1.0
_NODES = 400
# The error is measured on a grid of pixels with this many to a side.
_GRID = 41


@dataclass(frozen=True)
class FthetaFit:
    """A camera as f-theta polynomials of degree 4, trusted up to its furthest image corner.

    `error` is the largest distance in pixels between the original lens and this one, in either direction.
    """

    camera: FthetaCamera
    error: float


def fit_ftheta(camera: Camera) -> FthetaFit:
    """Express a camera in f-theta polynomials of degree 4.

    Raises:
        InputError: its pixels are not square, its polynomials have a higher degree, or its lens is too wide or too
            bent for them.
    """
    right, down = camera.pixels_per_radian
    # How far taking pixels as square moves the furthest row or column of the image.
    furthest = max(camera.cx, camera.width - camera.cx, camera.cy, camera.height - camera.cy)
    shape_error = float(abs(right / down - 1.0) * furthest)
    if shape_error > PIXEL_SHAPE_TOLERANCE:
        raise InputError(
            f"camera with pixels of aspect {right / down:.4f}: calibration tables hold square pixels only; scale the "
            "images by one factor in both directions"
        )
    if isinstance(camera, FthetaCamera):
        return _convert_ftheta(camera, shape_error)
    return _fit_lens(camera, shape_error)


def _convert_ftheta(camera: FthetaCamera, shape_error: float) -> FthetaFit:
    polynomials = camera.fw_poly, camera.bw_poly
    if any(any(coefficients[TABLE_DEGREE + 1 :]) for coefficients in polynomials):
        raise InputError("f-theta camera: calibration tables hold polynomials of degree 4 without constant term")
    forward, backward = (
        (tuple(coefficients) + (0.0,) * TABLE_DEGREE)[: TABLE_DEGREE + 1] for coefficients in polynomials
    )
    converted = _trusted_to_corner(replace(camera, fw_poly=forward, bw_poly=backward, aspect=1.0))
    return FthetaFit(converted, shape_error)


def _fit_lens(camera: Camera, shape_error: float) -> FthetaFit:
    centre, corner = np.array([camera.cx, camera.cy]), _furthest_corner(camera)
    # Least squares at Chebyshev nodes comes close to the smallest largest error.
    nodes = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    angles = _angle(camera.rays(centre + nodes[:, None] * (corner - centre)))
    radii = nodes * float(np.linalg.norm(corner - centre))
    if np.isnan(angles).any():
        raise InputError(
            f"{type(camera).__name__} of {camera.width} x {camera.height} pixels: its lens does not reach the corners "
            "of the image; crop the images first"
        )
    pixels_per_radian = np.gradient(radii, angles)
    forward = fit_through_origin(angles, radii, TABLE_DEGREE)
    # An error of the angle counts by how far it moves a pixel.
    backward = fit_through_origin(radii, angles, TABLE_DEGREE, pixels_per_radian)
    error = max(
        float(np.abs(evaluate(forward, angles) - radii).max()),
        float(np.abs((evaluate(backward, radii) - angles) * pixels_per_radian).max()),
    )
    _check_error(camera, error, angles)
    fitted = FthetaCamera(camera.width, camera.height, camera.cx, camera.cy, forward, backward)
    error = max(error, _difference(camera, fitted))
    _check_error(camera, error, angles)
    return FthetaFit(_trusted_to_corner(fitted), error + shape_error)


def _check_error(camera: Camera, error: float, angles: Array) -> None:
    if not error <= LENS_TOLERANCE:
        raise InputError(
            f"{type(camera).__name__} of {np.degrees(2 * angles.max()):.0f} degrees across its corners: polynomials "
            f"of degree 4 miss it by {error:.1f} px; give an f-theta camera, a smaller field of view, or a narrower "
            "crop"
        )


def _trusted_to_corner(camera: FthetaCamera) -> FthetaCamera:
    angle = float(_angle(camera.rays(_furthest_corner(camera))))
    if np.isnan(angle):
        raise InputError("f-theta camera: its polynomials do not rise to the corners of the image; give better ones")
    # A hair more, so that rounding does not cut off the corner itself.
    return replace(camera, max_angle=angle * (1.0 + 1e-9))


def _furthest_corner(camera: Camera) -> Array:
    """Pixel (2,) of the image corner that is furthest from the optical axis."""
    right = camera.cx < 0.5 * (camera.width - 1)
    below = camera.cy < 0.5 * (camera.height - 1)
    return np.array([camera.width - 0.5 if right else -0.5, camera.height - 0.5 if below else -0.5])


def _angle(rays: Array) -> Array:
    """Angle (...) of rays (..., 3) from the optical axis, radians."""
    return np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])


def _difference(camera: Camera, fitted: FthetaCamera) -> float:
    """Largest distance in pixels between where the two cameras see the same ray; NaN where one does not reach."""
    columns = np.linspace(-0.5, camera.width - 0.5, _GRID)
    rows = np.linspace(-0.5, camera.height - 0.5, _GRID)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    distances = [
        np.linalg.norm(to.project(by.rays(pixels))[0] - pixels, axis=-1).max()
        for by, to in ((camera, fitted), (fitted, camera))
    ]
    return float(np.max(distances))
