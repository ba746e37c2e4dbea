import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.cameras import BrownConradyCamera, FthetaCamera, KannalaBrandtCamera, PinholeCamera, pixel_rays
from olt_generator.errors import InputError
from olt_toolkit.rigs.ftheta_fit import fit_ftheta
from olt_toolkit.rigs.rig_files import pav_rig


def round_trip(camera):
    """Largest distance in pixels between a radius and itself through both polynomials, out to the furthest corner."""
    half_diagonals = [np.hypot(x - camera.cx, y - camera.cy) for x in (0, camera.width) for y in (0, camera.height)]
    radii = np.linspace(0.0, max(half_diagonals) - 0.5, 400)
    angles = np.polynomial.polynomial.polyval(radii, camera.bw_poly)
    return np.abs(np.polynomial.polynomial.polyval(angles, camera.fw_poly) - radii).max()


def largest_distance(pixels_a, pixels_b):
    return float(np.linalg.norm(pixels_a - pixels_b, axis=-1).max())


@settings(max_examples=25, deadline=None)
@given(st.floats(20.0, 60.0), st.sampled_from([(576, 320), (112, 64), (416, 125)]))
def test_fitted_pinhole_is_the_pinhole_to_a_twentieth_of_a_pixel(fov, size):
    pinhole = PinholeCamera.from_field_of_view(*size, np.radians(fov))
    fit = fit_ftheta(pinhole)
    pixels, _ = fit.camera.project(pixel_rays(pinhole))
    grid = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), axis=-1)
    assert round_trip(fit.camera) < 0.05
    assert largest_distance(pixels, grid) <= 1.01 * fit.error + 1e-9
    assert fit.error < 0.05
    back, _ = pinhole.project(pixel_rays(fit.camera))
    assert largest_distance(back, grid) <= 1.01 * fit.error + 1e-9


def test_stated_error_grows_with_the_field_of_view_and_is_true():
    pinhole = PinholeCamera.from_field_of_view(576, 320, np.radians(95.0))
    fit = fit_ftheta(pinhole)
    pixels, _ = fit.camera.project(pixel_rays(pinhole))
    grid = np.stack(np.meshgrid(np.arange(576), np.arange(320)), axis=-1)
    assert 0.05 < largest_distance(pixels, grid) <= 1.01 * fit.error + 1e-9


def test_too_wide_a_pinhole_is_refused_in_words():
    with pytest.raises(InputError, match="degree 4 miss it by"):
        fit_ftheta(PinholeCamera.from_field_of_view(576, 320, np.radians(150.0)))


def test_rig_cameras_go_in_unchanged_at_any_output_size():
    for size in [(576, 320), (832, 480), (112, 64)]:
        for name, mounted in pav_rig().fitted(*size).cameras.items():
            fit = fit_ftheta(mounted.camera)
            assert fit.camera.fw_poly == mounted.camera.fw_poly, name
            assert fit.error < 0.5
            assert round_trip(fit.camera) < 1e-6


@pytest.mark.parametrize(
    "camera",
    [
        KannalaBrandtCamera(576, 320, 280.0, 280.0, 288.0, 161.0, -0.02, 0.004, -0.002, 2e-4),
        BrownConradyCamera(576, 320, 474.0, 474.0, 289.0, 158.0, -0.28, -0.033, 1e-4, -1e-4, 0.099),
    ],
)
def test_other_lenses_are_fitted_with_an_error_that_is_true(camera):
    fit = fit_ftheta(camera)
    pixels, _ = fit.camera.project(pixel_rays(camera))
    grid = np.stack(np.meshgrid(np.arange(576), np.arange(320)), axis=-1)
    assert largest_distance(pixels, grid) <= 1.05 * fit.error + 1e-9
    assert fit.error < 0.6


def test_a_lens_with_much_tangential_distortion_is_refused():
    with pytest.raises(InputError, match="degree 4 miss it by"):
        fit_ftheta(BrownConradyCamera(576, 320, 474.0, 474.0, 289.0, 158.0, -0.28, -0.033, 1e-2, -1e-2, 0.099))


def test_a_lens_that_does_not_reach_its_corners_is_refused():
    with pytest.raises(InputError, match="does not reach the corners"):
        fit_ftheta(BrownConradyCamera(576, 320, 474.0, 474.0, 289.0, 158.0, -1.5))


def test_stretched_pixels_are_refused():
    camera = FthetaCamera.equidistant(192, 108, 96.0, 54.0, 95.0).resized(192, 120)
    with pytest.raises(InputError, match="square pixels"):
        fit_ftheta(camera)
    with pytest.raises(InputError, match="square pixels"):
        fit_ftheta(PinholeCamera(576, 320, 500.0, 520.0, 288.0, 160.0))


def test_higher_degree_is_refused():
    camera = FthetaCamera(100, 60, 50.0, 30.0, (0.0, 50.0, 0.0, 0.0, 0.0, 1e-3), (0.0, 0.02))
    with pytest.raises(InputError, match="degree 4"):
        fit_ftheta(camera)


def test_measured_lenses_keep_their_polynomials(shared_real):
    text = (shared_real / "nvidia_seven_camera_rig_calibration" / "median_calibration.json").read_text()
    for lens in json.loads(text)["ftheta_intrinsics"].values():
        backward = tuple(lens["pixel_radius_to_angle_poly"])
        radii = np.linspace(0.0, 2300.0, 200)
        angles = np.polynomial.polynomial.polyval(radii, backward)
        powers = np.stack([angles**power for power in range(1, 5)], axis=-1)
        forward = (0.0, *np.linalg.lstsq(powers, radii, rcond=None)[0])
        camera = FthetaCamera(lens["width"], lens["height"], *lens["principal_point_px"], forward, backward)
        fit = fit_ftheta(camera)
        assert fit.camera.bw_poly == backward
        assert round_trip(fit.camera) < 1.0
