"""Moving objects are what other frames look through; what stands still is left alone."""

import numpy as np
import pytest

from olt_generator.cameras import FthetaCamera
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.views.front_view import FrontView
from olt_generator.views.moving_objects import find_moving
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
