"""Smoothing of plans: what passes unchanged, what vanishes, what is late."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_closed_loop.benchmarks.noisy_plans import (
    SMOOTHINGS,
    count_reversals,
    drive,
    of_plans,
    of_poses,
    seconds_to_change,
)
from olt_closed_loop.control.plans import WorldPlan
from olt_closed_loop.control.smoothing import DEFAULT_DELAY, DEFAULT_WINDOW, PlanSmoother, smoothing_matrix
from olt_closed_loop.control.tracking import ControlSettings
from olt_generator.errors import InputError

NONE = ControlSettings(smoothing_window=0.0, smoothing_delay=0.0)


def plan(poses, start=0):
    return WorldPlan(100_000 * (start + np.arange(len(poses), dtype=np.int64)), np.asarray(poses, dtype=np.float64))


@given(st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-1.0, 1.0)), st.sampled_from([1.0, 2.0, 8.0]))
def test_even_acceleration_passes_unchanged(coefficients, window):
    values = np.polyval(coefficients, 0.1 * np.arange(65))
    np.testing.assert_allclose(smoothing_matrix(65, window) @ values, values, atol=1e-6 * (1 + np.abs(values).max()))


def test_waves_of_the_stated_length_are_halved_and_the_first_value_is_kept():
    steps = np.arange(400)
    wave = np.cos(steps / 4.0)
    smooth = smoothing_matrix(400, 4.0) @ wave
    assert smooth[0] == pytest.approx(wave[0], rel=1e-9)
    np.testing.assert_allclose(smooth[100:300], 0.5 * wave[100:300], atol=0.01)


def test_a_short_plan_passes_unchanged():
    np.testing.assert_array_equal(smoothing_matrix(3, 5.0), np.eye(3))


@given(seed=st.integers(0, 1000))
def test_nothing_moves_along_the_headings(seed):
    generator = np.random.default_rng(seed)
    smoother, heading = PlanSmoother(0.3, 0.5), generator.uniform(-3.0, 3.0)
    for start in range(4):
        poses = np.column_stack([generator.normal(size=(65, 2)), np.full(65, heading)])
        moved = smoother(plan(poses, start)).poses - poses
        np.testing.assert_allclose(np.cos(heading) * moved[:, 0] + np.sin(heading) * moved[:, 1], 0.0, atol=1e-9)


def test_without_smoothing_plans_are_followed_as_given():
    poses = np.random.default_rng(0).normal(size=(65, 3))
    smoother = PlanSmoother(0.0, 0.0)
    for start in range(3):
        np.testing.assert_array_equal(smoother(plan(poses, start)).poses, poses)


def test_whole_turns_between_plans_change_nothing():
    poses = np.column_stack([np.arange(65.0), np.zeros(65), np.zeros(65)])
    smoother = PlanSmoother(0.0, 0.3)
    smoother(plan(poses))
    np.testing.assert_allclose(smoother(plan(poses + np.array([1.0, 0.0, 2.0 * np.pi]), 1)).poses[:, 2], 2.0 * np.pi)


def test_a_change_of_mind_by_a_lane_goes_through_and_a_small_one_arrives():
    line = np.column_stack([np.arange(65.0), np.zeros(65), np.zeros(65)])
    for jump, first in ((0.2, 0.05), (3.5, 0.85)):
        smoother = PlanSmoother(0.0, 0.3)
        smoother(plan(line))
        shares = [
            smoother(plan(line + np.array([start, jump, 0.0]), start)).poses[5, 1] / jump for start in range(1, 30)
        ]
        assert shares[0] > first and shares[-1] == pytest.approx(1.0, abs=0.01)
        assert np.all(np.diff(shares) > -1e-12)


@pytest.mark.parametrize("noise", [of_plans, of_poses])
def test_noise_moves_the_wheel_less_and_the_vehicle_is_closer_to_where_it_should_be(noise):
    raw, smooth = drive(NONE, noise), drive(ControlSettings(), noise)
    assert smooth.reversals < 0.7 * raw.reversals
    assert smooth.steering_rate < 0.5 * raw.steering_rate
    assert smooth.rms < 0.6 * raw.rms


def test_clean_plans_are_followed_as_closely_as_without():
    assert drive(ControlSettings()).rms < drive(NONE).rms + 1e-3


@pytest.mark.parametrize(("jump", "limit"), [(0.5, 0.25), (3.5, 0.1)])
def test_the_delay_is_as_stated(jump, limit):
    assert seconds_to_change(ControlSettings(), jump) - seconds_to_change(NONE, jump) < limit


def test_the_default_is_in_the_table():
    assert (DEFAULT_WINDOW, DEFAULT_DELAY) in SMOOTHINGS.values()


def test_reversals_are_turns_back_by_more_than_the_gap():
    assert count_reversals(np.array([0.0, 0.1, 0.2, 0.1, 0.0, 0.1])) == 2
    assert count_reversals(np.array([0.0, 0.1, 0.0999, 0.2])) == 0


@pytest.mark.parametrize("values", [(-0.1, 0.0), (0.0, np.nan), (np.inf, 0.0)])
def test_settings_that_make_no_sense_are_refused(values):
    with pytest.raises(InputError, match="0 for none"):
        ControlSettings(smoothing_window=values[0], smoothing_delay=values[1])
