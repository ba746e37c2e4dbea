"""Extreme scenes: scored as they should be, or refused in words."""

from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.privileged.driver import PrivilegedDriver
from olt_closed_loop.scenes.maps.arms import Arm
from olt_closed_loop.scenes.maps.junctions import junction
from olt_closed_loop.scenes.polylines import length_of, points_along
from olt_closed_loop.scenes.scene import Agent, Lane
from olt_closed_loop.scenes.scene_map import map_of, with_map
from olt_closed_loop.scoring.definitions import DEFINITIONS, DefinitionName, score_rollout
from olt_closed_loop.simulation.closed_loop import replay, simulate
from olt_generator.errors import InputError
from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory

SPEED = 10.0


def score(scene, definition: DefinitionName = "strict"):
    return score_rollout(scene, replay(scene), definition=definition)


def along_with(first_us: int, apart: float = 0.0) -> Agent:
    """A car that is there from a time on, at the place of the ego's box or so far to its left, at the ego's speed."""
    times = np.arange(first_us, 8_000_001, 100_000, dtype=np.int64)
    poses = np.column_stack([1.4 + SPEED * times * 1e-6, np.full((len(times), 3), [apart, 0.8, 0.0])])
    return Agent("ghost", "automobile", 4.5, 1.9, 1.6, times, poses)


def figure_of_eight(y: float = 0.0) -> Lane:
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    center = np.column_stack([40.0 + 40.0 * np.sin(turn), y + 30.0 * np.sin(turn) * np.cos(turn), 0.0 * turn])
    aside = np.array([0.0, 1.8, 0.0])
    return Lane("eight", center, center + aside, center - aside)


@pytest.mark.parametrize("first_us", [0, 4_000_000])
def test_who_appears_inside_the_ego_has_not_been_hit_and_that_is_said(straight_scene, first_us):
    result = score(straight_scene((along_with(first_us),)))
    assert result.score == 1.0 and not result.collided
    assert [omission.what for omission in result.left_out] == ["contact with ghost"]


def test_who_appears_inside_the_ego_and_comes_back_is_hit(straight_scene):
    ghost = along_with(3_000_000)
    away = np.interp(ghost.timestamps_us * 1e-6, [3.5, 4.5, 5.5, 6.5], [0.0, 3.5, 3.5, 0.0])
    poses = ghost.poses.copy()
    poses[:, 1] = away
    result = score(straight_scene((replace(ghost, poses=poses),)))
    assert result.collided and 5_500_000 < result.collisions[0].time_us < 6_500_000


@pytest.mark.parametrize("heading", [np.pi, -np.pi, np.nextafter(np.pi, 0.0), 3.0 * np.pi])
@pytest.mark.parametrize("ahead", [40.0, 400.0])
def test_headings_across_half_a_turn_change_nothing(straight_scene, moving_agent, moved_scene, heading, ahead):
    scene = straight_scene((moving_agent("other", (ahead, 0.0)), moving_agent("across", (20.0, 30.0), yaw=np.pi)))
    one, other = (score(one) for one in (scene, moved_scene(scene, 0.0, 0.0, heading)))
    assert one.score == other.score == (0.0 if ahead < 100.0 else 1.0)
    assert [hit.side for hit in one.collisions] == [hit.side for hit in other.collisions]
    assert one.metrics["max_yaw_rate"] == pytest.approx(other.metrics["max_yaw_rate"], abs=1e-9)


def test_an_agent_that_turns_across_half_a_turn_turns_the_shorter_way(straight_scene):
    """It stands beside the ego's way; by a turn the longer way it would reach into that as the ego passes."""
    times = np.arange(0, 8_000_001, 500_000, dtype=np.int64)
    passed = times >= 5_000_000

    def turning(before: float, after: float) -> Agent:
        poses = np.tile([52.0, 3.2, 0.8, 0.0], (len(times), 1))
        poses[:, 3] = np.where(passed, after, before)
        return Agent("turns", "automobile", 4.5, 1.9, 1.6, times, poses)

    assert score(straight_scene((turning(np.pi - 0.05, -np.pi + 0.05),))).score == 1.0
    assert score(straight_scene((turning(np.pi / 2 - 0.25, np.pi / 2 + 0.25),))).collided


@pytest.mark.parametrize("place", [(1e6, -1e6), (-1e6, 1e6)])
def test_a_million_metres_away_everything_is_as_it_was(straight_scene, moving_agent, moved_scene, place):
    scene = straight_scene((moving_agent("ahead", (60.0, 0.5), (3.0, 0.0)),))
    near, far = score(scene), score(moved_scene(scene, *place, 0.7))
    assert near.collided == far.collided and near.score == far.score
    assert near.collisions[0].time_us == pytest.approx(far.collisions[0].time_us, abs=1000)
    assert check_gate(moved_scene(straight_scene(), *place, 0.7)).passed


@pytest.mark.parametrize("steps", [1, 2])
def test_scenes_of_one_step_are_refused_in_words(straight_scene, steps):
    scene = straight_scene()
    short = replace(scene, ego=Trajectory(scene.ego.timestamps_us[:steps], scene.ego.T_world_rig[:steps]))
    with pytest.raises(InputError, match="leaves nothing after the warm-up"):
        check_gate(short)


def test_500_agents_are_scored_like_those_that_matter(straight_scene, moving_agent):
    crowd = tuple(moving_agent(f"one_{i}", (20.0 + 3.0 * (i % 50), 30.0 + 5.0 * (i // 50))) for i in range(499))
    ahead = moving_agent("ahead", (60.0, 0.0))
    few, many = score(straight_scene((ahead,))), score(straight_scene((*crowd, ahead)))
    assert (many.score, many.collided, many.collisions) == (few.score, few.collided, few.collisions)
    assert score(straight_scene(crowd)).score == 1.0


@pytest.mark.parametrize("order", [slice(None, None, -1), [0, 0, 1]], ids=["reversed", "repeated"])
def test_time_that_runs_back_or_stands_is_refused(straight_scene, moving_agent, order):
    scene, agent = straight_scene(), moving_agent("other", (30.0, 20.0))
    with pytest.raises(InputError, match="not after the one before"):
        Trajectory(scene.ego.timestamps_us[order], scene.ego.T_world_rig[order])
    with pytest.raises(InputError, match=r"agent other: time .* is not after the one before"):
        replace(agent, timestamps_us=agent.timestamps_us[order], poses=agent.poses[order])


@pytest.mark.parametrize("size", [(0.0, 0.0, 0.0), (0.0, 2.0, 1.5), (2.0, 0.0, 1.5), (2.0, 2.0, 0.0)])
def test_boxes_without_an_extent_are_hit_where_they_are(straight_scene, moving_agent, size):
    for y, expected in ((0.0, True), (20.0, False)):
        result = score(straight_scene((moving_agent("thin", (40.0, y), size=size, bottom=0.5),)))
        assert result.collided is expected and result.score is not None


def test_lanes_that_cross_themselves_are_lanes(straight_scene):
    scene = replace(straight_scene(), lanes=(figure_of_eight(),))
    for definition in DEFINITIONS:
        result = score(scene, definition)
        assert result.score in (1.0, None) and not result.failed
    found = map_of(scene).nearest(np.array([[40.0, 0.0, 0.0], [40.0, 300.0, 0.0]]))
    assert found.lanes.tolist() == [0, -1]


def test_without_a_lane_under_the_ego_the_road_is_not_measured(straight_scene):
    scene = replace(straight_scene(with_road=False), lanes=(figure_of_eight(500.0),))
    result = score(scene)
    assert result.offroad is None
    assert [omission.what for omission in result.left_out] == ["road test"]


@pytest.mark.parametrize("goal", ["arm1_out_0", "arm3_out_0"])
def test_curves_of_four_metres_are_driven(straight_scene, goal):
    """The recording scores 1 and so does who plans for himself; the gate holds, or says what does not."""
    road_map = junction([Arm(k * np.pi / 2, length=60.0) for k in range(4)], turn_radius=4.0)
    line = road_map.route_line(road_map.route("arm2_in_0", goal))
    seconds = np.arange(0.0, 12.01, 0.1)
    places = points_along(line, length_of(line) / 2 - 18.0 + 3.0 * seconds)
    yaw = np.unwrap(np.arctan2(np.gradient(places[:, 1]), np.gradient(places[:, 0])))
    ego = Trajectory(np.round(seconds * 1e6).astype(np.int64), planar_pose(places[:, 0], places[:, 1], yaw))
    scene = with_map(replace(straight_scene(), route=line, ego=ego), road_map)
    assert {score(scene, definition).score for definition in DEFINITIONS} == {1.0}
    driven = score_rollout(scene, simulate(scene, PrivilegedDriver(scene)))
    assert driven.score == 1.0 and not driven.collided
    gate = check_gate(scene)
    assert gate.passed or "driving along" in (gate.why_not or "")
