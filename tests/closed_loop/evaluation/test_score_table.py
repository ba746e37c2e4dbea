"""AS and CR of many rollouts, and their intervals."""

import numpy as np
import pytest

from olt_closed_loop.evaluation.score_table import mean_interval, summarize_scores, wilson_interval
from olt_closed_loop.scoring.definitions import RolloutScore


def make_score(category, score, collided=False, valid=True):
    return RolloutScore("scene", category, "policy", 0, valid=valid, score=score, collided=collided if valid else None)


def test_averages_weigh_every_rollout_and_count_the_valid_ones():
    scores = [
        make_score("cyclists", 1.0),
        make_score("cyclists", 0.5, collided=True),
        make_score("work_zone", 0.0, collided=True),
        make_score("work_zone", None, valid=False),
    ]
    table = summarize_scores(scores)
    cyclists, work_zone, overall = table.rows
    assert (cyclists.alpasim_score, cyclists.collision_rate, cyclists.valid) == (0.75, 0.5, 2)
    assert (work_zone.alpasim_score, work_zone.valid, work_zone.rollouts) == (0.0, 1, 2)
    assert work_zone.alpasim_score_interval is None
    assert overall.alpasim_score == pytest.approx(0.5)
    assert overall.collision_rate == pytest.approx(2 / 3)
    assert table.to_dict()["rows"][-1]["category"] == "overall"


def test_nothing_valid_is_not_measured():
    row = summarize_scores([make_score("cyclists", None, valid=False)]).overall
    assert (row.rollouts, row.valid, row.alpasim_score, row.collision_rate) == (1, 0, None, None)
    assert row.collision_rate_interval is None and row.alpasim_score_interval is None


def test_intervals_are_those_of_the_textbook():
    # Newcombe, Statistics in Medicine 17, 1998, table I: 81 of 263 gives 0.2553 to 0.3662; 0 of 20 gives 0 to 0.1611.
    assert wilson_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson_interval(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    # Two values one apart: mean +- 12.706 / 2, cut.
    assert mean_interval(np.array([0.0, 1.0])) == (0.0, 1.0)
    assert mean_interval(np.array([1.0, 1.0])) is None
    interval = mean_interval(np.array([0.4, 0.5, 0.6]))
    assert interval is not None
    low, high = interval
    assert (low, high) == pytest.approx((0.5 - 4.30265 * 0.1 / np.sqrt(3), 0.5 + 4.30265 * 0.1 / np.sqrt(3)), abs=1e-5)
