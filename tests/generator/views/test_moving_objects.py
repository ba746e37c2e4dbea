"""Moving objects are what other frames look through; what stands still is left alone, what none confirms is dropped."""

from dataclasses import replace

import numpy as np
import pytest

from olt_generator.cameras import FthetaCamera
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.views.front_view import FrontView
from olt_generator.views.moving_objects import check_distances, find_moving
from olt_toolkit.benchmarks.street import BOXES, Box, render_street

CAMERA = FthetaCamera.equidistant(208, 120, 103.0, 75.0, 100.0)
T_RIG_CAMERA = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.0, 0.0)
SECONDS = np.arange(10) * 0.25


def film(speed: float, van_speed: float, van_across: float = 0.0, start: float = 9.0) -> tuple[FrontView, np.ndarray]:
    """A drive behind a van (speeds along and across the street, m/s), and where the van is (n, H, W)."""
    poses = planar_pose(speed * SECONDS, 0.0, 0.0)
    distances, van = [], []
    for pose, time in zip(poses, SECONDS, strict=True):
        x, y = start + van_speed * time, -1.0 + van_across * time
        box = Box((x, y, 0.0), (x + 4.5, y + 2.0, 2.0), (200, 0, 200))
        image, distance = render_street(CAMERA, pose @ T_RIG_CAMERA, (*BOXES[:4], box))
        distances.append(distance)
        van.append((image[..., 1] < 45) & (image[..., 0] > 120))
    blank = np.zeros((len(SECONDS), 120, 208, 3), np.uint8)
    trajectory = Trajectory((SECONDS * 1e6).astype(np.int64), poses)
    return FrontView(blank, np.stack(distances), trajectory, CAMERA, T_RIG_CAMERA), np.stack(van)


@pytest.mark.parametrize(("van_speed", "van_across", "start"), [(8.0, 0.0, 9.0), (0.0, 3.0, 14.0), (-8.0, 0.0, 24.0)])
def test_vans_that_move_are_found(van_speed, van_across, start):
    front, van = film(6.0, van_speed, van_across, start)
    moving = find_moving(front)
    assert van[2:6].any(axis=(1, 2)).all()
    assert moving[2:6][van[2:6]].mean() > 0.85
    # A margin is all that is marked beside it.
    assert moving[~van].mean() < 0.08


def test_nothing_is_found_where_all_stands_still():
    front, _ = film(6.0, 0.0)
    assert find_moving(front).mean() < 0.002


def test_one_frame_shows_no_motion():
    front, _ = film(6.0, 8.0)
    alone = FrontView(
        front.frames[:1], front.distance[:1], Trajectory(np.zeros(1, np.int64), np.eye(4)[None]), CAMERA, T_RIG_CAMERA
    )
    assert not find_moving(alone).any()


def test_what_is_unknown_looks_through_nothing():
    front, _ = film(6.0, 8.0)
    front.distance[:] = np.nan
    assert not find_moving(front).any()


def test_distances_that_no_other_frame_confirms_lose_their_confidence():
    front, _ = film(6.0, 0.0, start=40.0)
    sure = replace(front, confidence=np.ones(front.distance.shape, np.float32))
    kept = check_distances(sure).confidence
    assert kept[2:6].mean() > 0.95
    wrong = np.zeros(front.distance.shape, bool)
    wrong[4, 70:90, 80:120] = True
    distorted = replace(sure, distance=np.where(wrong, 0.6 * front.distance, front.distance))
    checked = check_distances(distorted)
    assert checked.confidence[wrong].mean() < 0.2
    right = ~wrong[4]
    assert checked.confidence[4][right].mean() > 0.9


def test_what_was_known_to_move_still_does():
    front, _ = film(6.0, 0.0)
    known = np.zeros(front.distance.shape, bool)
    known[3, 10:20, 10:20] = True
    checked = check_distances(replace(front, moving=known))
    assert checked.moving[known].all()
    assert np.array_equal(checked.moving, known | find_moving(front))
    assert checked.confidence is None


def test_what_nobody_looked_at_again_keeps_its_confidence_unless_it_is_low():
    front, _ = film(6.0, 0.0)
    alone = replace(
        front,
        frames=front.frames[:1],
        distance=front.distance[:1],
        trajectory=Trajectory(np.zeros(1, np.int64), np.eye(4)[None]),
        confidence=np.where(np.arange(208) < 104, np.float32(0.1), np.float32(0.5))[None, None].repeat(120, axis=1),
    )
    confidence = check_distances(alone).confidence[0]
    assert (confidence[:, 104:] == 0.5).all()
    assert (confidence[:, :104] == 0.0).all()
