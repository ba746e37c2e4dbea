"""The table in `olt_closed_loop.scoring.definitions`: each case that `strict` and `alpasim` judge differently."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.evaluation.score_table import summarize_scores
from olt_closed_loop.rollouts.rollout_files import parse_rollout
from olt_closed_loop.scoring.alpasim.scores import score_as_alpasim
from olt_closed_loop.scoring.definitions import DEFINITIONS, score_record, score_rollout
from olt_closed_loop.simulation.closed_loop import replay


@pytest.fixture(scope="session")
def judge(texts):
    """Scores a rollout by both definitions, strict first."""

    def both(poses, **changes):
        record = parse_rollout(texts.rollout(poses, **changes), "drive")
        return score_record(record), score_record(record, "alpasim")

    return both


def standing_agent(texts, x, y=0.0, **size):
    return texts.agent(np.tile([x, y, 0.0], (81, 1)), **size)


def behind(poses, overlap):
    """Box poses of a car that overlaps the rear of an ego that drives along x with these rig poses."""
    return np.add(poses, [1.3965 - 0.5 * (5.393 + 4.6) + overlap, 0.0, 0.0])


def test_a_crossing_between_two_samples(judge, texts):
    standing = texts.along_x(speed=0.0)
    # 60 m/s across the ego's nose, 3 m to either side of it at the samples.
    dart = np.array([[3.0, 3.0 + 6.0 * (40 - index), -np.pi / 2] for index in range(81)])
    strict, alpasim = judge(standing, agents={"dart": texts.agent(dart, size=(0.5, 0.5, 1.7))})
    assert [(c.agent_id, c.side) for c in strict.collisions] == [("dart", "lateral")]
    assert not strict.collided_at_fault
    assert alpasim.collided is False


def test_two_centimetres_of_a_corner(judge, texts):
    beside = standing_agent(texts, 40.0, 0.5 * (2.109 + 1.9) - 0.02)
    strict, alpasim = judge(texts.along_x(), agents={"parked": beside})
    assert strict.collided_at_fault and not alpasim.collided


def test_a_bridge_above_the_road(judge, texts):
    bridge = texts.agent(np.tile([40.0, 0.0, 0.0, 5.0], (81, 1)), size=(3.0, 12.0, 1.0))
    strict, alpasim = judge(texts.along_x(), agents={"bridge": bridge})
    assert (strict.collided, strict.score) == (False, 1.0)
    assert (alpasim.collided, alpasim.score) == (True, 0.0)


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, np.pi, -1.0])
def test_hit_ahead_and_behind_at_once(texts, yaw):
    """Heading west AlpaSim names the hit behind alone, because of where the agents are."""
    tail = behind(texts.along_x()[30:], 0.1)
    tail[0, 0] -= 0.5
    agents = {"parked": standing_agent(texts, 36.7), "tail": texts.agent(tail, 30)}
    record = parse_rollout(texts.turned(texts.rollout(texts.along_x(), agents=agents), yaw), "drive")
    strict = score_record(record)
    assert {(c.agent_id, c.side, c.at_fault) for c in strict.collisions} == {
        ("parked", "front", True),
        ("tail", "rear", False),
    }
    final = score_as_alpasim(record).final
    if yaw == 0.0:
        assert final["collision_front"] == 1.0
    if yaw == np.pi:
        assert (final["collision_front"], final["collision_rear"]) == (0.0, 1.0)


def test_tapped_from_behind_and_then_driving_into_a_parked_car(judge, texts):
    tap = behind(texts.along_x()[24:28], 0.15)
    tap[0, 0] -= 0.5
    agents = {"tap": texts.agent(tap, 24), "parked": standing_agent(texts, 60.0)}
    strict, alpasim = judge(texts.along_x(), agents=agents)
    assert (strict.score, strict.reason, strict.incidents, strict.incidents_at_fault) == (
        0.0,
        "collision_at_fault",
        2,
        1,
    )
    assert (alpasim.reason, alpasim.incidents, alpasim.incidents_at_fault) == (None, 1, 0)


def test_a_standing_ego_that_is_hit_from_the_side(judge, texts):
    comes = np.array([[1.4, 15.0 - 0.5 * index, -np.pi / 2] for index in range(81)])
    strict, alpasim = judge(texts.along_x(speed=0.0), agents={"comes": texts.agent(comes)})
    assert strict.collided and not strict.collided_at_fault
    assert alpasim.collided_at_fault


def test_the_whole_drive_beside_the_road(judge, texts):
    strict, alpasim = judge(texts.along_x(y=-8.0))
    assert (strict.offroad, strict.offroad_us, strict.score) == (True, 1_700_000, 0.0)
    assert (alpasim.offroad, alpasim.score) == (False, 1.0)


@given(y=st.floats(-30.0, 30.0), yaw=st.floats(-7.0, 7.0))
@settings(max_examples=25)
def test_the_road_ends_at_its_edges_whichever_way_they_are_drawn(texts, y, yaw):
    values = texts.rollout(texts.along_x(y=y))
    values["map"]["road_edges"][0].reverse()
    score = score_record(parse_rollout(texts.turned(values, yaw), "drive"))
    beyond = y - 0.5 * 2.109 < -2.45 or y + 0.5 * 2.109 > 6.15
    if abs(y - 0.5 * 2.109 + 2.45) > 1e-6 and abs(y + 0.5 * 2.109 - 6.15) > 1e-6:
        assert score.offroad == beyond


def test_the_proper_lane_heading_west(texts):
    poses = texts.along_x()
    poses[:, 1] = 0.02 * np.sin(poses[:, 0])
    poses[:, 2] = 0.02 * np.cos(poses[:, 0])
    record = parse_rollout(texts.turned(texts.rollout(poses), np.pi), "drive")
    assert score_record(record).metrics["wrong_way"] is False
    assert score_as_alpasim(record).final["wrong_lane"] == 1.0
    against = parse_rollout(texts.rollout(texts.along_x(y=3.7)), "drive")
    assert score_record(against).metrics["wrong_way"] is True


def test_a_path_that_passes_the_same_place_twice(judge, texts):
    """The recording drives two rounds; the ego stands. AlpaSim's projection may take either round."""
    angle = np.linspace(0.0, 4.0 * np.pi, 201)
    rounds = np.column_stack([20.0 * np.sin(angle), 20.0 * (1.0 - np.cos(angle)), angle])
    rounds[101:, :2] *= 0.999
    stays = rounds[:201].copy()
    stays[20:] = rounds[20]
    stays[20:, :2] *= 0.9985
    strict, alpasim = judge(stays, recorded=rounds, map=None)
    assert strict.progress is not None and strict.progress < 0.05
    assert alpasim.metrics["progress"] == pytest.approx(0.6, abs=0.01)


def test_a_perfect_drive_of_the_first_half(judge, texts):
    strict, alpasim = judge(texts.along_x(count=81), recorded=texts.along_x(count=161))
    assert (strict.progress, strict.score) == (1.0, 1.0)
    assert alpasim.progress == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("place", [1e6, 5e6])
def test_far_from_the_origin(texts, place):
    agents = {"parked": standing_agent(texts, 60.0)}
    here = texts.rollout(texts.along_x(), agents=agents)
    near, far = (parse_rollout(values, "drive") for values in (here, texts.turned(here, 0.3, place, -place)))
    ours = [score_record(record) for record in (near, far)]
    assert ours[0].collisions[0].time_us == pytest.approx(ours[1].collisions[0].time_us, abs=2)
    assert ours[0].progress == pytest.approx(ours[1].progress, abs=1e-9)
    theirs = [score_as_alpasim(record).raw["dist_traveled_m"] for record in (near, far)]
    assert theirs[0] is not None and abs(theirs[1] - theirs[0]) > 1e-3


def test_a_pose_that_is_not_finite_hides_no_other_rollout(straight_scene):
    scene = straight_scene()
    good = replay(scene)
    states = good.states.copy()
    states[30, 0] = np.nan
    scores = [score_rollout(scene, rollout) for rollout in (good, replace(good, states=states))]
    assert not scores[1].valid and scores[1].reason == "the state at 3000000 us is not finite"
    row = summarize_scores(scores).overall
    assert (row.rollouts, row.valid, row.alpasim_score) == (2, 1, 1.0)


def test_every_definition_is_named_in_full(straight_scene):
    scene = straight_scene()
    assert score_rollout(scene, replay(scene), definition="alpasim").definition == "alpasim@3032e0c"
    for definition in DEFINITIONS:
        score = score_rollout(scene, replay(scene), definition=definition)
        assert score.definition == score.to_dict()["definition"] == definition
    # The small scene has no lanes: AlpaSim refuses to score it, and says so.
    assert not score.valid and "no lanes" in score.reason


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000))
def test_leaving_out_changes_no_number(texts, seed):
    record = parse_rollout(texts.random(seed), "drive")
    skipped, everything = score_record(record), score_record(record, skip=False)
    assert replace(skipped, left_out=()) == replace(everything, left_out=())


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), yaw=st.floats(-4.0, 4.0))
def test_turning_the_world_changes_no_judgement(texts, seed, yaw):
    values = texts.random(seed)
    here, there = (score_record(parse_rollout(v, "drive")) for v in (values, texts.turned(values, yaw, 5e6, -5e6)))
    assert (here.reason, here.offroad) == (there.reason, there.offroad)
    assert [(c.agent_id, c.side, c.at_fault) for c in here.collisions] == [
        (c.agent_id, c.side, c.at_fault) for c in there.collisions
    ]
    assert here.progress == pytest.approx(there.progress, abs=1e-6)
