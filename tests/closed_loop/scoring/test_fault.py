"""The defensive driver, lanes and lights, each against what follows by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.rollouts.rollout_record import LaneLines
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.fault.driver import (
    DECELERATION,
    DELAY,
    PERCEPTION,
    RAMP,
    could_avoid,
    foreseen_at,
    in_the_way_at,
    look_back,
    since,
    time_to_stop,
    visible_at,
)
from olt_closed_loop.scoring.fault.encounter import Site
from olt_closed_loop.scoring.fault.lanes import LaneMap, entered_on_red
from olt_closed_loop.scoring.moving_boxes import MovingBox, agent_box, stretches

SECOND = 1_000_000
SIZE = (4.0, 2.0, 1.5)


def moving(start, velocity, seconds=10.0, size=SIZE, yaw=0.0):
    """A box at constant velocity, sampled every 0.1 s."""
    times = np.arange(0, round(seconds * SECOND) + 1, 100_000, dtype=np.int64)
    poses = np.zeros((len(times), 4))
    poses[:, :2] = np.array(start) + times[:, None] * 1e-6 * np.array(velocity)
    poses[:, 3] = yaw
    return MovingBox(times, poses, 0.5 * np.array(size))


def braking_distance(speed):
    """Metres from a risk that shows to standing: reaction, ramp and full braking, integrated by hand."""
    slower = 0.5 * DECELERATION * RAMP
    ramp = speed * RAMP - DECELERATION * RAMP**2 / 6.0
    return speed * (PERCEPTION + DELAY) + ramp + (speed - slower) ** 2 / (2.0 * DECELERATION)


@given(speed=st.floats(5.0, 30.0))
@settings(max_examples=20)
def test_a_wall_is_avoided_from_exactly_the_braking_distance_on(speed):
    driver, way = moving((0.0, 0.0), (speed, 0.0)), braking_distance(speed)
    for more, avoided in ((0.05, True), (-0.05, False)):
        wall = moving((4.0 + way + more, 0.0), (0.0, 0.0))
        contact_us = round((way + more) / speed * SECOND)
        assert could_avoid(driver, wall, 0, contact_us, 0) is avoided


def test_nobody_brakes_before_it_drives():
    driver, wall = moving((0.0, 0.0), (10.0, 0.0)), moving((4.0 + 40.0, 0.0), (0.0, 0.0))
    assert could_avoid(driver, wall, 0, 4 * SECOND, 0)
    assert not could_avoid(driver, wall, 0, 4 * SECOND, 3_400_000)
    assert not could_avoid(driver, wall, 0, 4 * SECOND, 5 * SECOND)


def test_braking_does_not_help_against_who_comes_on():
    driver, oncoming = moving((0.0, 0.0), (10.0, 0.0)), moving((104.0, 0.0), (-10.0, 0.0), yaw=np.pi)
    assert not could_avoid(driver, oncoming, 0, 5 * SECOND, 0)


def test_the_time_to_stop_is_that_of_the_model():
    assert time_to_stop(0.0) == pytest.approx(1.45)
    assert time_to_stop(DECELERATION) == pytest.approx(2.45)


def test_a_steady_course_is_foreseen_for_as_long_as_is_looked_back():
    driver, crossing = moving((0.0, 0.0), (10.0, 0.0)), moving((70.0, -70.0), (0.0, 10.0), yaw=np.pi / 2)
    times = look_back(driver, crossing, 6_800_000)
    assert len(times) == 61
    assert since(foreseen_at(driver, crossing, times), times) == times[0]
    # Its front is 0.375 m beside the strip of the ego after 6.66 s.
    assert since(in_the_way_at(driver, crossing, times), times) == 6_700_000


def test_misses_of_up_to_half_a_second_count_for_nothing():
    times = np.arange(10, dtype=np.int64)
    flags = np.ones(10, dtype=bool)
    flags[2:7] = False
    assert since(flags, times) == 0
    flags[7] = False
    assert since(flags, times) == 8
    flags[-1] = False
    assert since(flags, times) is None


def test_a_van_hides_who_walks_behind_it_and_a_low_wall_does_not():
    driver, person = moving((0.0, 0.0), (0.0, 0.0)), moving((20.0, -6.0), (0.0, 1.0), size=(0.5, 0.5, 1.8))
    times = np.arange(0, 9 * SECOND, 100_000, dtype=np.int64)
    van = moving((15.0, -3.0), (0.0, 0.0), size=(6.0, 3.0, 2.5))
    seen = visible_at(driver, person, [van], times)
    assert not seen[0] and seen[-1]
    # Above the line from the eye past the corner of the van (18, -1.5) every part is seen.
    first = int(np.argmax(seen))
    assert (-6.0 + times[first] * 1e-6) + 0.25 == pytest.approx(-1.5 * 19.75 / 12.0, abs=1.1)
    low = replace(van, half_size=np.array([3.0, 1.5, 0.5]))
    assert visible_at(driver, person, [low], times).all()


def straight_lane(start, end, **more):
    line = np.linspace([*start, 0.0], [*end, 0.0], 20)
    ahead = (line[-1] - line[0])[:2] / np.linalg.norm(line[-1] - line[0])
    left = 1.85 * np.array([-ahead[1], ahead[0], 0.0])
    return LaneLines(line, line + left, line - left, **more)


def test_own_lanes_are_those_that_run_the_way_and_what_leads_on():
    lanes = LaneMap(
        (
            straight_lane((0, 0), (50, 0)),
            straight_lane((50, 0), (100, 0)),
            straight_lane((100, 3.7), (0, 3.7)),
            straight_lane((0, -3.7), (100, -3.7)),
        ),
        np.zeros(2),
    )
    body = moving((20.0, 0.3), (5.0, 0.0))
    assert lanes.own(body, 0) == {0, 1}
    assert lanes.own(replace(body, poses=body.poses + np.array([0.0, 0.0, 0.0, np.pi])), 0) == set()
    assert lanes.deep_in(np.array([50.0, 1.6]), {0, 1})
    assert not lanes.deep_in(np.array([50.0, 1.7]), {0, 1})
    assert lanes.touches(np.array([50.0, 2.0]), {0, 1}) and not lanes.touches(np.array([50.0, 2.1]), {0, 1})


def test_who_enters_a_lane_on_red_and_who_on_green():
    red = np.array([[0, 2 * SECOND], [6 * SECOND, 8 * SECOND]])
    body = moving((-30.0, 0.0), (10.0, 0.0))  # comes onto the lane after 3 s
    for phases, answer in ((red, False), (red + 2 * SECOND, True), (np.empty((0, 2), np.int64), False), (None, None)):
        lanes = LaneMap((straight_lane((0, 0), (90, 0), red_us=phases),), np.zeros(2))
        assert entered_on_red(lanes, body, 5 * SECOND) is answer


def test_the_offset_from_the_recorded_way_goes_on_straight_beyond_its_end():
    site = Site(recorded=np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]]))
    assert site.offset(np.array([[5.0, 1.0], [100.0, 2.0], [-50.0, -3.0]])) == pytest.approx([1.0, 2.0, 3.0])
    assert site.offset(np.array([[5.0, 1.0]])) == pytest.approx([1.0])
    assert (Site().offset(np.ones((2, 2))) == 0.0).all()


def agent_at(times, x):
    poses = np.zeros((len(times), 4))
    poses[:, 0] = x
    return Agent("a", "automobile", *SIZE, np.array(times, dtype=np.int64), poses)


def test_an_agent_that_is_away_is_not_there():
    times = [0, 100_000, 200_000, 900_000, 1_000_000]
    parts = list(stretches([agent_at(times, 0.0)]))
    assert [part.timestamps_us.tolist() for part in parts] == [times[:3], times[3:]]
    # Half a second is the usual step of some recordings, and a standing agent may have two samples only.
    for times in ([0, 500_000, 1_000_000, 2_500_000], [0, 20 * SECOND], [0, 100_000, 600_000], [7]):
        assert [part.timestamps_us.tolist() for part in stretches([agent_at(times, 0.0)])] == [times]


def test_an_agent_that_jumps_ends_and_begins_anew():
    parts = list(stretches([agent_at([0, 100_000, 200_000, 300_000], [0.0, 1.0, 31.0, 32.0])]))
    assert [len(agent_box(part).timestamps_us) for part in parts] == [2, 2]
