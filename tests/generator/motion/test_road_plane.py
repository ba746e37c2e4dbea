"""Scale, tilt, roll and bend of the road told apart by the places of matched pieces of road."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.motion.road_plane import (
    BEND_SIGMA,
    ROLL_SIGMA,
    SCALE_CHANGE,
    TILT_SECONDS,
    TILT_SIGMA,
    PlaneScale,
    RoadMatches,
    separate_tilt,
)

STEPS = 40
ALL_STEPS = np.arange(STEPS)
TIMES = 0.1 * np.arange(STEPS + 1)
HEIGHT = 1.5
# Metres ahead in the second frame and to the left of the cells of a grid, and what is driven between the frames.
AHEAD, LEFT = (grid.ravel() for grid in np.meshgrid([6.0, 9.0, 12.0, 15.0], [-1.5, -0.5, 0.5, 1.5]))
DRIVEN = 4.0
SIGMA = 0.03


def road_matches(log_scale=0.0, tilt=0.0, roll=0.0, bend=0.0, noise=None, steps=ALL_STEPS):
    """Matches of every cell in some steps, of a road whose scale and shape are constant or (n,) for all steps."""
    step = np.repeat(steps, len(AHEAD))
    scale, rise, fall, curvature = (np.broadcast_to(value, STEPS)[step] for value in (log_scale, tilt, roll, bend))
    lever = np.tile((2.0 * AHEAD + DRIVEN) / HEIGHT, len(steps))
    across = np.tile(LEFT / HEIGHT, len(steps))
    curved = np.tile(AHEAD * (AHEAD + DRIVEN) / (2.0 * HEIGHT), len(steps))
    errors = 0.0 if noise is None else SIGMA * noise.standard_normal(len(step))
    seen = scale + rise * lever + fall * across + curvature * curved + errors
    return RoadMatches(step, lever, across, curved, seen, np.full(len(step), SIGMA))


def mean_deviation(found: PlaneScale) -> float:
    """Standard deviation of the mean of the logarithm of scale over the steps."""
    return float(np.sqrt(found.covariance.mean()))


def wander(random, spread):
    """A process (STEPS,) about 0 that forgets within `TILT_SECONDS`, as road and body do."""
    kept = np.exp(-0.1 / TILT_SECONDS)
    values = [spread * random.standard_normal()]
    for change in random.standard_normal(STEPS - 1):
        values.append(kept * values[-1] + spread * np.sqrt(1.0 - kept**2) * change)
    return np.array(values)


@settings(deadline=None, max_examples=25)
@given(st.floats(0.7, 1.4), st.floats(-0.002, 0.002), st.floats(-0.02, 0.02), st.floats(-0.001, 0.001))
def test_scale_is_found_whatever_the_shape_of_the_road(scale, tilt, roll, bend):
    found = separate_tilt(road_matches(np.log(scale), tilt, roll, bend), TIMES)
    assert found.factor == pytest.approx(scale, rel=0.018)
    assert np.mean(found.roll) == pytest.approx(roll, abs=0.1 * abs(roll) + 1e-4)
    # Tilt and bend look alike but for how they grow with distance: what they do together is known.
    middle, curved = (2.0 * 10.5 + DRIVEN) / HEIGHT, 10.5 * (10.5 + DRIVEN) / (2.0 * HEIGHT)
    together = np.mean(found.tilt) * middle + np.mean(found.bend) * curved
    assert together == pytest.approx(tilt * middle + bend * curved, abs=0.02)


@pytest.mark.parametrize(("shape", "size"), [("tilt", TILT_SIGMA), ("roll", ROLL_SIGMA), ("bend", BEND_SIGMA)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_the_road_does_is_not_taken_for_scale(shape, size, sign):
    matches = road_matches(**{shape: 2.0 * sign * size})
    found = separate_tilt(matches, TIMES)
    error = np.log(found.factor).mean()
    assert abs(error) < 0.4 * abs(matches.log_scale.mean()) + 1e-9
    assert sign * np.mean(getattr(found, shape)) > 0.4 * size
    if shape != "tilt":
        # Tilt that lasts all the time looks like half as much bend, and a little scale.
        assert np.mean(getattr(found, shape)) == pytest.approx(2.0 * sign * size, rel=0.1)
        assert abs(error) < mean_deviation(found)


def test_the_stated_covariance_covers_the_error():
    means, each = [], []
    for seed in range(150):
        random = np.random.default_rng(seed)
        changes = SCALE_CHANGE * np.sqrt(0.1) * random.standard_normal(STEPS)
        shape = {"tilt": TILT_SIGMA, "roll": ROLL_SIGMA, "bend": BEND_SIGMA}
        drawn = {name: wander(random, spread) for name, spread in shape.items()}
        true = np.cumsum(changes) + random.normal(scale=0.1)
        found = separate_tilt(road_matches(true, **drawn, noise=random), TIMES)
        errors = np.log(found.factor) - true
        means.append(errors.mean() / mean_deviation(found))
        each.append(errors[STEPS // 2] / np.sqrt(found.covariance[STEPS // 2, STEPS // 2]))
    assert 0.7 < np.sqrt(np.mean(np.square(means))) < 1.3
    assert 0.7 < np.sqrt(np.mean(np.square(each))) < 1.3


def test_a_quarter_of_wrong_matches_changes_little():
    matches = road_matches(tilt=0.001, noise=np.random.default_rng(2))
    log_scale = matches.log_scale.copy()
    log_scale[np.random.default_rng(3).random(len(log_scale)) < 0.25] += 0.2
    found = separate_tilt(replace(matches, log_scale=log_scale), TIMES)
    assert found.factor == pytest.approx(1.0, abs=0.02)


def test_steps_without_a_match_follow_their_neighbours():
    found = separate_tilt(road_matches(np.log(1.1), steps=np.arange(0, STEPS, 7)), TIMES)
    assert found.factor == pytest.approx(1.1, rel=0.01)
    deviation = np.sqrt(np.diag(found.covariance))
    assert deviation[-1] > deviation[35], "beyond the last match it drifts"


def test_fewer_matches_leave_more_doubt():
    few = separate_tilt(road_matches(steps=np.arange(0, STEPS, 10)), TIMES)
    many = separate_tilt(road_matches(), TIMES)
    assert mean_deviation(few) > 1.2 * mean_deviation(many)


def test_a_single_step_is_enough():
    found = separate_tilt(road_matches(np.log(0.9), steps=np.arange(1)), TIMES[:2])
    assert found.factor == pytest.approx([0.9], rel=0.02)


def test_scale_far_from_what_was_expected_is_still_found():
    """Steps found on their own may be half too long; the prior on the first scale may not hold them."""
    found = separate_tilt(road_matches(np.log(1.5)), TIMES)
    assert found.factor == pytest.approx(1.5, rel=0.02)
