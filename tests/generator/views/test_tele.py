"""The tele crop is exact in angle and shows the pixels of the front image."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.sensors.ray_casting import SceneRenderer
from olt_generator.cameras import (
    BrownConradyCamera,
    FthetaCamera,
    KannalaBrandtCamera,
    PinholeCamera,
    pixel_rays,
)
from olt_generator.errors import InputError
from olt_generator.metrics.image_metrics import psnr
from olt_generator.poses import camera_pose_in_rig
from olt_generator.views.tele import crop_tele, tele_camera

PINHOLE = PinholeCamera(832, 480, 600.0, 620.0, 420.3, 250.7)
EQUIDISTANT = FthetaCamera.equidistant(832, 468, 413.4, 327.9, 410.0)
STRETCHED = EQUIDISTANT.resized(832, 480)
BACKWARD = FthetaCamera.from_radius_to_angle(832, 468, 415.0, 230.0, (0.0, 2.4e-3, 3e-8, 2.3e-10))
FISHEYE = KannalaBrandtCamera(832, 480, 400.0, 403.0, 420.0, 240.0, -0.02, 0.004, -0.002, 2e-4)
BARREL = BrownConradyCamera(832, 480, 560.0, 561.0, 418.0, 236.0, -0.28, 0.08, 0.0, 0.0, -0.01)
TANGENTIAL = BrownConradyCamera(832, 480, 560.0, 561.0, 418.0, 236.0, -0.28, 0.08, 2e-3, -1e-3, -0.01)
SYMMETRIC = [PINHOLE, EQUIDISTANT, STRETCHED, BACKWARD, FISHEYE, BARREL]
FRONTS = [*SYMMETRIC, TANGENTIAL]


@pytest.mark.parametrize("front", FRONTS)
@settings(max_examples=20, deadline=None)
@given(width=st.integers(32, 900), field_of_view=st.floats(0.1, 0.8))
def test_outer_column_edges_are_half_the_field_of_view_from_the_axis(front, width, field_of_view):
    tele = tele_camera(front, width, width // 2, field_of_view)
    edges = np.array([[-0.5, tele.cy], [width - 0.5, tele.cy]])
    rays = tele.rays(edges)
    assert np.degrees(np.arctan2(rays[:, 0], rays[:, 2])) == pytest.approx(
        np.degrees([-0.5 * field_of_view, 0.5 * field_of_view]), abs=2e-2 if front is TANGENTIAL else 1e-9
    )


@pytest.mark.parametrize("front", SYMMETRIC)
def test_pixels_are_square_and_the_axis_is_in_the_middle(front):
    tele = tele_camera(front, 576, 320)
    axis = np.array([0.0, 0.0, 1.0])
    assert tele.project(axis)[0] == pytest.approx([287.5, 159.5])
    right, _ = tele.project(np.array([1e-4, 0.0, 1.0]))
    down, _ = tele.project(np.array([0.0, 1e-4, 1.0]))
    assert right[0] - 287.5 == pytest.approx(down[1] - 159.5, rel=1e-6)


@pytest.mark.parametrize("front", FRONTS)
def test_tele_pixels_show_the_front_pixels_of_the_same_ray(front):
    """On an image whose value is a linear function of the pixel, bicubic cropping is exact up to rounding."""
    v, u = np.mgrid[: front.height, : front.width].astype(float)
    ramp = np.stack([u / 4.0, v / 3.0, (u + v) / 6.0], axis=-1)
    tele = tele_camera(front, 576, 320)
    cropped = crop_tele(np.rint(ramp).astype(np.uint8)[None], front, tele)[0]
    pixels, seen = front.project(pixel_rays(tele))
    assert seen.all()
    u, v = pixels[..., 0], pixels[..., 1]
    expected = np.stack([u / 4.0, v / 3.0, (u + v) / 6.0], axis=-1)
    assert np.abs(cropped - expected).max() <= 1.6
    assert abs(np.mean(cropped - expected)) < 0.02


@pytest.mark.parametrize("front", FRONTS)
@settings(max_examples=20, deadline=None)
@given(u=st.floats(0.0, 575.0), v=st.floats(0.0, 319.0))
def test_a_tele_pixel_and_its_front_pixel_share_their_ray(front, u, v):
    tele = tele_camera(front, 576, 320)
    pixel, seen = front.project(tele.rays(np.array([u, v])))
    assert seen
    back, _ = tele.project(front.rays(pixel))
    assert back == pytest.approx([u, v], abs=1e-6)


def test_shrinking_does_not_alias():
    front = PinholeCamera.from_field_of_view(3000, 200, float(np.radians(60.0)))
    stripes = np.zeros((1, 200, 3000, 3), np.uint8)
    stripes[:, :, ::2] = 200
    cropped = crop_tele(stripes, front, tele_camera(front, 200, 20))
    assert np.abs(cropped.astype(int) - 100).max() < 12


def test_the_fisheye_itself_has_more_detail_than_its_rectification():
    """A perspective image of the same width and field of view has 1.6 times fewer pixels in the tele's middle."""
    front = FthetaCamera.equidistant(832, 468, 415.5, 233.5, 832 / np.radians(120.0))
    rectified = PinholeCamera.from_field_of_view(832, 468, float(np.radians(120.0)))
    native = front.pixels_per_radian[0] / tele_camera(front, 576, 320).pixels_per_radian[0]
    reprojected = rectified.pixels_per_radian[0] / tele_camera(rectified, 576, 320).pixels_per_radian[0]
    assert native / reprojected == pytest.approx(1.65, abs=0.05)


@pytest.mark.parametrize("front", [EQUIDISTANT, FISHEYE, TANGENTIAL, PINHOLE])
def test_the_crop_shows_what_a_true_tele_camera_shows(front):
    """Against a tele camera in the same place of an invented scene: as close as a sharper picture of it can be."""
    scene = generate_scene("work_zone", 1)
    renderer = SceneRenderer(scene)
    pose = scene.ego.T_world_rig[0] @ camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, 0.0, 0.0)
    tele = tele_camera(front, 144, 80)
    true = renderer.render(tele, pose, 0).rgb
    cropped = crop_tele(renderer.render(front, pose, 0).rgb[None], front, tele)[0]
    shifted = crop_tele(renderer.render(front.cropped(2, 2, 832, 468), pose, 0).rgb[None], front, tele)[0]
    assert psnr(cropped, true) > 25.0
    assert psnr(cropped, true) > psnr(shifted, true) + 2.0


def test_a_front_camera_too_narrow_is_refused():
    narrow = PinholeCamera.from_field_of_view(832, 480, float(np.radians(25.0)))
    with pytest.raises(InputError, match="30 degree"):
        tele_camera(narrow, 576, 320)
    with pytest.raises(InputError, match="rows"):
        tele_camera(PINHOLE.cropped(0, 200, 832, 80), 576, 320)


def test_a_lens_that_does_not_reach_as_far_is_refused():
    folded = BrownConradyCamera(832, 480, 900.0, 900.0, 415.5, 239.5, -3.0)
    with pytest.raises(InputError, match=r"does not reach 20 degrees"):
        tele_camera(folded, 576, 320, float(np.radians(40.0)))
