from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.scoring.definitions import score_rollout
from olt_closed_loop.simulation.closed_loop import replay, stand
from olt_generator.errors import InputError
from olt_generator.omissions import Omission


def score_replay(scene):
    return score_rollout(scene, replay(scene))


def score_standing(scene):
    return score_rollout(scene, stand(scene))


def test_replaying_the_recording_scores_one(straight_scene, moving_agent):
    score = score_replay(straight_scene((moving_agent("car", (20.0, 3.6), (10.0, 0.0)),)))
    assert (score.score, score.progress, score.collided, score.offroad) == (1.0, 1.0, False, False)


def test_standing_makes_no_progress(straight_scene):
    score = score_standing(straight_scene())
    assert (score.valid, score.score, score.progress, score.reason) == (True, 0.0, 0.0, None)


def test_a_wall_is_one_collision_at_fault(straight_scene, moving_agent):
    score = score_replay(straight_scene((moving_agent("wall", (50.0, 0.0), size=(0.5, 8.0, 2.0)),)))
    assert [(c.side, c.at_fault) for c in score.collisions] == [("front", True)]
    assert score.score == 0.0 and score.reason == "collision_at_fault"
    # The front of the ego's box, 4.093 m ahead of the rig, meets the wall's near face at 49.75 m.
    assert score.collisions[0].time_us == pytest.approx(4_565_700, abs=10)
    assert score.collisions[0].ego_closing == pytest.approx(10.0)


def test_a_standing_ego_that_is_run_into_is_not_at_fault(straight_scene, moving_agent):
    agent = moving_agent("tailgater", (-10.0, 0.0), (6.0, 0.0))
    score = score_standing(straight_scene((agent,)))
    assert [(c.side, c.at_fault) for c in score.collisions] == [("rear", False)]
    assert score.collided and not score.collided_at_fault
    assert score.reason is None


def test_a_moving_ego_that_is_hit_from_behind_is_not_at_fault(straight_scene, moving_agent):
    scene = straight_scene((moving_agent("fast", (-20.0, 0.0), (18.0, 0.0)),))
    score = score_replay(scene)
    assert [(c.side, c.at_fault) for c in score.collisions] == [("rear", False)]
    assert score.score == 1.0


def test_whoever_moves_sideways_is_at_fault(straight_scene, moving_agent):
    cuts_in = moving_agent("cuts in", (1.4, 6.0), (10.0, -1.0))
    score = score_replay(straight_scene((cuts_in,)))
    assert [(c.side, c.at_fault) for c in score.collisions] == [("lateral", False)]

    scene = straight_scene((moving_agent("keeps its lane", (1.4, 3.0), (10.0, 0.0)),))
    rollout = replay(scene)
    drifting = rollout.states.copy()
    drifting[:, 1] = np.linspace(0.0, 2.0, len(drifting))
    score = score_rollout(scene, replace(rollout, states=drifting))
    assert [(c.side, c.at_fault) for c in score.collisions] == [("lateral", True)]


@pytest.mark.parametrize("agent_speed", [0.0, 10.0, 15.0, 40.0])
def test_head_on_without_lanes_nothing_excludes_the_fault_of_the_ego(straight_scene, moving_agent, agent_speed):
    agent = moving_agent("oncoming", (60.0 + 4.0 * agent_speed, 1.0), (-agent_speed, 0.0), yaw=np.pi)
    score = score_replay(straight_scene((agent,)))
    assert [(c.side, c.at_fault) for c in score.collisions] == [("front", True)]


def test_a_fast_crossing_between_samples_is_found(straight_scene, moving_agent):
    # A person-sized box at 60 m/s passes the ego's 2.1 m in less than one 0.1 s step.
    standing = stand(straight_scene())
    x = standing.states[-1, 0] + 1.4
    agent = moving_agent("dart", (x, 3.05 + 60.0 * 3.0), (0.0, -60.0), size=(0.5, 0.5, 1.7))
    at_steps = np.abs(agent.poses[:, 1])
    assert at_steps.min() > 1.4
    score = score_standing(straight_scene((agent,)))
    assert [(c.side, c.at_fault) for c in score.collisions] == [("lateral", False)]


def test_what_hangs_above_is_not_touched(straight_scene, moving_agent):
    bridge = moving_agent("bridge", (50.0, 0.0), size=(3.0, 12.0, 1.0), bottom=4.0)
    low = replace(bridge, id="low bridge", poses=bridge.poses - [0.0, 0.0, 3.0, 0.0])
    assert not score_replay(straight_scene((bridge,))).collided
    assert score_replay(straight_scene((low,))).collided


def test_agents_exist_only_while_they_were_recorded(straight_scene, moving_agent):
    wall = moving_agent("wall", (50.0, 0.0), size=(0.5, 8.0, 2.0))
    gone = replace(wall, timestamps_us=wall.timestamps_us[:40], poses=wall.poses[:40])
    assert not score_replay(straight_scene((gone,))).collided


def test_contacts_before_the_hand_over_do_not_count(straight_scene, moving_agent):
    early = moving_agent("early", (10.0, 0.0))
    brief = replace(early, timestamps_us=early.timestamps_us[:15], poses=early.poses[:15])
    assert not score_replay(straight_scene((brief,))).collided


def test_leaving_the_road_scores_zero_however_far_beyond(straight_scene):
    scene = straight_scene()
    rollout = replay(scene)
    aside = rollout.states.copy()
    aside[40:, 1] = -30.0
    score = score_rollout(scene, replace(rollout, states=aside))
    assert score.offroad and score.reason == "offroad" and score.score == 0.0
    assert 3_900_000 < score.offroad_us < 4_000_000


def test_without_a_drivable_area_the_road_is_not_measured(straight_scene):
    score = score_replay(straight_scene(with_road=False))
    assert score.offroad is None
    assert score.score == 1.0
    assert any(omission.what == "road test" for omission in score.left_out)


def test_half_the_way_scores_half_over_four_fifths(straight_scene):
    scene = straight_scene()
    rollout = replay(scene)
    slow = rollout.states.copy()
    slow[17:, 0] = slow[17, 0] + 0.5 * (slow[17:, 0] - slow[17, 0])
    score = score_rollout(scene, replace(rollout, states=slow))
    assert score.progress == pytest.approx(0.5)
    assert score.score == pytest.approx(0.625)


def test_progress_ends_where_the_path_is_left(straight_scene):
    scene = straight_scene(with_road=False)
    rollout = replay(scene)
    away = rollout.states.copy()
    away[49:, 1] = 4.5
    score = score_rollout(scene, replace(rollout, states=away))
    assert score.left_path_us == 4_900_000
    assert score.progress == pytest.approx((48.0 - 17.0) / 63.0)


def test_a_recording_that_hardly_moves_has_full_progress(straight_scene):
    assert score_standing(straight_scene(speed=0.5)).score == 1.0


def busy_scene(straight_scene, moving_agent, generator):
    """Agents all over the place, some of them in the way."""
    agents = [
        moving_agent(
            f"agent {index}",
            tuple(generator.uniform((-40.0, -25.0), (110.0, 25.0))),
            tuple(generator.uniform(-6.0, 6.0, size=2)),
            yaw=generator.uniform(-np.pi, np.pi),
        )
        for index in range(12)
    ]
    return straight_scene(tuple(agents))


def judgement(score):
    """What must not change at all when the scene moves as a whole."""
    return (
        score.reason,
        score.offroad,
        [(c.agent_id, c.side, c.at_fault) for c in score.collisions],
    )


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    yaw=st.floats(-7.0, 7.0),
    x=st.sampled_from([0.0, 123.4, 5e6]),
    y=st.sampled_from([0.0, -5e6]),
)
def test_moving_the_whole_scene_changes_nothing(straight_scene, moving_agent, moved_scene, seed, yaw, x, y):
    scene = busy_scene(straight_scene, moving_agent, np.random.default_rng(seed))
    here, there = score_replay(scene), score_replay(moved_scene(scene, x, y, yaw))
    assert judgement(here) == judgement(there)
    assert here.score == pytest.approx(there.score, abs=1e-6)
    assert here.progress == pytest.approx(there.progress, abs=1e-6)
    for ours, theirs in zip(here.collisions, there.collisions, strict=True):
        assert ours.time_us == pytest.approx(theirs.time_us, abs=20)
        assert ours.ego_closing == pytest.approx(theirs.ego_closing, abs=1e-4)


@pytest.mark.parametrize("yaw", [np.pi, -np.pi, np.pi + 1e-9, 3.0 * np.pi])
def test_heading_west_is_like_heading_east(straight_scene, moving_agent, moved_scene, yaw):
    scene = straight_scene((moving_agent("parked", (50.0, 0.5)),))
    assert judgement(score_replay(moved_scene(scene, 0.0, 0.0, yaw))) == judgement(score_replay(scene))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_order_of_agents_and_skipping_change_nothing(straight_scene, moving_agent, seed):
    generator = np.random.default_rng(seed)
    scene = busy_scene(straight_scene, moving_agent, generator)
    shuffled = replace(scene, agents=tuple(scene.agents[i] for i in generator.permutation(len(scene.agents))))
    score = score_replay(scene)
    assert score_replay(shuffled) == score
    everything = score_rollout(scene, replay(scene), skip=False)
    assert replace(everything, left_out=()) == replace(score, left_out=())


def test_what_is_left_out_is_said(straight_scene, moving_agent):
    far = moving_agent("far", (0.0, 400.0))
    near = moving_agent("near", (40.0, 4.0))
    assert score_replay(straight_scene((far, near))).left_out == (
        Omission("agents in collision tests", "never within reach", count=1, total=2),
    )


def test_a_rollout_of_another_scene_is_refused(straight_scene):
    scene = straight_scene()
    with pytest.raises(InputError, match="another"):
        score_rollout(replace(scene, name="another"), replay(scene))
