"""Paths of frames chained to a trajectory: bends of any radius and speed, with closed-form poses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_datasets.sources.waymo.motion import FramePath, chain_paths
from olt_generator.errors import InputError
from olt_generator.poses import invert, planar_pose, transform, yaw_of

SPEEDS = st.floats(0.0, 35.0)
YAW_RATES = st.floats(-0.6, 0.6)


def bend(times, speed, yaw_rate):
    """Poses (n, 4, 4) after `times` seconds of constant speed and yaw rate."""
    yaw = yaw_rate * np.asarray(times, float)
    # sinc and its counterpart stay finite where the yaw rate is 0.
    x = speed * times * np.sinc(yaw / np.pi)
    y = speed * times * 0.5 * yaw * np.sinc(0.5 * yaw / np.pi) ** 2
    return planar_pose(x, y, yaw)


def path_at(time, speed, yaw_rate, states=(16, 20)):
    """What a frame at `time` seconds tells."""
    times = time + 0.25 * np.arange(1 - states[0], states[1] + 1)
    here = bend(np.array([time]), speed, yaw_rate)[0]
    points = transform(invert(here), bend(times, speed, yaw_rate)[:, :3, 3])[:, :2]
    return FramePath.from_states(round(time * 1e6), points[: states[0]], points[states[0] :])


@given(SPEEDS, YAW_RATES, st.lists(st.integers(1, 30), min_size=1, max_size=5))
def test_frames_of_a_bend_stand_where_the_bend_has_them(speed, yaw_rate, gaps):
    yaw_rate = yaw_rate if speed > 1.0 else 0.0  # a car that stands does not turn
    times = 0.1 * np.cumsum([0, *gaps])
    trajectory = chain_paths([path_at(time, speed, yaw_rate) for time in times], "drive")
    expected = bend(trajectory.timestamps_us * 1e-6, speed, yaw_rate)
    frames = np.isin(trajectory.timestamps_us, np.round(times * 1e6))
    assert frames.sum() == len(times)
    assert np.abs(trajectory.positions - expected[:, :3, 3]).max() < 0.02
    turn = yaw_of(invert(expected) @ trajectory.T_world_rig)
    assert np.abs(turn[frames]).max() < 1e-3
    # Before the first and after the last frame headings are tangents, of which the outermost is the least exact.
    assert np.abs(turn).max() < 0.02


@given(SPEEDS, YAW_RATES)
def test_one_frame_tells_its_past_and_future(speed, yaw_rate):
    trajectory = chain_paths([path_at(0.0, speed, yaw_rate, (16, 0))], "drive")
    assert trajectory.timestamps_us.tolist() == [250_000 * step for step in range(-15, 1)]
    assert np.allclose(trajectory.T_world_rig[-1], np.eye(4), atol=1e-9)


def test_paths_that_do_not_overlap_are_refused():
    paths = [path_at(0.0, 10.0, 0.0, (2, 2)), path_at(2.0, 10.0, 0.0, (2, 2))]
    with pytest.raises(InputError, match=r"drive: frames at 0\.0 s and 2\.0 s have no paths that meet"):
        chain_paths(paths, "drive")


def test_paths_of_other_speeds_are_refused():
    with pytest.raises(InputError, match="not of one drive"):
        chain_paths([path_at(0.0, 10.0, 0.0), path_at(0.1, 13.0, 0.0)], "drive")
