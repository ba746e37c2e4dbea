"""Scenes to learn from: apart from the suite, clean, the same each time, and in legs where drives are disturbed."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_closed_loop.evaluation.evaluation import load_scene
from olt_closed_loop.scenes.polylines import resample
from olt_closed_loop.suite.apart import lane_shape
from olt_closed_loop.suite.catalogue import CATEGORIES, EVENTS, LONGTAIL
from olt_closed_loop.suite.disturbances import PUSH_US, Disturbance
from olt_closed_loop.suite.training import (
    GROUPS,
    LAST_IMAGE_US,
    RECOVERY,
    TRAINING_EVENTS,
    find_legs,
    make_training_scene,
    name_in_group,
    training_event,
)
from olt_closed_loop.suite.training_roads import SUITE_WIDTHS, TrainingRoads, draw_lane_width
from olt_generator.errors import InputError
from olt_generator.poses import yaw_of
from olt_generator.seeds import make_generator

FAST = ("gentle_bend", "closed_lane")
BLIND, HESITANT = Disturbance(blind=1.0), Disturbance(hesitant=1.0)


def widths(lane):
    return np.hypot(*(resample(lane.left[:, :2], 5) - resample(lane.right[:, :2], 5)).T)


@given(st.integers(0, 2**31))
def test_lanes_for_training_are_never_as_wide_as_those_of_the_suite(seed):
    width = draw_lane_width(TrainingRoads(seed), 3.4, 3.6)
    assert not SUITE_WIDTHS[0] - 0.01 < width < SUITE_WIDTHS[1] + 0.01
    assert 3.0 < width < 4.1
    assert SUITE_WIDTHS[0] <= draw_lane_width(np.random.default_rng(seed), *SUITE_WIDTHS) <= SUITE_WIDTHS[1]


@pytest.mark.parametrize("seed", [0, 1000])
def test_no_lane_has_the_shape_of_one_of_the_suite(seed):
    suite = [
        lane
        for name, entry in EVENTS.items()
        for lane in entry.make(make_generator("suite event", name, seed)).ground.road_map.lanes
    ]
    training = [lane for name in TRAINING_EVENTS for lane in training_event(name, seed).ground.road_map.lanes]
    assert not {lane_shape(lane) for lane in suite} & {lane_shape(lane) for lane in training}
    # And by no chance: lanes that are as wide all along have a width that no such lane of the suite can have.
    even = {float(widths(lane)[0]) for lane in training if lane.type == "driving" and np.ptp(widths(lane)) < 1e-3}
    of_suite = [float(widths(lane)[0]) for lane in suite if lane.type == "driving" and np.ptp(widths(lane)) < 1e-3]
    assert {round(width, 3) for width in of_suite if not SUITE_WIDTHS[0] <= width <= SUITE_WIDTHS[1]} <= {5.0}
    assert not any(
        SUITE_WIDTHS[0] - 1e-3 <= width <= SUITE_WIDTHS[1] + 1e-3 or round(width, 3) == 5.0 for width in even
    )


def test_groups_are_the_categories_and_the_suite():
    assert sorted(GROUPS["longtail"]) == sorted(LONGTAIL)
    # Few drives show most of the categories already.
    assert len({TRAINING_EVENTS[name].category for name in GROUPS["longtail"][:9]}) >= 3
    assert set(CATEGORIES) | {"nominal", "traffic_light", "stopped_traffic"} <= set(GROUPS)
    assert not set(GROUPS) & set(TRAINING_EVENTS)
    assert {name_in_group("nominal", seed) for seed in range(len(GROUPS["nominal"]))} == set(GROUPS["nominal"])


@pytest.mark.parametrize("name", FAST)
def test_the_same_seed_gives_the_same_drive(name):
    first, second = make_training_scene(name, 3), load_scene(f"training/{name}:3")
    assert np.array_equal(first.ego.T_world_rig, second.ego.T_world_rig) and first.name == second.name
    assert not np.array_equal(first.route, make_training_scene(name, 4).route)
    assert int(first.ego.timestamps_us[-1]) == 20_000_000
    assert first.category == TRAINING_EVENTS[name].category


def test_names_are_checked():
    with pytest.raises(InputError, match="is not one of"):
        load_scene("training/nothing:1")
    with pytest.raises(InputError, match="is no seed"):
        load_scene("training/closed_lane:x")


@given(st.integers(0, 10_000))
def test_legs_follow_each_other(seed):
    disturbance = Disturbance()
    legs = find_legs("open_road", seed, disturbance)
    assert [leg.number for leg in legs] == list(range(len(legs))) and len(legs) >= 3
    assert legs[0].first_us == 0 and legs[-1].last_us == LAST_IMAGE_US
    for before, after in pairwise(legs):
        # Images from before the end of the push; t0 is 1.7 s later at the earliest, when the push is over.
        assert after.first_us + 1_700_000 > before.last_us + PUSH_US
        assert after.first_us < after.last_us
        assert before.last_us % 100_000 == after.first_us % 100_000 == 0
    assert all(leg.end_us >= leg.last_us + 6_400_000 for leg in legs)


@pytest.mark.parametrize("name", FAST)
def test_a_push_moves_the_vehicle_and_is_in_the_history_alone(name):
    disturbance = Disturbance(offset=1.2, angle=0.1, speed=2.0)
    legs = find_legs(name, 5, disturbance)
    scenes = [make_training_scene(name, 5, disturbance, leg.number) for leg in legs]
    moved = []
    for number in range(1, len(legs)):
        push_us = legs[number - 1].last_us
        before, after = scenes[number - 1].ego, scenes[number].ego
        common = int(np.searchsorted(before.timestamps_us, push_us)) - 50
        np.testing.assert_allclose(after.positions[:common], before.positions[:common], atol=0.02)
        at = after.timestamps_us == push_us + PUSH_US
        as_planned = before.interpolate(np.array([push_us + PUSH_US]))[0]
        moved.append(float(np.hypot(*(after.positions[at][0] - as_planned[:3, 3])[:2])))
        assert RECOVERY in scenes[number].factors and RECOVERY not in scenes[0].factors
        # The future of a sample before the push is the plan: it goes on over the push without it.
        assert int(before.timestamps_us[-1]) >= push_us + 6_400_000
    assert max(moved) > 0.4


def test_who_is_blind_comes_nearer_and_who_hesitates_stays_behind():
    """A lane is closed ahead: blind, the vehicle has gone farther when the push is over, hesitant less far."""
    along = {}
    for told, disturbance in (("seen", Disturbance()), ("blind", BLIND), ("hesitant", HESITANT)):
        push_us = find_legs("closed_lane", 3, disturbance)[0].last_us
        ego = make_training_scene("closed_lane", 3, disturbance, 1).ego
        until = ego.timestamps_us <= push_us + PUSH_US
        along[told] = np.hypot(*np.diff(ego.positions[until, :2], axis=0).T).sum()
    assert along["hesitant"] < along["seen"] - 0.5 and along["blind"] > along["seen"] + 2.0


@pytest.mark.parametrize("disturbance", [Disturbance(), BLIND, HESITANT])
@pytest.mark.parametrize("name", FAST)
def test_disturbed_drives_are_physically_smooth(name, disturbance):
    for leg in find_legs(name, 2, disturbance):
        ego = make_training_scene(name, 2, disturbance, leg.number).ego
        times, yaw = ego.times, np.unwrap(yaw_of(ego.T_world_rig))
        velocity = np.gradient(ego.positions[:, :2], times, axis=0)
        speed = np.hypot(*velocity.T)
        assert np.abs(speed * np.gradient(yaw, times)).max() < 6.0
        assert np.abs(np.gradient(speed, times)).max() < 9.0
        slip = np.arctan2(velocity[:, 1], velocity[:, 0]) - yaw
        slip = np.abs(np.remainder(slip + np.pi, 2.0 * np.pi) - np.pi)
        assert slip[speed > 1.0].max() < 0.06
