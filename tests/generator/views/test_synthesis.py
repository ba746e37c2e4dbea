"""Cross and rear views of a street whose true views are known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from olt_generator.cameras import FthetaCamera, PinholeCamera
from olt_generator.distance.depth import FAR_DISTANCE
from olt_generator.errors import InputError
from olt_generator.metrics.image_metrics import psnr
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.views.fill import MID_GREY
from olt_generator.views.front_view import FrontView
from olt_generator.views.moving_objects import find_moving
from olt_generator.views.synthesis import PixelOrigin, SynthesisSettings, SynthesizedView, synthesize_view
from olt_toolkit.benchmarks.street import BOXES, ROAD_COLOUR, SKY_COLOUR, Box, render_street

FRONT = FthetaCamera.equidistant(416, 240, 206.0, 150.0, 200.0)
CROSS = FthetaCamera.equidistant(144, 80, 72.0, 50.0, 70.0)
T_RIG_FRONT = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.01, -0.01)
T_RIG_LEFT = camera_pose_in_rig([2.5, 0.94, 0.92], 0.0, 0.01, np.radians(66.0))
T_RIG_RIGHT = camera_pose_in_rig([2.5, -0.94, 0.92], 0.0, -0.02, np.radians(-66.0))
T_RIG_REAR = camera_pose_in_rig([2.0, 1.0, 0.9], 0.0, 0.0, np.radians(151.0))
STEP = 1.5  # metres and, at 10 m/s, 0.15 s between two frames
SAME_FRAME_ONLY = SynthesisSettings(other_frames=0)


def film(positions: list[float], boxes_at=lambda time: BOXES) -> FrontView:
    """The front view at these positions along the street, with the true distance."""
    times = (np.arange(len(positions)) * STEP / 10.0 * 1e6).astype(np.int64)
    poses = planar_pose(np.array(positions), 0.0, 0.0)
    pictures = [
        render_street(FRONT, pose @ T_RIG_FRONT, boxes_at(time * 1e-6)) for pose, time in zip(poses, times, strict=True)
    ]
    images, distances = (np.stack(part) for part in zip(*pictures, strict=True))
    return FrontView(images, distances, Trajectory(times, poses), FRONT, T_RIG_FRONT)


def truth(position: float, T_rig_target: np.ndarray, boxes=BOXES) -> np.ndarray:
    return render_street(CROSS, planar_pose(position, 0.0, 0.0) @ T_rig_target, boxes)[0]


def still(frame: np.ndarray, distance: np.ndarray, camera: PinholeCamera) -> FrontView:
    """One frame of a camera at the front camera's place."""
    trajectory = Trajectory(np.zeros(1, np.int64), np.eye(4)[None])
    return FrontView(frame[None], distance[None], trajectory, camera, T_RIG_FRONT)


def warp(front: FrontView, T_rig_target: np.ndarray, settings: SynthesisSettings | None = None) -> SynthesizedView:
    """The view at the last frame."""
    return synthesize_view(front, CROSS, T_rig_target, [len(front) - 1], settings)


@pytest.fixture(scope="module")
def front() -> FrontView:
    return film([0.5])


@pytest.fixture(scope="module")
def drive() -> FrontView:
    return film([-18.0 + STEP * step for step in range(13)])


@pytest.mark.parametrize("T_rig_target", [T_RIG_LEFT, T_RIG_RIGHT])
def test_observed_pixels_are_those_of_the_true_view(front, T_rig_target):
    view = warp(front, T_rig_target)
    assert view.images.shape == (1, 80, 144, 3)
    assert 0.3 < view.observed.mean() < 0.7
    assert psnr(view.images[0], truth(0.5, T_rig_target), view.observed[0]) > 24.0


def test_true_distance_beats_a_flat_world(front):
    flat = replace(front, distance=np.full_like(front.distance, FAR_DISTANCE))
    views = [warp(each, T_RIG_LEFT) for each in (front, flat)]
    seen_by_both = views[0].observed[0] & views[1].observed[0]
    exact, wrong = (psnr(view.images[0], truth(0.5, T_RIG_LEFT), seen_by_both) for view in views)
    assert exact > wrong + 8.0


def test_the_same_camera_gives_the_same_image(front):
    view = synthesize_view(front, FRONT, T_RIG_FRONT)
    # Some pixels on the edge of a surface belong to none.
    assert view.observed.mean() > 0.998
    assert psnr(view.images, front.frames) > 40.0


@pytest.mark.parametrize("T_rig_target", [T_RIG_LEFT, T_RIG_RIGHT])
def test_other_frames_show_what_this_one_cannot(drive, T_rig_target):
    alone, together = warp(drive, T_rig_target, SAME_FRAME_ONLY), warp(drive, T_rig_target)
    true = truth(0.0, T_rig_target)
    assert psnr(together.images[0], true) > psnr(alone.images[0], true) + 1.5
    assert together.observed.mean() > alone.observed.mean() + 0.1
    from_others = together.origin[0] == PixelOrigin.OTHER_FRAME
    assert psnr(together.images[0], true, from_others) > 20.0
    # What this frame shows is left as it is, but for a seam at its edge.
    same_frame = alone.observed[0]
    assert np.all(together.origin[0][same_frame] == PixelOrigin.SAME_FRAME)
    inner = cv2.erode(same_frame.astype(np.uint8), np.ones((19, 19), np.uint8), borderValue=1) > 0
    assert inner.any()
    assert np.array_equal(together.images[0][inner], alone.images[0][inner])


def test_what_was_drawn_on_is_told_and_bounded(drive):
    view = warp(drive, T_RIG_LEFT, SynthesisSettings(other_frames=2))
    assert len(view.drawn_on[0]) == 2
    assert set(view.drawn_on[0]) < set(range(12))
    assert warp(drive, T_RIG_LEFT, SAME_FRAME_ONLY).drawn_on == ((),)


def test_at_standstill_nothing_is_gathered(drive):
    waiting = film([0.0] * 3)
    view = warp(waiting, T_RIG_LEFT)
    assert view.drawn_on == ((),)
    assert not (view.origin == PixelOrigin.OTHER_FRAME).any()


def test_rear_views_look_back(drive):
    alone = warp(drive, T_RIG_REAR, SAME_FRAME_ONLY)
    view = warp(drive, T_RIG_REAR, SynthesisSettings(other_frames=1, lookback=2))
    # Frame 12 is the last of latent frame 3; latent frame 1 is shown by frame 3.
    assert view.drawn_on == ((3,),)
    assert not alone.observed.any()
    assert view.observed.mean() > 0.05
    assert psnr(view.images[0], truth(0.0, T_RIG_REAR), view.observed[0]) > 20.0


PAINT = (200, 0, 200)


def overtaken(time: float) -> tuple[Box, ...]:
    """A bright van that drives ahead at 20 m/s, away from where the camera will be beside its old place."""
    x = -9.0 + 20.0 * time
    return (*BOXES[:4], Box((x, 2.0, 0.0), (x + 5.0, 3.8, 2.4), PAINT))


def painted_pixels(view: SynthesizedView) -> int:
    painted = np.abs(view.images.astype(int) - PAINT).max(axis=-1) < 70
    return int((painted & (view.origin == PixelOrigin.OTHER_FRAME)).sum())


def test_moving_objects_leave_no_trace():
    drive = film([-18.0 + STEP * step for step in range(13)], overtaken)
    smeared, clean = warp(drive, T_RIG_LEFT), warp(replace(drive, moving=find_moving(drive)), T_RIG_LEFT)
    assert painted_pixels(smeared) >= 3
    assert painted_pixels(clean) == 0
    # The mask costs little of what stands still.
    assert clean.observed.mean() > 0.8 * smeared.observed.mean()


def test_distances_without_confidence_are_not_carried_along(drive):
    doubtful = replace(drive, confidence=np.zeros(drive.distance.shape, np.float32))
    assert np.array_equal(warp(doubtful, T_RIG_LEFT).images, warp(doubtful, T_RIG_LEFT, SAME_FRAME_ONLY).images)
    sure = replace(drive, confidence=np.ones(drive.distance.shape, np.float32))
    assert np.array_equal(warp(sure, T_RIG_LEFT).images, warp(drive, T_RIG_LEFT).images)


def test_sky_is_warped_as_far_away_and_unknown_is_not_warped():
    camera = PinholeCamera.from_field_of_view(120, 80, float(np.radians(90.0)))
    frame = np.full((80, 120, 3), 60, np.uint8)
    frame[:40] = 220
    distance = np.full((80, 120), np.nan, np.float32)
    distance[:40] = np.inf
    view = synthesize_view(still(frame, distance, camera), camera.resized(60, 40), T_RIG_FRONT)
    assert view.observed[0, :19].all()
    assert not view.observed[0, 21:].any()
    # What is invented comes from the sky alone, not from the dark half, but for what a pixel on the border shows.
    assert view.images.min() > 200


def test_cracks_inside_observed_surfaces_are_rare():
    """A near wall seen twice as large: splats must still close up."""
    camera = PinholeCamera.from_field_of_view(416, 240, float(np.radians(90.0)))
    wall = still(np.full((240, 416, 3), 128, np.uint8), np.full((240, 416), 6.0, np.float32), camera)
    nearer = camera_pose_in_rig([4.7, 0.0, 1.45], 0.0, 0.0, 0.0)
    view = synthesize_view(wall, camera.resized(288, 160), nearer)
    assert view.observed[0, 40:120, 70:210].all()


def test_a_view_without_overlap_is_invented_from_the_horizon_around(front):
    behind = camera_pose_in_rig([0.0, 0.0, 1.4], 0.0, 0.0, np.pi)
    narrow = PinholeCamera.from_field_of_view(96, 64, float(np.radians(40.0)))
    image = synthesize_view(front, narrow, behind)
    assert not image.observed.any()
    sky, road = image.images[0, 5].mean(axis=0), image.images[0, -5].mean(axis=0)
    assert np.abs(sky - SKY_COLOUR).max() < 20
    assert np.abs(road - ROAD_COLOUR).max() < 25


def test_a_view_of_nothing_known_is_grey():
    camera = PinholeCamera.from_field_of_view(120, 80, float(np.radians(90.0)))
    unknown = still(np.zeros((80, 120, 3), np.uint8), np.full((80, 120), np.nan, np.float32), camera)
    view = synthesize_view(unknown, camera, T_RIG_LEFT)
    assert not view.observed.any()
    assert np.all(view.images == MID_GREY)


def test_images_do_not_depend_on_which_others_are_made_nor_on_threads(drive):
    shares: list[float] = []
    both = synthesize_view(drive, CROSS, T_RIG_LEFT, [4, 9], on_progress=shares.append)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(4)
    second = synthesize_view(drive, CROSS, T_RIG_LEFT, [9])
    cv2.setNumThreads(threads)
    assert np.array_equal(both.images[1], second.images[0])
    assert np.array_equal(both.origin[1], second.origin[0])
    assert shares == [0.5, 1.0]


def test_sizes_that_do_not_match_are_refused(front):
    with pytest.raises(InputError, match="416 x 240"):
        replace(front, frames=front.frames[:, 1:])
    with pytest.raises(InputError, match="distance"):
        replace(front, distance=np.concatenate([front.distance, front.distance]))
    with pytest.raises(InputError, match="moving"):
        replace(front, moving=np.zeros((1, 2, 2), bool))
    with pytest.raises(InputError, match="1 poses for 2 frames"):
        replace(front, frames=front.frames.repeat(2, axis=0), distance=front.distance.repeat(2, axis=0))
