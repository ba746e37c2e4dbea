"""The light of two frames, told from what both show."""

import numpy as np
import pytest

from olt_generator.cameras import FthetaCamera
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.views.brightness import Brightness
from olt_generator.views.front_view import FrontView
from olt_toolkit.benchmarks.street import render_street

CAMERA = FthetaCamera.equidistant(208, 124, 103.0, 75.0, 100.0)
T_RIG_CAMERA = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.0, 0.0)
POSES = planar_pose(np.array([0.0, 3.0]), 0.0, 0.0)


def pair(factor: float) -> FrontView:
    """Two frames 3 m apart, the first of them darkened or brightened."""
    pictures = [render_street(CAMERA, pose @ T_RIG_CAMERA) for pose in POSES]
    frames, distance = (np.stack(part) for part in zip(*pictures, strict=True))
    frames[0] = np.clip(np.rint(factor * frames[0]), 0, 255)
    return FrontView(frames, distance, Trajectory(np.array([0, 300_000]), POSES), CAMERA, T_RIG_CAMERA)


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.0, 1.3])
def test_the_factor_between_two_frames_is_found(factor):
    front = pair(factor)
    assert Brightness(front).ratio(1, 0) == pytest.approx(1.0 / factor, rel=0.03)
    assert Brightness(front).ratio(0, 1) == pytest.approx(factor, rel=0.03)


def test_frames_that_share_nothing_are_left_as_they_are():
    front = pair(0.5)
    front.distance[:] = np.nan
    assert Brightness(front).ratio(1, 0) == 1.0
    black = pair(0.0)
    assert Brightness(black).ratio(1, 0) == 1.0
