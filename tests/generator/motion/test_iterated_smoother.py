"""Where a vehicle stands, told from a motion and its covariances."""

import numpy as np
import pytest

from olt_generator.motion.car_motion import FORWARD_SPEED, YAW_RATE, BodyMotion
from olt_generator.motion.iterated_smoother import MeasuredPoses, find_standstills
from olt_generator.poses import planar_pose


def standstills(speed, turn_rate=0.0, speed_sigma=0.05, turn_sigma=0.01, place_sigma=0.05, wander=0.0, lengths=None):
    """Steps, an eighth of a second each, at which a vehicle of speeds (n,) in m/s and wandering places (m) stands."""
    n = len(speed)
    place = np.cumsum(0.125 * speed) + wander * np.sin(np.arange(n))
    poses = planar_pose(place, np.zeros(n), 0.0)[:, None]
    rest = np.zeros((n, 1, 3))
    velocity, turning = rest.copy(), rest.copy()
    velocity[:, 0, 0], turning[:, 0, 2] = speed, turn_rate
    variances = np.full(13, place_sigma**2)
    variances[FORWARD_SPEED], variances[YAW_RATE] = speed_sigma**2, turn_sigma**2
    measured = MeasuredPoses(np.array([lengths or n]), np.full((n - 1, 1), 0.125), poses, np.full((1, 6), 0.05))
    motion = BodyMotion(poses, velocity, turning, rest[..., 0])
    return np.flatnonzero(find_standstills(measured, motion, np.tile(np.diag(variances), (n, 1, 1, 1)))[:, 0])


def stop(first, last, count=80, moving=5.0):
    speed = np.full(count, moving)
    speed[first : last + 1] = 0.0
    return speed


def test_a_standstill_leaves_a_margin_where_it_begins_and_ends():
    assert standstills(stop(20, 50)).tolist() == list(range(22, 49))


@pytest.mark.parametrize(
    ("first", "last", "expected"), [(0, 30, range(29)), (50, 79, range(52, 80)), (0, 79, range(80))]
)
def test_no_margin_where_the_sequence_begins_or_ends_standing(first, last, expected):
    assert standstills(stop(first, last)).tolist() == list(expected)


@pytest.mark.parametrize(("last", "stands"), [(57, False), (58, True), (59, True)])
def test_a_standstill_lasts_a_second(last, stands):
    speed = stop(50, last)
    assert (len(standstills(speed)) > 0) == stands


def test_poses_beyond_the_end_of_a_sequence_do_not_stand():
    assert standstills(stop(40, 79), lengths=70).tolist() == list(range(42, 70))


@pytest.mark.parametrize(
    ("changes", "stands"),
    [
        ({"moving": 0.14}, True),
        ({"moving": 0.16}, False),  # three standard deviations of speed are 0.15 m/s
        ({"moving": 0.29, "speed_sigma": 1.0}, True),
        ({"moving": 0.31, "speed_sigma": 1.0}, False),  # faster than any vehicle that stands
        ({"turn_rate": 0.029}, True),
        ({"turn_rate": 0.031}, False),  # three standard deviations of the turn rate
        ({"turn_rate": 0.049, "turn_sigma": 1.0}, True),
        ({"turn_rate": -0.051, "turn_sigma": 1.0}, False),
        ({"wander": 0.12}, True),
        ({"wander": 0.2}, False),  # three standard deviations of the place are 0.15 m
    ],
    ids=str,
)
def test_what_is_slow_enough_to_stand(changes, stands):
    changes = dict(changes)
    moving = changes.pop("moving", 0.0)
    speed = np.full(40, moving)
    speed[1::2] *= -1.0  # to and fro, so that it stays where it is
    assert (len(standstills(speed, **changes)) == 40) == stands
