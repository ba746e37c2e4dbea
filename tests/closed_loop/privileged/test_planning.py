"""Drives planned with the truth touch nobody, stay on the road, wait where a line is held, and pass when they may."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.privileged.holds import holds_of
from olt_closed_loop.privileged.plan import plan_drive
from olt_closed_loop.privileged.truth import Hold, Truth, box_of
from olt_closed_loop.scenes.actors import SIZES, corners
from olt_closed_loop.scenes.maps.lanes import HUMAN, Lane, Light
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.moving_boxes import separations
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

END_US = 14_000_000
ROAD = shapely.box(-50.0, -5.5, 400.0, 5.5)


def truth(agents=(), holds=(), cruise=10.0):
    """A straight road along x, 11 m wide; the route runs along y = -1.75."""
    route = np.array([[0.0, -1.75], [350.0, -1.75]])
    return Truth(route, ROAD, tuple(agents), tuple(holds), DEFAULT_VEHICLE, cruise, END_US)


def standing(name, x, y, yaw=0.0, label="automobile"):
    length, width, height = SIZES[label]
    poses = np.tile([x, y, height / 2, yaw], (2, 1))
    return Agent(name, label, length, width, height, np.array([0, END_US]), poses)


def moving(name, x, y, speed, yaw=0.0, label="automobile"):
    """An agent that is at (x, y) at time 0."""
    length, width, height = SIZES[label]
    times = np.arange(0, END_US + 1, 100_000)
    way = speed * times * 1e-6
    pose = np.column_stack([x + way * np.cos(yaw), y + way * np.sin(yaw), np.full(len(times), height / 2)])
    return Agent(name, label, length, width, height, times, np.column_stack([pose, np.full(len(times), yaw)]))


def driven(given_truth, speed=10.0):
    """Box poses (n, 4) of the drive every 20 ms, and their times."""
    drive = plan_drive(given_truth, 0, 20.0, -1.75, speed)
    times = np.arange(0, END_US, 20_000)
    return given_truth.box_poses(*drive.poses(times)), times


def gap(poses, times, agent, ego):
    box = box_of(agent)
    there = box.covers(times)
    found, _ = separations(poses[there], ego.half_size, box.at(times[there]), box.half_size)
    return found[:, :4].max(axis=1).min()


def test_without_anybody_it_follows_the_route_at_cruising_speed():
    poses, _ = driven(truth())
    np.testing.assert_allclose(poses[:, 1], -1.75, atol=1e-3)
    np.testing.assert_allclose(np.diff(poses[:, 0]) / 0.02, 10.0, atol=0.1)


@settings(max_examples=12, deadline=None)
@given(
    x=st.floats(60.0, 110.0),
    y=st.floats(-3.5, 0.5),
    yaw=st.floats(-0.4, 0.4),
    label=st.sampled_from(["automobile", "cone", "heavy_truck", "person"]),
)
def test_it_passes_who_stands_in_the_lane_on_the_road(x, y, yaw, label):
    agent = standing("obstacle", x, y, yaw, label)
    given_truth = truth([agent])
    poses, times = driven(given_truth)
    assert gap(poses, times, agent, given_truth) > 0.1
    assert shapely.covers(ROAD, shapely.polygons(corners(poses, given_truth.half_size))).all()
    assert poses[-1, 0] > x + 10.0


@settings(max_examples=12, deadline=None)
@given(meets=st.floats(3.0, 8.0), speed=st.floats(2.0, 10.0), side=st.sampled_from([-1.0, 1.0]))
def test_it_touches_nobody_who_crosses(meets, speed, side):
    crosser = moving("crosser", 80.0, -1.75 - side * speed * meets, speed, side * np.pi / 2)
    given_truth = truth([crosser])
    poses, times = driven(given_truth)
    assert gap(poses, times, crosser, given_truth) > 0.1
    assert poses[-1, 0] > 90.0


def test_it_waits_for_oncoming_traffic_before_it_passes():
    oncoming = [moving(f"oncoming_{i}", 110.0 + 11.0 * i, 1.75, 9.0, np.pi) for i in range(4)]
    agents = [standing("van", 80.0, -2.3), *oncoming]
    given_truth = truth(agents)
    poses, times = driven(given_truth)
    assert min(gap(poses, times, agent, given_truth) for agent in agents) > 0.1
    assert poses[-1, 0] > 90.0
    free, _ = driven(truth(agents[:1]))
    assert poses[-1, 0] < free[-1, 0] - 5.0


def test_it_overtakes_who_is_slow_and_stays_behind_where_it_cannot():
    slow = moving("slow", 60.0, -1.75, 3.0)
    poses, times = driven(truth([slow]))
    assert gap(poses, times, slow, truth()) > 0.1
    assert poses[-1, 0] > slow.poses[-1, 0] + 5.0
    wall = [moving(f"oncoming_{i}", 80.0 + 11.0 * i, 1.75, 9.0, np.pi) for i in range(30)]
    poses, times = driven(truth([slow, *wall]))
    assert min(gap(poses, times, agent, truth()) for agent in (slow, *wall)) > 0.1
    assert poses[-1, 0] < slow.poses[-1, 0]


@pytest.mark.parametrize("until", [6.0, 9.0])
def test_a_held_line_is_not_passed_until_it_is_free(until):
    hold = Hold(np.array([[90.0, 0.0], [90.0, -3.5]]), 0, round(until * 1e6))
    poses, times = driven(truth(holds=[hold]))
    front = poses[:, 0] + DEFAULT_VEHICLE.length / 2
    assert front[times < hold.until_us].max() < 90.0
    assert front[-1] > 95.0


def test_a_hand_outranks_a_light_and_other_lanes_lights_do_not_count():
    left = np.array([0.0, 1.75, 0.0])
    line = np.array([[90.0, -1.75, 0.0], [120.0, -1.75, 0.0]])
    own = Lane("own", line, line + left, line - left)
    aside = line + np.array([0.0, 30.0, 0.0])
    other = Lane("other", aside, aside + left, aside - left)
    times = np.array([0, 5_000_000])
    red, person = (
        Light("lamp", ("own",), times, ("red", "green")),
        Light(f"{HUMAN}_1", ("own",), times, ("green", "red")),
    )
    far = Light("far", ("other",), times, ("red", "red"))
    route = np.array([[0.0, -1.75], [350.0, -1.75]])
    (hold,) = holds_of((own, other), (red, far), route, END_US)
    assert (hold.from_us, hold.until_us) == (0, 5_000_000)
    (hold,) = holds_of((own, other), (red, person, far), route, END_US)
    assert (hold.from_us, hold.until_us) == (5_000_000, END_US)
