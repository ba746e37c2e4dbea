"""Scale and tilt told apart by the distances of matched pieces of road."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.motion.road_plane import RoadMatches, separate_tilt

STEPS = 40
ALL_STEPS = np.arange(STEPS)
TIMES = 0.1 * np.arange(STEPS + 1)
LEVERS = np.array([9.0, 13.0, 17.0, 21.0])


def matches_of(log_scale, tilt, noise=0.0, steps=ALL_STEPS):
    step = np.repeat(steps, len(LEVERS))
    lever = np.tile(LEVERS, len(steps))
    errors = noise * np.random.default_rng(2).normal(size=len(step))
    return RoadMatches(step, lever, log_scale + tilt * lever + errors, np.full(len(step), 0.015))


@given(st.floats(0.7, 1.4), st.floats(-0.002, 0.002))
def test_scale_is_found_whatever_the_tilt(scale, tilt):
    found = separate_tilt(matches_of(np.log(scale), tilt), TIMES)
    assert found.factor == pytest.approx(scale, rel=0.006)
    assert np.mean(found.tilt) == pytest.approx(tilt, abs=4e-4)


def test_the_stated_deviation_covers_the_error():
    errors, sigmas = [], []
    for seed in range(40):
        random = np.random.default_rng(seed)
        matches = matches_of(0.0, 0.0)
        tilt = random.normal(scale=0.002)
        observed = matches.log_scale + tilt * matches.lever + 0.015 * random.normal(size=len(matches.step))
        found = separate_tilt(RoadMatches(matches.step, matches.lever, observed, matches.sigma), TIMES)
        errors.append(np.log(found.factor).mean())
        sigmas.append(found.sigma)
    assert 0.3 < np.std(errors) / np.mean(sigmas) < 1.5


def test_a_quarter_of_wrong_matches_changes_little():
    matches = matches_of(0.0, 0.001, noise=0.01)
    log_scale = matches.log_scale.copy()
    log_scale[::4] += 0.12
    found = separate_tilt(RoadMatches(matches.step, matches.lever, log_scale, matches.sigma), TIMES)
    assert found.factor == pytest.approx(1.0, abs=0.02)


def test_steps_without_a_match_follow_their_neighbours():
    found = separate_tilt(matches_of(np.log(1.1), 0.0, steps=np.arange(0, STEPS, 7)), TIMES)
    assert found.factor == pytest.approx(1.1, rel=0.01)


def test_fewer_matches_leave_more_doubt():
    few = separate_tilt(matches_of(0.0, 0.0, steps=np.arange(0, STEPS, 10)), TIMES)
    many = separate_tilt(matches_of(0.0, 0.0), TIMES)
    assert few.sigma > 1.2 * many.sigma


def test_a_single_step_is_enough():
    found = separate_tilt(matches_of(np.log(0.9), 0.0, steps=np.arange(1)), TIMES[:2])
    assert found.factor == pytest.approx([0.9], rel=0.02)
