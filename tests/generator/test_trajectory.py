"""Trajectories: interpolation, frames and refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.errors import InputError
from olt_generator.poses import make_pose, planar_pose, yaw_of
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory


def random_trajectory(seed: int, count: int = 6, start_us: int = 0) -> Trajectory:
    random = make_generator("trajectory", seed)
    timestamps = start_us + np.cumsum(random.integers(1, 200_000, count))
    rotations = Rotation.from_rotvec(np.cumsum(random.normal(0.0, 0.2, (count, 3)), axis=0)).as_matrix()
    return Trajectory(timestamps, make_pose(rotations, np.cumsum(random.normal(0.0, 2.0, (count, 3)), axis=0)))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32), start=st.sampled_from([0, 1_700_000_000_000_000]))
def test_interpolation_hits_the_poses_exactly(seed, start):
    trajectory = random_trajectory(seed, start_us=start)
    assert trajectory.interpolate(trajectory.timestamps_us) == pytest.approx(trajectory.T_world_rig, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(speed=st.floats(-30.0, 30.0), turn=st.floats(-1.0, 1.0), share=st.floats(0.0, 1.0))
def test_interpolation_is_linear_in_position_and_in_angle(speed, turn, share):
    timestamps = np.array([0, 100_000, 350_000])
    seconds = timestamps * 1e-6
    trajectory = Trajectory(timestamps, planar_pose(speed * seconds, 2.0, turn * seconds))
    time = round(share * 350_000)
    (pose,) = trajectory.interpolate(np.array([time]))
    assert pose[:3, 3] == pytest.approx([speed * time * 1e-6, 2.0, 0.0], abs=1e-9)
    assert yaw_of(pose) == pytest.approx(turn * time * 1e-6, abs=1e-9)


def test_interpolation_takes_the_short_way_round():
    trajectory = Trajectory(np.array([0, 1_000_000]), planar_pose(0.0, 0.0, np.radians([170.0, -170.0])))
    (middle,) = trajectory.interpolate(np.array([500_000]))
    assert abs(np.degrees(yaw_of(middle))) == pytest.approx(180.0)


def test_times_outside_are_refused():
    trajectory = random_trajectory(1)
    first, last = trajectory.timestamps_us[[0, -1]]
    for time in (first - 1, last + 1):
        with pytest.raises(InputError, match="asked for"):
            trajectory.interpolate(np.array([first, time]))


def test_one_pose_answers_for_its_own_time_only():
    single = Trajectory(np.array([7]), planar_pose(1.0, 2.0, 0.3)[None])
    assert np.array_equal(single.interpolate(np.array([7, 7])), np.repeat(single.T_world_rig, 2, axis=0))
    with pytest.raises(InputError):
        single.interpolate(np.array([8]))


def test_first_frame_starts_at_the_origin_and_keeps_the_motion():
    trajectory = random_trajectory(3)
    moved = trajectory.in_first_frame()
    assert moved.T_world_rig[0] == pytest.approx(np.eye(4), abs=1e-12)
    steps = np.linalg.inv(trajectory.T_world_rig[:-1]) @ trajectory.T_world_rig[1:]
    assert np.linalg.inv(moved.T_world_rig[:-1]) @ moved.T_world_rig[1:] == pytest.approx(steps, abs=1e-9)
    assert moved.path_length == pytest.approx(trajectory.path_length)


def test_measures():
    trajectory = Trajectory(np.array([500_000, 1_500_000, 2_000_000]), planar_pose([0.0, 3.0, 3.0], [0.0, 4.0, 5.0], 0))
    assert len(trajectory) == 3
    assert trajectory.times == pytest.approx([0.0, 1.0, 1.5])
    assert trajectory.path_length == pytest.approx(6.0)
    assert trajectory.positions.shape == (3, 3)


def test_malformed_trajectories_are_refused():
    poses = planar_pose(np.arange(3.0), 0.0, 0.0)
    with pytest.raises(InputError, match="2 timestamps for 3 poses"):
        Trajectory(np.array([0, 1]), poses)
    with pytest.raises(InputError, match="at least one"):
        Trajectory(np.zeros(0, np.int64), np.zeros((0, 4, 4)))
    with pytest.raises(InputError, match="timestamp 2"):
        Trajectory(np.array([0, 1, 1]), poses)
    with pytest.raises(InputError, match="timestamp 1"):
        Trajectory(np.array([0, -5, 5]), poses)
    poses[1, 0, 3] = np.nan
    with pytest.raises(InputError, match="pose 1 is not finite"):
        Trajectory(np.array([0, 1, 2]), poses)
