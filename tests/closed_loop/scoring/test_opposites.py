"""Drives that must be worth the same: in a mirror, elsewhere, sampled more often; and drives the wrong way round."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.rollouts.rollout_files import parse_rollout
from olt_closed_loop.scoring.definitions import DEFINITIONS, recorded_length, score_record

FEW = settings(max_examples=15, deadline=None)
SEEDS = st.integers(0, 100_000)


def judge(values, definition="strict"):
    return score_record(parse_rollout(values, "drive"), definition)


def verdict(score):
    """What must not change at all."""
    hits = [(hit.agent_id, hit.side, hit.at_fault, hit.rule) for hit in score.collisions]
    return score.valid, score.reason, score.collided, score.offroad, hits


def assert_same_figures(one, other):
    assert set(one) == set(other)
    for name, value in one.items():
        assert other[name] == (value if value is None else pytest.approx(value, abs=1e-4)), name


@FEW
@given(seed=SEEDS, definition=st.sampled_from(DEFINITIONS))
def test_left_hand_traffic_is_right_hand_traffic_in_a_mirror(texts, seed, definition):
    values = texts.random(seed)
    here, there = judge(values, definition), judge(texts.mirrored(values), definition)
    assert verdict(here) == verdict(there)
    assert here.score == pytest.approx(there.score, abs=1e-6)
    if definition == "strict":
        assert_same_figures(here.metrics, there.metrics)


@FEW
@given(seed=SEEDS, yaw=st.floats(-7.0, 7.0), x=st.sampled_from([-1e5, 5e5]), y=st.sampled_from([1e5, -5.5e6]))
def test_where_a_drive_is_and_where_it_heads_change_nothing(texts, seed, yaw, x, y):
    values = texts.random(seed)
    here, there = judge(values), judge(texts.turned(values, yaw, x, y))
    assert verdict(here) == verdict(there)
    assert here.score == pytest.approx(there.score, abs=1e-6)
    if here.valid:
        assert here.progress == pytest.approx(there.progress, abs=1e-6)
        del (
            here.metrics["max_jerk"],
            there.metrics["max_jerk"],
        )  # thirds of differences: rounding at 5e6 m over 1e-3 s^3
        assert_same_figures(here.metrics, there.metrics)


@FEW
@given(seed=SEEDS)
def test_how_often_a_drive_is_sampled_changes_no_verdict(texts, seed):
    """The path is left at a sample, so progress is told to a step."""
    values = texts.random(seed)
    record = parse_rollout(values, "drive")
    here, there = score_record(record), judge(texts.halved(values))
    assert verdict(here) == verdict(there)
    if here.valid:
        a_step = 0.1 * here.metrics["max_speed"] / recorded_length(record)
        assert here.progress == pytest.approx(there.progress, abs=a_step if here.left_path_us else 1e-9)
        assert here.metrics["distance_m"] == pytest.approx(there.metrics["distance_m"])


def backwards(texts, speed=5.0, **changes):
    """A drive that backs up along its lane, as no recording did."""
    poses = texts.along_x(speed=-speed)
    return judge(texts.rollout(poses, texts.along_x(), **changes))


def test_backing_up_is_no_progress_and_is_told(texts):
    score = backwards(texts)
    assert (score.score, score.progress) == (0.0, 0.0)
    assert score.metrics["reversed_m"] == pytest.approx(score.metrics["distance_m"]) == pytest.approx(31.5)
    assert judge(texts.rollout(texts.along_x())).metrics["reversed_m"] == 0.0


@pytest.mark.parametrize(("x", "speed"), [(-30.0, 0.0), (-60.0, 4.0), (-60.0, 8.0)])
def test_who_backs_into_those_behind_is_at_fault(texts, x, speed):
    follower = texts.agent(np.add(texts.along_x(speed=speed), [x, 0.0, 0.0]))
    (hit,) = backwards(texts, agents={"follower": follower}).collisions
    assert (hit.side, hit.at_fault, hit.rule) == ("rear", True, "reversing")


def test_who_backs_up_against_its_lane_meets_those_who_drive_in_it(texts):
    """Its heading is that of the lane: what counts is where it goes."""
    poses = np.add(texts.along_x(speed=5.0), [0.0, 3.7, np.pi])
    recorded = texts.along_x()
    comes = texts.agent(np.add(texts.along_x(speed=-5.0), [60.0, 3.7, np.pi]))
    score = judge(texts.rollout(poses, recorded, agents={"comes": comes}))
    (hit,) = score.collisions
    assert (hit.side, hit.at_fault, score.score) == ("rear", True, 0.0)


def test_a_recording_of_another_time_measures_no_progress(texts):
    values = texts.rollout(texts.along_x(speed=0.0), texts.along_x())
    for shift in (-8_000_000, 10**15):
        times = [time_us + shift for time_us in values["gt"]["timestamps_us"]]
        score = judge(values | {"gt": values["gt"] | {"timestamps_us": times}})
        assert (score.valid, score.score, score.progress) == (False, None, None)
        assert "nothing was recorded after the hand-over" in score.reason


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_agents_of_whom_no_sample_counts_are_told(texts, definition):
    between = texts.agent(np.tile([40.0, 0.0, 0.0], (81, 1)))
    between["timestamps_us"] = [time_us + 50_000 for time_us in between["timestamps_us"]]
    beside = texts.agent(np.tile([40.0, 30.0, 0.0], (81, 1)))
    score = judge(texts.rollout(texts.along_x(), agents={"between": between, "beside": beside}), definition)
    (omission,) = [left for left in score.left_out if left.why == "no sample at a time of the drive"]
    assert (omission.what, omission.count, omission.total) == ("agents", 1, 2)
