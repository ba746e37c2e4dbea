"""Camera models: projection and rays undo each other, and derived cameras see what the original sees."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.cameras import FthetaCamera, PinholeCamera, fit_camera, pixel_rays, remap_table
from olt_generator.errors import InputError

PINHOLE = PinholeCamera(832, 480, 610.0, 625.5, 430.2, 233.1)
WIDEST_PINHOLE = PinholeCamera.from_field_of_view(1280, 720, float(np.radians(174.0)))
EQUIDISTANT = FthetaCamera.equidistant(1920, 1080, 954.2, 757.2, 1 / 1.057586e-3)
# Image corners lie 116 degrees from the axis.
BEHIND = FthetaCamera(800, 600, 399.5, 299.5, (0.0, 247.0), (0.0, 1 / 247.0), max_angle=np.pi)
SQUEEZED = EQUIDISTANT.resized(832, 480)
CAMERAS = [PINHOLE, WIDEST_PINHOLE, EQUIDISTANT, BEHIND, SQUEEZED]


def quintic_camera() -> FthetaCamera:
    """A lens like the real ones, whose backward polynomial is fitted to the forward one."""
    forward = (0.0, 940.0, 3.0, -28.0, 6.0)
    angles = np.linspace(0.0, 1.2, 2000)
    radii = np.polynomial.polynomial.polyval(angles, forward)
    powers = np.arange(1, 10)
    backward = np.linalg.lstsq((radii[:, None] / 1000.0) ** powers, angles, rcond=None)[0] / 1000.0**powers
    return FthetaCamera(1920, 1080, 954.2, 757.2, forward, (0.0, *backward), max_angle=1.2)


shares = st.floats(0.0, 1.0)


@pytest.mark.parametrize("camera", CAMERAS)
@settings(max_examples=60, deadline=None)
@given(across=shares, down=shares, distance=st.floats(1e-3, 1e6))
def test_rays_and_projection_undo_each_other(camera, across, down, distance):
    pixel = np.array([across * camera.width - 0.5, down * camera.height - 0.5]) * (1.0 - 1e-12)
    ray = camera.rays(pixel)
    assert np.linalg.norm(ray) == pytest.approx(1.0, abs=1e-12)
    projected, seen = camera.project(distance * ray)
    assert projected == pytest.approx(pixel, abs=1e-6)
    assert seen or min(across, down) < 1e-9 or max(across, down) > 1.0 - 1e-9


def test_a_fitted_backward_polynomial_undoes_the_forward_one():
    camera = quintic_camera()
    pixels = np.stack(np.meshgrid(np.arange(0.0, 1920.0, 37.0), np.arange(0.0, 1080.0, 31.0)), axis=-1)
    projected, seen = camera.project(camera.rays(pixels))
    assert np.abs(projected - pixels)[seen].max() < 1e-3
    assert seen.mean() > 0.95


def test_the_axis_projects_to_the_principal_point():
    for camera in CAMERAS:
        pixel, seen = camera.project(np.array([0.0, 0.0, 3.0]))
        assert pixel == pytest.approx([camera.cx, camera.cy])
        assert seen
        assert camera.rays(np.array([camera.cx, camera.cy])) == pytest.approx([0.0, 0.0, 1.0])


def test_points_behind_a_camera_are_not_seen():
    assert not PINHOLE.project(np.array([0.0, 0.0, -1.0]))[1]
    assert not PINHOLE.project(np.array([1.0, 0.0, 0.0]))[1]
    assert not EQUIDISTANT.project(np.array([0.0, 0.0, -1.0]))[1]
    assert not BEHIND.project(np.array([0.0, 0.0, -1.0]))[1]
    assert not BEHIND.project(np.zeros(3))[1]


def test_a_fisheye_sees_beyond_a_right_angle_as_far_as_it_is_trusted():
    ray = np.array([np.sin(1.6), 0.0, np.cos(1.6)])
    pixel, seen = BEHIND.project(5.0 * ray)
    assert seen
    assert BEHIND.rays(pixel) == pytest.approx(ray)
    trusted_less = FthetaCamera(800, 600, 399.5, 299.5, BEHIND.fw_poly, BEHIND.bw_poly, max_angle=1.5)
    assert not trusted_less.project(5.0 * ray)[1]


def test_points_outside_the_image_are_not_seen():
    for camera in (PINHOLE, EQUIDISTANT):
        corners = np.array([[-0.6, 5.0], [camera.width - 0.4, 5.0], [5.0, -0.6], [5.0, camera.height - 0.4]])
        assert not camera.project(camera.rays(corners))[1].any()
        inside = np.array([[-0.4, 5.0], [camera.width - 0.6, 5.0], [5.0, -0.4], [5.0, camera.height - 0.6]])
        assert camera.project(camera.rays(inside))[1].all()


@pytest.mark.parametrize("camera", CAMERAS)
@settings(max_examples=30, deadline=None)
@given(width=st.integers(16, 3000), height=st.integers(16, 2000), across=shares, down=shares)
def test_resizing_keeps_the_rays_of_the_edges(camera, width, height, across, down):
    """A point at a share of the image, counted from pixel edge to pixel edge, stays at that share."""
    resized = camera.resized(width, height)
    before = camera.rays(np.array([across * camera.width - 0.5, down * camera.height - 0.5]))
    after = resized.rays(np.array([across * width - 0.5, down * height - 0.5]))
    assert after == pytest.approx(before, abs=1e-9)


@pytest.mark.parametrize("camera", CAMERAS)
def test_resizing_there_and_back_changes_nothing(camera):
    back = camera.resized(317, 211).resized(camera.width, camera.height)
    assert np.abs(pixel_rays(back) - pixel_rays(camera)).max() < 1e-12


@pytest.mark.parametrize("camera", CAMERAS)
@settings(max_examples=30, deadline=None)
@given(left=st.integers(-500, 500), top=st.integers(-500, 500), u=st.floats(0, 99), v=st.floats(0, 79))
def test_cropping_shifts_pixels_and_keeps_rays(camera, left, top, u, v):
    cropped = camera.cropped(left, top, 100, 80)
    assert (cropped.width, cropped.height) == (100, 80)
    ray = cropped.rays(np.array([u, v]))
    assert ray == pytest.approx(camera.rays(np.array([u + left, v + top])), abs=1e-12, nan_ok=True)


@pytest.mark.parametrize("camera", CAMERAS)
@settings(max_examples=30, deadline=None)
@given(width=st.integers(50, 1200), height=st.integers(50, 1200))
def test_fitting_covers_the_image_and_keeps_pixels_square(camera, width, height):
    fitted = fit_camera(camera, width, height)
    assert (fitted.width, fitted.height) == (width, height)
    corners = np.array([[0.0, 0.0], [width - 1.0, 0.0], [0.0, height - 1.0], [width - 1.0, height - 1.0]])
    pixels, _ = camera.project(fitted.rays(corners))
    # Every corner pixel of the fitted image lies in the original image, within the rounding of the scaled size.
    slack = 1.5 * max(camera.width / width, camera.height / height)
    assert np.all(pixels > -0.5 - slack)
    assert np.all(pixels < np.array([camera.width, camera.height]) - 0.5 + slack)
    # One factor for both axes: as many columns as rows per original pixel, within that rounding.
    spacing = (pixels[3] - pixels[0]) / (np.array([width, height]) - 1.0)
    assert spacing[0] == pytest.approx(spacing[1], rel=3.0 / min(width, height))


def test_field_of_view_of_a_pinhole():
    camera = PinholeCamera.from_field_of_view(640, 360, float(np.radians(70.0)))
    rays = camera.rays(np.array([[-0.5, 179.5], [639.5, 179.5]]))
    assert np.degrees(np.arccos(rays[0] @ rays[1])) == pytest.approx(70.0)
    assert camera.fx == camera.fy


@pytest.mark.parametrize("degrees", [0.0, -10.0, 175.0, 200.0, np.nan])
def test_impossible_fields_of_view_are_refused(degrees):
    with pytest.raises(InputError, match="field of view"):
        PinholeCamera.from_field_of_view(640, 360, float(np.radians(degrees)))


def test_pixel_rays_are_the_rays_of_pixel_centres_and_read_only():
    rays = pixel_rays(SQUEEZED)
    assert rays.shape == (480, 832, 3)
    assert rays[17, 400] == pytest.approx(SQUEEZED.rays(np.array([400.0, 17.0])))
    with pytest.raises(ValueError, match="read-only"):
        rays[0, 0] = 0.0


def test_remap_table_points_at_the_same_ray():
    source, target = EQUIDISTANT, PinholeCamera.from_field_of_view(200, 120, float(np.radians(60.0)))
    R_source_target = Rotation.from_euler("y", 40.0, degrees=True).as_matrix()
    table, seen = remap_table(source, target, R_source_target)
    assert table.dtype == np.float32
    assert 0.3 < seen.mean() < 1.0  # the view reaches 70 degrees to the side, the source image 58
    in_source = source.rays(table.astype(np.float64)) @ R_source_target
    assert np.abs(in_source - pixel_rays(target))[seen].max() < 1e-6
    assert np.all(table[~seen] < -1000.0)
