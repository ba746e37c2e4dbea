import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_sft_recipes.open_loop import corner_distance, displacement_errors, measure_open_loop
from olt_toolkit.policy.contract import PlannedTrajectory


def straight(offset=0.0, steps=64):
    return np.stack([np.arange(1, steps + 1) * 1.0, np.full(steps, offset), np.zeros(steps)], axis=-1)


def test_errors_of_a_sideways_offset():
    errors = displacement_errors(np.stack([straight(2.0), straight(0.5)]), straight())
    assert errors["ade"] == pytest.approx(2.0) and errors["min_ade"] == pytest.approx(0.5)
    assert errors["min_ade/by_t=0.5"] == pytest.approx(0.5)


def test_the_best_is_chosen_once_over_the_whole_horizon():
    late = straight()
    late[40:, 1] = 9.0
    errors = displacement_errors(np.stack([late, straight(1.0)]), straight())
    assert errors["min_ade/by_t=0.5"] == pytest.approx(1.0)


@given(st.floats(-3.0, 3.0))
def test_corners_feel_the_heading(yaw):
    path = straight()[None]
    turned = np.tile(
        np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]), (1, 64, 1, 1)
    )
    level = np.tile(np.eye(3), (64, 1, 1))
    # Each corner is 2.5 m from the axis: a turn by yaw moves it along a chord.
    assert corner_distance(path, turned, path[0], level) == pytest.approx(2 * 2.5 * abs(np.sin(yaw / 2)), abs=1e-9)


class Impatient:
    """Drives faster each time that it is asked, until it is reset."""

    name, cameras, image_size = "impatient", (), (0, 0)

    def __init__(self):
        self.asked = 0

    def reset(self, seed, scene):
        self.asked = 0

    def plan(self, observation):
        self.asked += 1
        return PlannedTrajectory(straight() * self.asked, np.tile(np.eye(3), (64, 1, 1)))


def test_the_errors_of_a_sample_do_not_depend_on_those_before_it(drives):
    samples = list(drives.values())
    forth = measure_open_loop(Impatient(), samples, 2)
    back = measure_open_loop(Impatient(), samples[::-1], 2)
    assert forth == back[::-1]
