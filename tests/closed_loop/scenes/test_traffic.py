"""Dense traffic, and drives with a prescribed speed."""

import itertools

import numpy as np
import pytest

from olt_closed_loop.scenes.actors import SIZES, clearance, ego_agent
from olt_closed_loop.scenes.driving import EgoMotion, drive_at_speed
from olt_closed_loop.scenes.events import EGO_FRONT
from olt_closed_loop.scenes.roads import LANE_WIDTH, Road, lay_road
from olt_closed_loop.scenes.traffic import Lead, Stream, place_lead, place_parked, place_stream
from olt_generator.poses import yaw_of
from olt_generator.seeds import make_generator
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

CENTER = -1.5 * LANE_WIDTH


@pytest.fixture(scope="module")
def road() -> Road:
    return lay_road([(0.0, 0.0), (100.0, 0.0), (140.0, 1 / 200.0)], 0.7, 420.0, 3, 2.0)


@pytest.fixture(scope="module")
def ego(road: Road) -> EgoMotion:
    return drive_at_speed(road, CENTER, 80.0, np.array([0.0, 4.0]), np.array([10.0, 10.0]))


def test_the_drive_has_the_speeds_that_are_prescribed(road: Road) -> None:
    times, speeds = np.array([0.0, 2.0, 4.0, 5.0]), np.array([0.0, 6.0, -2.0, -2.0])
    motion = drive_at_speed(road, CENTER, 80.0, times, speeds).trajectory
    steps = np.diff(motion.positions[:, :2], axis=0) / np.diff(motion.times)[:, None]
    heading = yaw_of(motion.T_world_rig)[:-1]
    along = np.cos(heading) * steps[:, 0] + np.sin(heading) * steps[:, 1]
    middle = 0.5 * (motion.times[1:] + motion.times[:-1])
    np.testing.assert_allclose(along, np.interp(middle, times, speeds), atol=0.02)
    np.testing.assert_allclose(motion.positions[0, :2], road.locate(80.0, CENTER), atol=1e-3)
    assert np.abs(np.diff(heading)).max() < 0.01, "it keeps its heading when it reverses"


def test_a_bend_turns_the_road_by_its_angle() -> None:
    road = lay_road([(0.0, 0.0), (50.0, 0.0), (60.0, 0.05), (90.0, 0.05), (100.0, 0.0)], 0.2, 150.0, 1, 2.0)
    turned = float(road.heading(140.0) - road.heading(10.0))
    assert turned == pytest.approx(0.05 * (30.0 + 10.0), abs=1e-3)


@pytest.mark.parametrize("stops", [False, True])
@pytest.mark.parametrize("offset", [-0.5 * LANE_WIDTH, -2.5 * LANE_WIDTH, 0.5 * LANE_WIDTH])
def test_a_stream_fills_its_lane_without_touching(road: Road, ego: EgoMotion, offset: float, stops: bool) -> None:
    stream = Stream(offset, 6.0, 8.0, 0.3, stops)
    agents = place_stream("lane", road, ego, stream, make_generator("stream", 1))
    assert len(agents) >= 8
    assert len({agent.id for agent in agents}) == len(agents)
    assert min(clearance(one, other) for one, other in itertools.pairwise(agents)) >= 2.0
    vehicle = ego_agent(ego.trajectory, DEFAULT_VEHICLE)
    assert min(clearance(agent, vehicle) for agent in agents) >= 0.5
    # Some are on either side of the ego at the start, and all drive along the lane, or against it.
    ahead = [float(agent.poses[0, :2] @ [np.cos(0.7), np.sin(0.7)]) for agent in agents if agent.timestamps_us[0] == 0]
    assert min(ahead) < 60.0 and max(ahead) > 120.0
    heading = np.concatenate([agent.poses[:1, 3] for agent in agents if agent.timestamps_us[0] == 0])
    against = np.cos(heading - 0.7) < 0.0
    assert against.all() if offset > 0 else not against.any()


def test_a_stream_that_stops_stands_for_a_while(road: Road, ego: EgoMotion) -> None:
    agents = place_stream("lane", road, ego, Stream(-0.5 * LANE_WIDTH, 6.0, 8.0, 0.0, True), make_generator("stop", 2))
    steps = np.linalg.norm(np.diff(agents[3].poses[:, :2], axis=0), axis=1) / 0.1
    assert steps.min() < 0.01 and steps.max() > 4.0


def test_the_vehicle_ahead_keeps_its_distance(road: Road, ego: EgoMotion) -> None:
    (lead,) = place_lead(road, ego, Lead(6.0, "heavy_truck", swing=3.0, period=4.0), CENTER)
    gaps = clearance(lead, ego_agent(ego.trajectory, DEFAULT_VEHICLE))
    assert gaps == pytest.approx(6.0, abs=0.2)
    (leaving,) = place_lead(road, ego, Lead(5.0, pulls_away=2.0), CENTER)
    ego_positions = ego.trajectory.interpolate(leaving.timestamps_us)[:, :2, 3]
    apart = np.linalg.norm(leaving.poses[:, :2] - ego_positions, axis=1)
    assert apart[0] == pytest.approx(EGO_FRONT + 5.0 + SIZES["automobile"][0] / 2, abs=0.1)
    assert apart[-1] - apart[0] == pytest.approx(0.5 * 2.0 * 3.0**2, rel=0.05)


def test_cars_park_on_both_sides(road: Road, ego: EgoMotion) -> None:
    agents = place_parked(road, ego, make_generator("parked", 0))
    assert {agent.id.rpartition("_")[0] for agent in agents} == {"parked_left", "parked_right"}
    vehicle = ego_agent(ego.trajectory, DEFAULT_VEHICLE)
    assert all(clearance(agent, vehicle) > 0.5 for agent in agents)
    assert all(np.array_equal(agent.poses[0], agent.poses[-1]) for agent in agents)
