"""Signed speed from what the cells of a road grid agree with."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.motion.road_grid import CellMatches
from olt_generator.motion.road_speed import LongerVotes, count_votes, estimate_speed

SHIFTS = 0.05 * np.arange(-100, 101)
ALONG = 6.0 + 2.0 * np.arange(5)
ACROSS = np.arange(-4.0, 4.5, 1.0)
OWN = np.abs(ACROSS) < 1.6
STEP = 0.1


def see(shifts, seed=0, correlation=0.9):
    """Matches of cells (columns, rows) that agree with these shifts; NaN shows nothing."""
    shifts = np.broadcast_to(shifts, (len(ACROSS), len(ALONG)))
    noise = np.random.default_rng(seed).uniform(-0.4, 0.4, (*shifts.shape, len(SHIFTS)))
    peak = np.exp(-0.5 * ((SHIFTS - shifts[..., None]) / 0.08) ** 2)
    found = np.where(np.isnan(shifts)[..., None], np.nan, noise * (1.0 - peak) + correlation * peak)
    return CellMatches(ALONG, ACROSS, found)


def best(matches, seconds=STEP):
    return SHIFTS[np.argmax(count_votes(matches, seconds))]


def lane(road, ahead=None, from_row=2, beside=None):
    """Shifts of cells: the road's; of what drives ahead, from some row on; and of what is beside the own lane."""
    shifts = np.full((len(ACROSS), len(ALONG)), float(road))
    if ahead is not None:
        shifts[OWN, from_row:] = ahead
    if beside is not None:
        shifts[~OWN] = beside
    return shifts


@settings(max_examples=25, deadline=None)
@given(st.floats(-1.0, 4.0), st.integers(0, 1000))
def test_a_road_in_view_wins_with_its_sign(driven, seed):
    matches = see(driven, seed)
    assert best(matches) == pytest.approx(driven, abs=0.051)
    assert count_votes(matches, STEP).max() > 20.0
    assert count_votes(matches, STEP).min() >= 0.0


@pytest.mark.parametrize("driven", [0.3, 0.9, 2.0])
@pytest.mark.parametrize(("from_row", "beside"), [(1, np.nan), (2, 0.0), (3, 0.0)])
def test_a_vehicle_that_keeps_its_distance_makes_no_standstill(driven, from_row, beside):
    """It stays in the picture, and so may lorries at the same pace on both sides: only near cells show road."""
    shifts = lane(driven, ahead=0.0, from_row=from_row, beside=beside)
    assert best(see(shifts)) == pytest.approx(driven, abs=0.051)


def test_vehicles_that_drive_off_make_no_reverse_of_a_standstill():
    """What stands on the plane and drives ahead seems to shift backward, the more the farther it is."""
    faster = np.random.default_rng(6).uniform(0.1, 1.0, (np.count_nonzero(~OWN), 1))
    shifts = lane(0.0, ahead=-0.3 * np.arange(1, 4), beside=-faster * (1.0 + 0.3 * np.arange(5)))
    assert best(see(shifts)) == pytest.approx(0.0, abs=0.051)


def test_a_vehicle_that_is_overtaken_on_both_sides_still_stands():
    random = np.random.default_rng(5)
    shifts = lane(0.0, beside=random.uniform(-2.0, 2.0, (np.count_nonzero(~OWN), len(ALONG))))
    assert best(see(shifts)) == pytest.approx(0.0, abs=0.051)


def test_cells_that_stay_say_little_for_standstill():
    """Half of the cells stay and half move as a road: the vehicle drives."""
    shifts = np.zeros((len(ACROSS), len(ALONG)))
    shifts[::2] = 1.0
    votes = count_votes(see(shifts), STEP)
    standing, driving = (votes[np.argmin(np.abs(SHIFTS - shift))] for shift in (0.0, 1.0))
    assert driving > standing + 10.0


def test_what_stays_for_long_is_road_that_stands():
    """Over seconds hardly anything keeps its distance."""
    shifts = lane(0.0, beside=np.nan)
    short, long = (count_votes(see(shifts), seconds).max() for seconds in (0.1, 2.0))
    assert long > short


def test_cells_that_show_nothing_have_no_vote():
    assert not count_votes(see(np.nan), STEP).any()


def test_beyond_what_stands_on_the_road_a_column_hardly_counts():
    """Of the same cells, those in front of an obstacle vote, and those behind it hardly do."""
    in_front, behind = lane(1.0, beside=np.nan), lane(1.0, beside=np.nan)
    in_front[OWN, 3:] = 2.6
    behind[OWN, :2] = 2.6
    at = np.argmin(np.abs(SHIFTS - 1.0))
    assert count_votes(see(in_front), STEP)[at] > 2.0 * count_votes(see(behind), STEP)[at]


def cast(speeds, weight=20.0, lasts=STEP):
    """Votes (n, shifts) of steps for their speeds; NaN for a road that shows nothing."""
    speeds = np.asarray(speeds, dtype=float)[:, None]
    return np.nan_to_num(weight * np.exp(-0.5 * ((SHIFTS - speeds * lasts) / 0.08) ** 2))


def follow(votes, **given):
    return estimate_speed(votes, SHIFTS, np.full(len(votes), STEP), **given)


@settings(max_examples=20, deadline=None)
@given(st.floats(-4.0, 40.0), st.floats(-3.0, 3.0), st.integers(1, 20))
def test_votes_give_the_speed_and_its_sign(speed, change, count):
    speeds = speed + change * STEP * np.arange(count)
    found = follow(cast(speeds))
    assert found.speed == pytest.approx(speeds, abs=0.25, rel=0.02)
    assert np.all(np.abs(found.speed - speeds) < 3.0 * found.sigma + 0.05)
    assert found.log_odds == pytest.approx(20.0, abs=3.0)
    if abs(speed) > 2.0 and count > 5:
        assert np.sign(found.direction_log_odds) == np.sign(speed)


def test_a_step_that_the_road_does_not_tell_lies_between_its_neighbours():
    speeds = np.linspace(10.0, 12.0, 21)
    votes = cast(np.where(np.abs(np.arange(21) - 10) < 3, np.nan, speeds))
    found = follow(votes)
    assert found.speed == pytest.approx(speeds, abs=0.25)
    assert found.sigma[10] > 1.3 * found.sigma[3]
    assert found.log_odds[10] == 0.0


def test_a_few_steps_that_tell_something_else_do_not_bend_the_speed():
    speeds = np.full(20, 8.0)
    speeds[[4, 5, 13]] = [-3.0, 15.0, 0.0]
    assert follow(cast(speeds)).speed == pytest.approx(np.full(20, 8.0), abs=0.3)


@pytest.mark.parametrize("share", [0.3, 0.9])
@pytest.mark.parametrize("other", [-6.0, 0.0, 14.0])
def test_another_course_is_told_with_its_votes(share, other):
    found = follow(cast(np.full(20, 7.0)) + cast(np.full(20, other), share * 20.0))
    assert found.speed == pytest.approx(np.full(20, 7.0), abs=0.2)
    stated = found.rival_log_odds / found.path_log_odds
    # What goes backward pays for it, at the start and in each step.
    assert stated == pytest.approx(share - (0.06 if other < 0.0 else 0.0), abs=0.05)


def test_without_another_course_there_is_no_rival():
    found = follow(cast(np.full(20, 7.0)))
    assert found.rival_log_odds < 0.1 * found.path_log_odds
    assert found.direction_log_odds > 300.0


def test_forward_is_more_probable_where_the_votes_do_not_tell():
    both = cast(np.full(15, 5.0)) + cast(np.full(15, -5.0))
    found = follow(both)
    assert np.all(found.speed > 4.0)
    assert 0.0 < found.direction_log_odds < 30.0


def test_votes_over_several_steps_count_for_their_time():
    speeds = np.full(10, 0.8)
    longer = LongerVotes(cast(speeds, lasts=0.8), np.full(10, 0.8))
    found = follow(cast(speeds), longer=longer)
    assert found.speed == pytest.approx(speeds, abs=0.05)
    assert np.all(found.sigma < follow(cast(speeds)).sigma)
    assert found.log_odds == pytest.approx(2.0 * follow(cast(speeds)).log_odds, rel=0.2)


def test_votes_over_one_step_are_added_to_those_over_several():
    """Neither alone tells the speed from another; together they do."""
    single = cast(np.full(10, 3.0)) + cast(np.full(10, 1.0), 19.0)
    longer = LongerVotes(
        cast(np.full(10, 3.0), 15.0, lasts=0.3) + cast(np.full(10, 0.0), 19.0, lasts=0.3), np.full(10, 0.3)
    )
    assert follow(single, longer=longer).speed == pytest.approx(np.full(10, 3.0), abs=0.1)
