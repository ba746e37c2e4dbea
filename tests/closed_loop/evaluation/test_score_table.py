"""AS and CR of many rollouts, and their intervals."""

import numpy as np
import pytest

from olt_closed_loop.evaluation.score_table import (
    bootstrap_interval,
    distance_interval,
    mean_interval,
    share_interval,
    summarize_scores,
    wilson_interval,
)
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


def test_the_same_drives_twice_narrow_no_interval():
    values, scenes = np.array([0.2, 0.5, 0.6, 0.9]), ["a", "b", "c", "d"]
    hits = np.array([0.0, 1.0, 1.0, 0.0])
    assert mean_interval(np.repeat(values, 3), np.repeat(scenes, 3)) == pytest.approx(mean_interval(values))
    assert share_interval(np.repeat(hits, 3), np.repeat(scenes, 3)) == pytest.approx(share_interval(hits, scenes))
    assert share_interval(np.ones(30), ["a", "b", "c"] * 10) == pytest.approx(wilson_interval(3, 3))
    assert mean_interval(np.array([0.0, 1.0]), ["a", "a"]) is None
    # Rollouts that differ within scenes are worth more than scenes, and never more than themselves.
    mixed = np.random.default_rng(0).random(200) < 0.4
    width = np.diff(share_interval(mixed.astype(float), np.repeat([f"{i}" for i in range(40)], 5)))
    assert np.diff(wilson_interval(mixed.sum(), 200)) <= width < np.diff(wilson_interval(0.2 * mixed.sum(), 40))


def test_without_an_incident_the_distance_is_at_least_what_the_textbook_says():
    # No event: the upper limit of the mean is -ln(0.025) = 3.689 (Garwood, Biometrika 28, 1936).
    low, high = distance_interval(np.array([5.0, 5.0]), np.array([0, 0]), ["a", "b"])
    assert (low, high) == (pytest.approx(10.0 / 3.6889, rel=1e-4), None)
    assert distance_interval(np.zeros(2), np.array([0, 0]), ["a", "b"]) is None
    assert distance_interval(np.array([5.0, 5.0]), np.array([1, 0]), ["a", "a"]) is None


def test_the_interval_of_a_distance_holds_its_ratio_and_is_open_where_draws_have_no_incident():
    driven, incidents = np.full(12, 0.1), np.array([1, 0, 2, 1, 0, 1, 1, 3, 0, 1, 1, 2])
    low, high = distance_interval(driven, incidents, [f"{i}" for i in range(12)])
    assert low < 1.2 / 13 < high
    low, high = distance_interval(driven, np.eye(12, dtype=int)[0], [f"{i}" for i in range(12)])
    assert 0.0 < low < 1.2 and high is None


def test_the_bootstrap_holds_the_truth_about_as_often_as_it_says():
    generator = np.random.default_rng(3)
    held = 0
    for _ in range(300):
        interval = bootstrap_interval(np.column_stack([generator.normal(0.3, 1.0, size=8), np.ones(8)]))
        held += interval is not None and interval[0] <= 0.3 <= interval[1]
    # 300 draws of 95 % are between 273 and 295 in all but one of a thousand; percentiles alone give 89 %.
    assert 273 <= held <= 295


def test_a_failed_rollout_is_no_score_but_in_the_challenge_where_it_is_0():
    def failed(definition, score):
        return RolloutScore("s", "a", "p", 1, definition, failed=True, score=score, reason="the policy raised")

    def drove(definition):
        return RolloutScore("s", "a", "p", 0, definition, valid=True, score=1.0, collided=False, distance_m=100.0)

    row = summarize_scores([drove("strict"), failed("strict", None)]).overall
    assert (row.rollouts, row.valid, row.failed, row.alpasim_score) == (2, 1, 1, 1.0)
    challenge = "alpasim@challenge-2026-09"
    row = summarize_scores([drove(challenge), failed(challenge, 0.0)]).overall
    assert (row.rollouts, row.valid, row.failed, row.alpasim_score, row.collision_rate) == (2, 1, 1, 0.5, 0.0)
