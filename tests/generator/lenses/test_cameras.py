"""Camera models: projection and rays undo each other, and derived cameras see what the original sees."""

import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.cameras import (
    BrownConradyCamera,
    FthetaCamera,
    KannalaBrandtCamera,
    PinholeCamera,
    fit_camera,
    pixel_rays,
    remap_table,
)
from olt_generator.errors import InputError

PINHOLE = PinholeCamera(416, 240, 305.0, 312.7, 215.1, 116.5)
WIDEST_PINHOLE = PinholeCamera.from_field_of_view(640, 360, float(np.radians(174.0)))
EQUIDISTANT = FthetaCamera.equidistant(480, 270, 238.2, 189.0, 0.25 / 1.057586e-3)
# Image corners lie 116 degrees from the axis.
BEHIND = FthetaCamera(800, 600, 399.5, 299.5, (0.0, 247.0), (0.0, 1 / 247.0), max_angle=np.pi)
SQUEEZED = EQUIDISTANT.resized(416, 240)
# A measured 120-degree lens: its calibration is the polynomial from radius to angle.
BACKWARD = FthetaCamera.from_radius_to_angle(
    3848, 2168, 1920.0, 1096.9, (0.0, 5.374527536332607e-4, 1.6630015e-9, 2.4465828668551737e-12, 2.18299664e-17)
).resized(962, 542)
BARREL = BrownConradyCamera(512, 388, 421.5, 421.75, 257.0, 191.5, -0.28, -0.033, 4e-4, -3e-4, 0.099)
RATIONAL = BrownConradyCamera(640, 360, 320.0, 320.0, 321.0, 177.0, 0.9, 0.1, 1e-4, 2e-4, 1e-3, 1.25, 0.3, 0.01)
FISHEYE = KannalaBrandtCamera(640, 480, 195.0, 196.0, 320.1, 239.1, -0.02, 0.004, -0.002, 2e-4)
CAMERAS = [
    PINHOLE,
    WIDEST_PINHOLE,
    EQUIDISTANT,
    BEHIND,
    SQUEEZED,
    BACKWARD,
    BACKWARD.resized(416, 240),
    BARREL,
    RATIONAL,
    FISHEYE,
]
# The corners of its image lie where the lens has folded back.
FOLDED = BrownConradyCamera(
    1920, 1080, 1970.0131, 1970.0091, 970.0002, 483.2988, -0.5894, 0.66, 0.0011, -0.001, -1.0088
)


def quintic_camera() -> FthetaCamera:
    """A lens like the real ones, whose two polynomials undo each other to a thousandth of a pixel."""
    forward = (0.0, 940.0, 3.0, -28.0, 6.0)
    angles = np.linspace(0.0, 1.2, 2000)
    radii = np.polynomial.polynomial.polyval(angles, forward)
    powers = np.arange(1, 10)
    backward = np.linalg.lstsq((radii[:, None] / 1000.0) ** powers, angles, rcond=None)[0] / 1000.0**powers
    return FthetaCamera(1920, 1080, 954.2, 757.2, forward, (0.0, *backward), max_angle=1.2)


shares = st.floats(0.0, 1.0)


@pytest.mark.parametrize("camera", CAMERAS)
@settings(max_examples=20, deadline=None)
@given(across=shares, down=shares, distance=st.floats(1e-3, 1e6))
def test_rays_and_projection_undo_each_other(camera, across, down, distance):
    pixel = np.array([across * camera.width - 0.5, down * camera.height - 0.5]) * (1.0 - 1e-12)
    ray = camera.rays(pixel)
    assert np.linalg.norm(ray) == pytest.approx(1.0, abs=1e-12)
    projected, seen = camera.project(distance * ray)
    assert projected == pytest.approx(pixel, abs=1e-6)
    assert seen or min(across, down) < 1e-9 or max(across, down) > 1.0 - 1e-9


@pytest.mark.parametrize("primary", ["forward", "backward"])
def test_the_primary_polynomial_is_the_lens_and_the_other_its_start(primary):
    fitted = quintic_camera()
    poor = replace(fitted, **{"bw_poly" if primary == "forward" else "fw_poly": (0.0, 1e-3)}, primary=primary)
    camera = replace(fitted, primary=primary)
    pixels = np.stack(np.meshgrid(np.arange(0.0, 1920.0, 37.0), np.arange(0.0, 1080.0, 31.0)), axis=-1)
    rays = camera.rays(pixels)
    assert np.abs(camera.project(rays)[0] - pixels)[np.isfinite(rays[..., 0])].max() < 1e-9
    # A start that is far off changes nothing but rounding.
    assert np.allclose(poor.rays(pixels), rays, rtol=0.0, atol=1e-12, equal_nan=True)
    assert np.abs(poor.project(rays)[0] - camera.project(rays)[0])[np.isfinite(rays[..., 0])].max() < 1e-9


def test_a_backward_primary_is_kept_to_the_bit():
    radius, polynomial = 470.0, BACKWARD.bw_poly
    ray = BACKWARD.rays(np.array([BACKWARD.cx + radius, BACKWARD.cy]))
    assert np.arctan2(ray[0], ray[2]) == pytest.approx(np.polynomial.polynomial.polyval(radius, polynomial), abs=1e-15)


@pytest.mark.parametrize("camera", CAMERAS)
@settings(max_examples=20)
@given(angle=st.floats(0.0, 3.2), around=st.floats(0.0, 6.3), distance=st.floats(1e-6, 1e9))
def test_what_is_seen_is_seen_in_its_direction(camera, angle, around, distance):
    ray = np.array([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)])
    pixel, seen = camera.project(distance * ray)
    if seen:
        assert camera.project(distance * camera.rays(pixel))[0] == pytest.approx(pixel, abs=1e-6)
        assert camera.rays(pixel) == pytest.approx(ray, abs=1e-6)


def test_a_lens_of_two_polynomials_is_the_one_of_opencv():
    """The same points through `cv2.projectPoints` and `cv2.fisheye.projectPoints`."""
    random = np.random.default_rng(3)
    points = random.uniform([-0.5, -0.35, 1.0], [0.5, 0.35, 1.0], (200, 3)) * random.uniform(1.0, 50.0, (200, 1))
    for camera in (BARREL, RATIONAL, FOLDED):
        matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        distortion = [getattr(camera, name) for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")]
        expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(distortion))
        pixels, seen = camera.project(points)
        assert np.abs(pixels - expected[:, 0])[seen].max() < 1e-9
        assert seen.any()
    matrix = np.array([[FISHEYE.fx, 0.0, FISHEYE.cx], [0.0, FISHEYE.fy, FISHEYE.cy], [0.0, 0.0, 1.0]])
    distortion = np.array([FISHEYE.k1, FISHEYE.k2, FISHEYE.k3, FISHEYE.k4])
    expected, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), matrix, distortion)
    pixels, seen = FISHEYE.project(points)
    assert np.abs(pixels - expected[:, 0])[seen].max() < 1e-9


def test_points_that_would_fold_into_the_image_are_not_seen():
    angles = np.linspace(0.0, 1.5, 400)
    points = np.stack([np.sin(angles), np.zeros(400), np.cos(angles)], axis=-1)
    pixels, seen = FOLDED.project(points)
    inside = (pixels[:, 0] >= -0.5) & (pixels[:, 0] < 1919.5)
    assert np.all(np.diff(pixels[seen, 0]) > 0.0), "what is seen lies in the order of its angles"
    assert (inside & ~seen).any(), "others would land in the image"
    corner = FOLDED.rays(np.array([[0.0, 1079.0], [960.0, 540.0]]))
    assert np.isnan(corner[0]).all() and np.isfinite(corner[1]).all()
    assert 0.97 < np.isfinite(pixel_rays(FOLDED.resized(192, 108))[..., 0]).mean() < 1.0


def test_lenses_that_do_not_rise_are_refused():
    turning = (0.0, 400.0, 0.0, -100.0)  # turns at 66 degrees
    with pytest.raises(InputError, match=r"rises only to 66\.2 degrees .* not to 80\.0"):
        FthetaCamera(800, 600, 399.5, 299.5, turning, (0.0, 1 / 400.0), max_angle=np.radians(80.0))
    assert not FthetaCamera(800, 600, 399.5, 299.5, turning, (0.0, 1 / 400.0)).project(np.array([3.0, 0.0, 1.0]))[1]
    with pytest.raises(InputError, match="falls from the axis"):
        FthetaCamera(800, 600, 399.5, 299.5, (0.0, -400.0), (0.0, 1 / 400.0))
    with pytest.raises(InputError, match="constant term"):
        FthetaCamera(800, 600, 399.5, 299.5, (1.0, 400.0), (0.0, 1 / 400.0))
    with pytest.raises(InputError, match="does not rise to the corner"):
        FthetaCamera.from_radius_to_angle(800, 600, 399.5, 299.5, (0.0, 2e-3, 0.0, -5e-9))
    with pytest.raises(InputError, match="grows only to"):
        KannalaBrandtCamera(800, 600, 300.0, 300.0, 399.5, 299.5, -0.3, max_angle=2.0)


@pytest.mark.parametrize("camera", [*CAMERAS, FOLDED])
def test_what_has_no_direction_is_not_seen(camera):
    nan, inf = np.nan, np.inf
    points = [[0, 0, 0], [nan, 0, 1], [0, nan, 1], [0, 0, nan], [nan, nan, nan], [inf, 0, 1], [0, -inf, 1], [inf] * 3]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _, seen = camera.project(np.array(points))
        assert not seen.any()
        assert np.isnan(camera.rays(np.full(2, nan))).any()
    far = np.array([[0.0, 0.0, 1e6], [1.0, 1.0, 1e12], [1e-9, 0.0, 1e-6]])
    assert camera.project(far)[1].all()


@pytest.mark.parametrize("camera", [*CAMERAS, FOLDED])
def test_empty_and_deep_arrays_keep_their_shape(camera):
    assert camera.project(np.zeros((0, 3)))[0].shape == (0, 2)
    assert camera.rays(np.zeros((4, 0, 2))).shape == (4, 0, 3)
    pixels, seen = camera.project(np.ones((2, 3, 4, 3)))
    assert pixels.shape == (2, 3, 4, 2) and seen.shape == (2, 3, 4)
    assert hash(camera) == hash(replace(camera))


@pytest.mark.parametrize("degrees", [1.0, 60.0, 120.0, 150.0, 174.9])
def test_round_trip_at_every_field_of_view(degrees):
    """Out to the corner of the image, for a perspective camera and for fisheyes of the same field of view."""
    radians = float(np.radians(degrees))
    per_radian = 1280 / radians
    cameras = (
        PinholeCamera.from_field_of_view(1280, 720, radians),
        FthetaCamera.equidistant(1280, 720, 639.5, 359.5, per_radian),
        KannalaBrandtCamera(1280, 720, per_radian, per_radian, 639.5, 359.5, -0.01, 1e-3),
    )
    pixels = np.stack(np.meshgrid(np.linspace(-0.5, 1279.0, 41), np.linspace(-0.5, 719.0, 23)), axis=-1)
    for camera in cameras:
        projected, seen = camera.project(1e3 * camera.rays(pixels))
        assert np.abs(projected - pixels).max() < 1e-6
        assert seen[1:, 1:].all()


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
@settings(max_examples=12, deadline=None)
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
@settings(max_examples=12, deadline=None)
@given(left=st.integers(-500, 500), top=st.integers(-500, 500), u=st.floats(0, 99), v=st.floats(0, 79))
def test_cropping_shifts_pixels_and_keeps_rays(camera, left, top, u, v):
    cropped = camera.cropped(left, top, 100, 80)
    assert (cropped.width, cropped.height) == (100, 80)
    ray = cropped.rays(np.array([u, v]))
    assert ray == pytest.approx(camera.rays(np.array([u + left, v + top])), abs=1e-12, nan_ok=True)


@pytest.mark.parametrize("camera", CAMERAS)
@settings(max_examples=12, deadline=None)
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
    assert rays.shape == (240, 416, 3)
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


def test_a_lens_with_tangential_distortion_ends_where_it_folds():
    """Seen is where the pixels, followed by differences, keep their orientation, and only there."""
    lens = BrownConradyCamera(4000, 4000, 300.0, 300.0, 1999.5, 1999.5, p1=0.12, p2=-0.05)
    x, y = np.meshgrid(np.linspace(-1.5, 1.5, 61), np.linspace(-1.5, 1.5, 61))

    def pixels(dx, dy):
        return lens.project(np.stack([x + dx, y + dy, np.ones_like(x)], axis=-1))[0]

    right, down = (pixels(*step) - pixels(*(-value for value in step)) for step in ((1e-6, 0.0), (0.0, 1e-6)))
    area = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
    decided = np.abs(area) > 1e-3 * area.max()
    assert ((area < 0.0) & decided).any()
    seen = lens.project(np.stack([x, y, np.ones_like(x)], axis=-1))[1]
    np.testing.assert_array_equal(seen[decided], (area > 0.0)[decided])


@pytest.mark.parametrize(("cx", "cy"), [(300.0, 100.0), (500.0, 480.0), (300.0, 480.0)])
def test_a_backward_lens_must_rise_to_the_farthest_corner(cx, cy):
    reach = max(np.hypot(u - cx, v - cy) for u in (-0.5, 799.5) for v in (-0.5, 599.5))

    def turning_at(radius):
        return (0.0, 2e-3, 0.0, -2e-3 / (3.0 * radius**2))

    FthetaCamera.from_radius_to_angle(800, 600, cx, cy, turning_at(reach + 0.01))
    with pytest.raises(InputError, match=f"does not rise to the corner at {reach:.0f} px"):
        FthetaCamera.from_radius_to_angle(800, 600, cx, cy, turning_at(reach - 0.01))


@pytest.mark.parametrize("primary", ["forward", "backward"])
def test_pixels_per_radian_are_those_around_the_axis(primary):
    lens = FthetaCamera(800, 600, 399.5, 299.5, (0.0, 240.0, 3.0), (0.0, 1 / 250.0, 1e-8), primary=primary)
    lens = lens.redrawn(400, 200, (0.5, 0.25), (199.5, 99.5))
    pixels, seen = lens.project(np.array([[1e-6, 0.0, 1.0], [0.0, 1e-6, 1.0]]))
    assert seen.all()
    expected = {"forward": 240.0, "backward": 250.0}[primary]
    assert lens.pixels_per_radian == pytest.approx((0.5 * expected, 0.25 * expected))
    assert np.diag(pixels - [199.5, 99.5]) * 1e6 == pytest.approx(lens.pixels_per_radian, rel=1e-4)


@pytest.mark.parametrize("primary", ["forward", "backward"])
def test_a_lens_without_a_limit_sees_to_straight_behind_and_no_farther(primary):
    lens = FthetaCamera(800, 600, 399.5, 299.5, (0.0, 100.0), (0.0, 0.01), primary=primary)
    angles = np.array([0.1, 1.6, 3.0, 3.14])
    pixels, seen = lens.project(np.stack([np.sin(angles), np.zeros(4), np.cos(angles)], axis=-1))
    assert seen.all() and pixels[:, 0] == pytest.approx(399.5 + 100.0 * angles)
    rays = lens.rays(np.array([[399.5 + 314.0, 299.5], [399.5 + 315.0, 299.5]]))
    assert rays[0] == pytest.approx([np.sin(3.14), 0.0, np.cos(3.14)]) and np.isnan(rays[1]).all()
