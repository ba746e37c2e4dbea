"""Speed, comfort, nearness and lane direction beside the score, and the table of many scores."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from olt_closed_loop.evaluation.score_table import summarize_scores
from olt_closed_loop.rollouts.rollout_files import parse_rollout
from olt_closed_loop.scoring.definitions import RolloutScore, score_record
from olt_generator.errors import InputError


@pytest.fixture(scope="session")
def metrics(texts):
    """The further figures of a drive."""

    def measured(poses, **changes):
        return score_record(parse_rollout(texts.rollout(poses, **changes), "drive")).metrics

    return measured


@given(acceleration=st.floats(-1.0, 6.0), yaw=st.floats(-3.0, 3.0))
def test_constant_acceleration_is_measured_as_it_is(texts, acceleration, yaw):
    assume(abs(acceleration - 2.4) > 1e-6)  # at the limit of comfort the last digit decides
    time = 0.1 * np.arange(81)
    poses = texts.along_x()
    poses[:, 0] = 10.0 * time + 0.5 * acceleration * time**2
    values = score_record(parse_rollout(texts.turned(texts.rollout(poses, map=None), yaw), "drive")).metrics
    assert values["max_acceleration"] == pytest.approx(acceleration, abs=1e-8)
    assert values["min_acceleration"] == pytest.approx(acceleration, abs=1e-8)
    assert values["max_speed"] == pytest.approx(10.0 + max(7.95 * acceleration, 1.75 * acceleration), abs=1e-9)
    assert values["max_jerk"] == pytest.approx(0.0, abs=1e-6)
    assert values["comfortable"] == (acceleration <= 2.4)


def test_a_circle_has_lateral_acceleration_and_yaw_rate(metrics):
    angle = 0.4 * 0.1 * np.arange(81)
    circle = np.column_stack([25.0 * np.sin(angle), 25.0 * (1.0 - np.cos(angle)), angle])
    values = metrics(circle, map=None)
    assert values["max_lateral_acceleration"] == pytest.approx(4.0, rel=1e-3)
    assert values["max_yaw_rate"] == pytest.approx(0.4, abs=1e-9)
    assert values["mean_speed"] == pytest.approx(10.0, rel=1e-3)
    assert values["distance_m"] == pytest.approx(63.0, rel=1e-3)
    assert values["comfortable"]


def test_a_car_ahead_is_so_many_seconds_and_metres_away(texts, metrics):
    ahead = np.add(texts.along_x(speed=5.0), [60.0, 0.0, 0.0])
    values = metrics(texts.along_x(), agents={"ahead": texts.agent(ahead)})
    gap = 60.0 - 1.3965 - 0.5 * (5.393 + 4.6)
    assert values["min_distance_to_agents_m"] == pytest.approx(gap - 8.0 * 5.0, abs=1e-9)
    assert values["min_time_to_collision"] == pytest.approx(gap / 5.0 - 8.0, abs=1e-6)


def test_nobody_in_the_way_is_ten_seconds_or_more(texts, metrics):
    beside = texts.agent(np.add(texts.along_x(), [0.0, 3.6, 0.0]))
    values = metrics(texts.along_x(), agents={"beside": beside})
    assert values["min_time_to_collision"] == 10.0
    assert values["min_distance_to_agents_m"] == pytest.approx(3.6 - 0.5 * (2.109 + 1.9))
    alone = metrics(texts.along_x())
    assert (alone["min_time_to_collision"], alone["min_distance_to_agents_m"]) == (10.0, None)


def test_a_touch_takes_both_to_zero(texts, metrics):
    parked = texts.agent(np.tile([60.0, 0.0, 0.3], (81, 1)))
    values = metrics(texts.along_x(), agents={"parked": parked})
    assert (values["min_time_to_collision"], values["min_distance_to_agents_m"]) == (0.0, 0.0)


def test_what_cannot_be_measured_is_none(texts, metrics):
    values = metrics(texts.along_x(count=20), map=None, force_gt_duration_us=1_700_000)
    assert values["wrong_way"] is None and values["max_jerk"] is None and values["comfortable"] is None
    assert values["max_speed"] == pytest.approx(10.0)


def test_at_a_crossing_one_proper_lane_is_enough(texts, metrics):
    road = texts.road()
    across = [[30.0, float(y)] for y in range(-30, 31, 2)]
    road["lanes"].append({"id": "across", "center": across})
    backwards = {"id": "back", "center": road["lanes"][0]["center"][::-1]}
    assert metrics(texts.along_x(), map=road)["wrong_way"] is False
    assert metrics(texts.along_x(), map=road | {"lanes": [*road["lanes"], backwards]})["wrong_way"] is False
    assert metrics(texts.along_x(), map=road | {"lanes": [backwards]})["wrong_way"] is True


def scored(category, score, seed=0, **values):
    return RolloutScore(f"{category} scene", category, "policy", seed, valid=True, score=score, **values)


def test_the_overall_row_is_weighted_by_rollouts_as_in_the_paper():
    """Row 10K + NV GT of the paper's Table 1: 8, 2, 6 and 2 rollouts give 0.764."""
    columns = {"complex": (8, 0.743), "cyclists": (2, 0.688), "uncommon": (6, 0.758), "work_zone": (2, 0.938)}
    scores = [scored(name, value, seed) for name, (count, value) in columns.items() for seed in range(count)]
    overall = summarize_scores(scores).overall
    assert round(overall.alpasim_score, 3) == 0.764
    assert (overall.rollouts, overall.scenes, overall.seeds) == (18, 4, tuple(range(8)))


def test_distance_between_incidents_is_all_distance_over_all_incidents():
    scores = [
        scored("a", 1.0, distance_m=3000.0, incidents=0, incidents_at_fault=0),
        scored("a", 0.0, distance_m=1000.0, incidents=2, incidents_at_fault=1),
        RolloutScore("s", "a", "policy", 0, reason="failed"),
    ]
    row = summarize_scores(scores).overall
    assert (row.km_between_incidents, row.km_between_incidents_at_fault) == (2.0, 4.0)
    assert summarize_scores(scores[:1]).overall.km_between_incidents is None


def test_two_definitions_are_not_averaged():
    with pytest.raises(InputError, match="alpasim and strict"):
        summarize_scores([scored("a", 1.0), scored("a", 1.0, definition="alpasim")])
    assert summarize_scores([scored("a", 1.0, definition="alpasim")]).definition == "alpasim"
