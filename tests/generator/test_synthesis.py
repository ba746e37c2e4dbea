"""Cross views of a street whose true cross views are known."""

import numpy as np
import pytest

from olt_generator.cameras import FthetaCamera, PinholeCamera
from olt_generator.depth import FAR_DISTANCE
from olt_generator.errors import InputError
from olt_generator.fill import MID_GREY
from olt_generator.image_metrics import psnr
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.synthesis import synthesize_view
from olt_toolkit.benchmarks.street import render_street

FRONT = FthetaCamera.equidistant(832, 480, 413.0, 300.0, 400.0)
CROSS = FthetaCamera.equidistant(288, 160, 144.0, 100.0, 140.0)
T_RIG_FRONT = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.01, -0.01)
T_RIG_LEFT = camera_pose_in_rig([2.5, 0.94, 0.92], 0.0, 0.01, np.radians(66.0))
T_RIG_RIGHT = camera_pose_in_rig([2.5, -0.94, 0.92], 0.0, -0.02, np.radians(-66.0))
T_WORLD_RIG = planar_pose(0.5, 0.0, 0.0)


@pytest.fixture(scope="module")
def front() -> tuple[np.ndarray, np.ndarray]:
    image, distance = render_street(FRONT, T_WORLD_RIG @ T_RIG_FRONT)
    return image[None], distance[None]


@pytest.mark.parametrize("T_rig_target", [T_RIG_LEFT, T_RIG_RIGHT])
def test_observed_pixels_are_those_of_the_true_view(front, T_rig_target):
    frames, distance = front
    view = synthesize_view(frames, distance, FRONT, T_RIG_FRONT, CROSS, T_rig_target)
    true, _ = render_street(CROSS, T_WORLD_RIG @ T_rig_target)
    assert view.images.shape == (1, 160, 288, 3)
    assert 0.3 < view.observed.mean() < 0.7
    assert psnr(view.images[0], true, view.observed[0]) > 24.0


def test_true_distance_beats_a_flat_world(front):
    frames, distance = front
    true, _ = render_street(CROSS, T_WORLD_RIG @ T_RIG_LEFT)
    views = [
        synthesize_view(frames, candidate, FRONT, T_RIG_FRONT, CROSS, T_RIG_LEFT)
        for candidate in (distance, np.full_like(distance, FAR_DISTANCE))
    ]
    seen_by_both = views[0].observed[0] & views[1].observed[0]
    exact, flat = (psnr(view.images[0], true, seen_by_both) for view in views)
    assert exact > flat + 8.0


def test_the_same_camera_gives_the_same_image(front):
    frames, distance = front
    view = synthesize_view(frames, distance, FRONT, T_RIG_FRONT, FRONT, T_RIG_FRONT)
    assert view.observed.all()
    assert psnr(view.images, frames) > 40.0


def test_sky_is_warped_as_far_away_and_unknown_is_not_warped():
    camera = PinholeCamera.from_field_of_view(120, 80, float(np.radians(90.0)))
    frames = np.full((1, 80, 120, 3), 60, np.uint8)
    frames[:, :40] = 220
    distance = np.full((1, 80, 120), np.nan, np.float32)
    distance[:, :40] = np.inf
    view = synthesize_view(frames, distance, camera, T_RIG_FRONT, camera.resized(60, 40), T_RIG_FRONT)
    assert view.observed[0, :19].all()
    assert not view.observed[0, 21:].any()
    assert np.all(view.images == 220)  # what is invented comes from the sky alone, not from the dark half


def test_cracks_inside_observed_surfaces_are_rare():
    """A near wall seen twice as large: splats must still close up."""
    camera = PinholeCamera.from_field_of_view(416, 240, float(np.radians(90.0)))
    frames = np.full((1, 240, 416, 3), 128, np.uint8)
    distance = np.full((1, 240, 416), 6.0, np.float32)
    nearer = camera_pose_in_rig([4.7, 0.0, 1.45], 0.0, 0.0, 0.0)
    view = synthesize_view(frames, distance, camera, T_RIG_FRONT, camera.resized(288, 160), nearer)
    assert view.observed[0, 40:120, 70:210].all()


def test_a_view_without_overlap_is_invented_whole(front):
    frames, distance = front
    behind = camera_pose_in_rig([0.0, 0.0, 1.4], 0.0, 0.0, np.pi)
    narrow = PinholeCamera.from_field_of_view(96, 64, float(np.radians(40.0)))
    view = synthesize_view(frames, distance, FRONT, T_RIG_FRONT, narrow, behind)
    assert not view.observed.any()
    assert np.all(view.images == MID_GREY)


def test_frames_are_independent_and_progress_ends_at_one(front):
    frames, distance = (np.concatenate([part, part[:, ::-1]]) for part in front)
    shares: list[float] = []
    both = synthesize_view(frames, distance, FRONT, T_RIG_FRONT, CROSS, T_RIG_LEFT, shares.append)
    second = synthesize_view(frames[1:], distance[1:], FRONT, T_RIG_FRONT, CROSS, T_RIG_LEFT)
    assert np.array_equal(both.images[1], second.images[0])
    assert shares == [0.5, 1.0]


def test_sizes_that_do_not_match_are_refused(front):
    frames, distance = front
    with pytest.raises(InputError, match="832 x 480"):
        synthesize_view(frames[:, 1:], distance[:, 1:], FRONT, T_RIG_FRONT, CROSS, T_RIG_LEFT)
    with pytest.raises(InputError, match="distance"):
        synthesize_view(frames, np.concatenate([distance, distance]), FRONT, T_RIG_FRONT, CROSS, T_RIG_LEFT)
