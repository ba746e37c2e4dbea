"""Which frames are drawn on, by geometry alone."""

from dataclasses import replace

import numpy as np
import pytest

from olt_generator.cameras import FthetaCamera
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.views.front_view import FrontView
from olt_generator.views.lookback import lookback_frame
from olt_generator.views.source_frames import SourceChooser

FRONT = FthetaCamera.equidistant(48, 27, 23.5, 18.0, 23.6)
T_RIG_FRONT = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.0, 0.0)
T_RIG_LEFT = camera_pose_in_rig([2.5, 0.94, 0.92], 0.0, 0.0, np.radians(66.0))
T_RIG_REAR = camera_pose_in_rig([2.0, 1.0, 0.9], 0.0, 0.0, np.radians(151.0))


def driven(poses: np.ndarray) -> FrontView:
    count = len(poses)
    trajectory = Trajectory(100_000 * np.arange(count), poses)
    blank = np.zeros((count, 27, 48), np.float32)
    return FrontView(np.zeros((count, 27, 48, 3), np.uint8), blank, trajectory, FRONT, T_RIG_FRONT)


STRAIGHT = driven(planar_pose(np.arange(60.0), 0.0, 0.0))


def test_a_cross_view_needs_what_lies_behind():
    chosen = SourceChooser(STRAIGHT, FRONT, T_RIG_LEFT, 4).choose(40)
    assert len(chosen) == 4
    assert sum(frame < 40 for frame in chosen) >= 3
    assert chosen[0] < 40


def test_backwards_it_needs_what_lies_ahead_in_time():
    reversing = driven(planar_pose(-np.arange(60.0), 0.0, 0.0))
    chosen = SourceChooser(reversing, FRONT, T_RIG_LEFT, 4).choose(20)
    assert sum(frame > 20 for frame in chosen) >= 3
    assert chosen[0] > 20


def test_a_rear_view_looks_farther_back_than_a_cross_view():
    def reach(T_rig_target: np.ndarray) -> float:
        return float(np.mean([40 - frame for frame in SourceChooser(STRAIGHT, FRONT, T_rig_target, 3).choose(40)]))

    assert reach(T_RIG_REAR) > reach(T_RIG_LEFT)


def test_given_frames_come_first_and_count():
    chosen = SourceChooser(STRAIGHT, FRONT, T_RIG_LEFT, 3).choose(40, (17,))
    assert chosen[0] == 17
    assert len(chosen) <= 3
    assert len(set(chosen)) == len(chosen)


def test_the_front_view_itself_needs_no_other():
    assert SourceChooser(STRAIGHT, FRONT, T_RIG_FRONT, 4).choose(40) == ()


@pytest.mark.parametrize("poses", [np.eye(4)[None], planar_pose(np.zeros(5), 0.0, 0.0)])
def test_one_frame_and_standstill_give_none(poses):
    assert SourceChooser(driven(poses), FRONT, T_RIG_LEFT, 4).choose(0) == ()


def test_spacing_is_by_distance_not_by_time():
    """The same road at half the speed: the same places are chosen."""
    slow = driven(planar_pose(0.5 * np.arange(120.0), 0.0, 0.0))
    fast_places = [float(frame) for frame in SourceChooser(STRAIGHT, FRONT, T_RIG_LEFT, 4).choose(40)]
    slow_places = [0.5 * frame for frame in SourceChooser(slow, FRONT, T_RIG_LEFT, 4).choose(80)]
    np.testing.assert_allclose(slow_places, fast_places, atol=1.0)


def test_only_the_frames_offered_are_drawn_on_wherever_the_rest_is():
    offered = np.arange(0, 60, 3)
    among_all = replace(STRAIGHT, sources=offered)
    alone = driven(planar_pose(offered.astype(float), 0.0, 0.0))
    chosen = SourceChooser(among_all, FRONT, T_RIG_LEFT, 4).choose(42)
    assert set(chosen) <= set(offered.tolist())
    assert chosen == tuple(3 * frame for frame in SourceChooser(alone, FRONT, T_RIG_LEFT, 4).choose(14))


def test_frames_of_a_part_of_the_video_look_back_by_their_numbers():
    part = replace(STRAIGHT, numbers=3 * np.arange(60))
    assert part.numbers[part.look_back(14, 4)] == lookback_frame(42, 4) == 27
    with pytest.raises(InputError, match="frame 23 of the video, to which frame 39 looks back, is not there"):
        part.look_back(13, 4)
