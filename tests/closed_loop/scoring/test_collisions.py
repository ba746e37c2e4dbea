"""Side and closing speeds of contacts, at their limits."""

import numpy as np
import pytest

from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.collisions import find_collisions, within_reach
from olt_closed_loop.scoring.moving_boxes import MovingBox, agent_box

SECOND = 1_000_000
SIZE = (4.0, 2.0, 1.5)


def make_box(start, change, start_us=0, end_us=SECOND, size=SIZE):
    """A box that changes its x, y, z, yaw evenly over its time."""
    poses = np.array([start, np.add(start, change)], dtype=np.float64)
    return MovingBox(np.array([start_us, end_us], dtype=np.int64), poses, 0.5 * np.array(size))


def make_agent(start, change, size=SIZE, name="agent"):
    box = make_box(start, change)
    return Agent(name, "automobile", *size, box.timestamps_us, box.poses)


def collide(ego, *agents, start_us=0, end_us=SECOND):
    found = find_collisions(ego, agents, [agent_box(agent) for agent in agents], start_us, end_us)
    return found.collisions, found.unreachable


def test_a_box_ahead_is_hit_in_front_with_the_speeds_of_both():
    ego = make_box((0, 0, 0, 0), (8.0, 0, 0, 0))
    ((hit,), left_out) = collide(ego, make_agent((7.0, 0.5, 0, 0), (-2.0, 0, 0, 0)))
    assert (hit.side, left_out) == ("front", 0)
    assert (hit.ego_closing, hit.agent_closing) == pytest.approx((8.0, 2.0))
    assert hit.time_us == pytest.approx(300_000, abs=2)


def test_the_closing_speed_of_an_agent_that_moves_away_is_negative():
    ego = make_box((0, 0, 0, 0), (3.0, 0, 0, 0))
    ((hit,), _) = collide(ego, make_agent((4.5, 0, 0, 0), (2.0, 0, 0, 0)))
    assert (hit.ego_closing, hit.agent_closing) == (pytest.approx(3.0), pytest.approx(-2.0))


@pytest.mark.parametrize(
    ("place", "way", "side"),
    [
        ((-7.0, 0.0), (8.0, 0.0), "rear"),
        ((0.5, 5.0), (0.0, -8.0), "lateral"),
        ((0.5, -5.0), (0.0, 8.0), "lateral"),
        ((7.0, 0.0), (-8.0, 0.0), "front"),
    ],
)
@pytest.mark.parametrize("heading", [0.0, 2.0, np.pi])
def test_the_side_is_that_of_the_ego_whichever_way_it_heads(place, way, side, heading):
    rotation = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    agent = make_agent((*(rotation @ place), 0, heading), (*(rotation @ way), 0, 0))
    ((hit,), _) = collide(make_box((0, 0, 0, heading), (0, 0, 0, 0)), agent)
    assert (hit.side, hit.at_fault) == (side, False)
    assert hit.agent_closing == pytest.approx(8.0)


@pytest.mark.parametrize(("corner", "side"), [(np.pi / 4 - 0.05, "front"), (np.pi / 4 + 0.05, "lateral")])
def test_front_ends_at_half_a_right_angle(corner, side):
    # The corner of the ego meets a wall whose normal is turned by the angle.
    wall = make_agent((*(8.0 * np.array([np.cos(corner), np.sin(corner)])), 0, corner), (0, 0, 0, 0), (2.0, 40.0, 2.0))
    ((hit,), _) = collide(make_box((0, 0, 0, 0), (9.0, 9.0, 0, 0)), wall)
    assert hit.side == side


def test_a_turning_ego_closes_with_the_speed_of_its_point():
    turning = make_box((0, 0, 0, 0), (0, 0, 0, 1.0))
    # The front left corner, 2.236 m from the centre, comes round to a wall beside it.
    ((hit,), _) = collide(turning, make_agent((0.0, 3.0, 0, 0), (0, 0, 0, 0), (20.0, 2.0, 2.0)))
    yaw = np.arcsin(2.0 / np.hypot(2.0, 1.0)) - np.arctan2(1.0, 2.0)
    assert hit.time_us == pytest.approx(yaw * SECOND, abs=5)
    # The corner touches 2 m to the left of the centre and so 1 m ahead of it, at 1 rad/s.
    assert (hit.side, hit.ego_closing) == ("lateral", pytest.approx(1.0, rel=0.02))


def test_a_turning_agent_closes_with_the_speed_of_its_point():
    turning = make_agent((0.0, 3.0, 0, 0), (0, 0, 0, -1.0))
    ((hit,), _) = collide(make_box((3.0, 0, 0, 0), (0, 0, 0, 0), size=(20.0, 2.0, 2.0)), turning)
    assert (hit.side, hit.at_fault) == ("lateral", False)
    assert (hit.ego_closing, hit.agent_closing) == (0.0, pytest.approx(1.0, rel=0.02))


def make_uneven(times_us, x):
    """An ego along x at given places."""
    poses = np.zeros((len(x), 4))
    poses[:, 0] = x
    return MovingBox(np.array(times_us, dtype=np.int64), poses, 0.5 * np.array(SIZE))


def test_speeds_are_those_just_before_the_contact():
    # 2 m/s, then 8 m/s from 0.4 s on, the contact at 0.5 s, then nothing.
    ego = make_uneven([0, 400_000, 500_010, SECOND], [0.0, 0.8, 1.60008, 1.60008])
    ((hit,), _) = collide(ego, make_agent((5.6, 0, 0, 0), (0, 0, 0, 0)))
    assert hit.time_us == pytest.approx(500_000, abs=2)
    assert hit.ego_closing == pytest.approx(8.0)


def appear(ego, agent, start_us=0):
    return find_collisions(ego, [agent], [agent_box(agent)], start_us, int(ego.timestamps_us[-1]))


@pytest.mark.parametrize("heading", np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False))
def test_who_appears_over_the_ego_was_not_hit(heading):
    way = 10.0 * np.array([np.cos(heading), np.sin(heading)])
    ego = make_box((0, 0, 0, heading), (*way, 0, 0))
    late = make_box((*(0.5 * way + 0.05 * way), 0, heading), (*(0.5 * way), 0, 0), start_us=500_000)
    once = MovingBox(late.timestamps_us[:1], late.poses[:1], late.half_size)
    for box in (late, once):
        found = appear(ego, Agent("late", "automobile", *SIZE, box.timestamps_us, box.poses))
        assert (found.collisions, found.appeared, found.handed_over) == ((), ("late",), ())


def test_who_is_over_the_ego_at_the_hand_over_was_not_hit_by_the_policy():
    found = appear(make_box((0, 0, 0, 0), (8.0, 0, 0, 0)), make_agent((1.0, 0, 0, 0), (8.0, 0, 0, 0)), start_us=300_000)
    assert (found.collisions, found.appeared, found.handed_over) == ((), (), ("agent",))


def test_who_appeared_over_the_ego_and_went_away_can_be_hit():
    ego = make_uneven([0, SECOND, 4 * SECOND, 6 * SECOND], [0.0, 0.0, 0.0, 8.0])
    # It backs out of the ego ahead, and stands 2 m before its front.
    poses = np.zeros((3, 4))
    poses[:, 0] = [3.0, 6.0, 6.0]
    agent = Agent("late", "automobile", *SIZE, np.array([SECOND, 3 * SECOND, 6 * SECOND]), poses)
    found = appear(ego, agent)
    assert found.appeared == ("late",)
    assert [(hit.time_us, hit.side, hit.at_fault) for hit in found.collisions] == [
        (pytest.approx(4_500_000, abs=2), "front", True)
    ]


def test_who_is_out_of_reach_in_place_or_time_is_left_out():
    ego = make_box((0, 0, 0, 0), (10.0, 0, 0, 0))
    reach = 2.0 * ego.radius
    for x, y, reached in (
        (10.0 + reach - 0.01, 0.0, True),
        (10.0 + reach + 0.01, 0.0, False),
        (-reach + 0.01, 0.0, True),
        (-reach - 0.01, 0.0, False),
        (5.0, reach - 0.01, True),
        (5.0, reach + 0.01, False),
        (5.0, -reach + 0.01, True),
        (5.0, -reach - 0.01, False),
    ):
        assert within_reach(ego, make_box((x, y, 0, 0), (0, 0, 0, 0)), 0, SECOND) is reached
    for start_us, end_us, reached in (
        (SECOND, 2 * SECOND, True),
        (SECOND + 1, 2 * SECOND, False),
        (-SECOND, 0, True),
        (-SECOND, -1, False),
    ):
        assert within_reach(ego, make_box((5.0, 0, 0, 0), (0, 0, 0, 0), start_us, end_us), 0, SECOND) is reached


def test_collisions_come_in_order_of_time_and_then_of_name():
    ego = make_box((0, 0, 0, 0), (10.0, 0, 0, 0))
    agents = [
        make_agent((x, y, 0, 0), (0, 0, 0, 0), name=name)
        for name, x, y in (("c", 8.0, 0.0), ("b", 6.0, 1.0), ("a", 6.0, -1.0), ("far", 0.0, 50.0))
    ]
    hits, left_out = collide(ego, *agents)
    assert ([hit.agent_id for hit in hits], left_out) == (["a", "b", "c"], 1)
    everyone = find_collisions(ego, agents, list(map(agent_box, agents)), 0, SECOND, skip_unreachable=False)
    assert (everyone.collisions, everyone.unreachable) == (hits, 0)
