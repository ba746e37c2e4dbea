"""Invented driving scenes: a road, an event on it, and what a careful human does about it."""

import numpy as np

from olt_closed_loop.scenes.actors import clearance, ego_agent, moving, sample_times
from olt_closed_loop.scenes.driving import EgoMotion, drive, offset_profile
from olt_closed_loop.scenes.events import EVENTS, Approach
from olt_closed_loop.scenes.roads import Road, generate_road
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

CATEGORIES: tuple[str, ...] = tuple(EVENTS)
DURATION_US = 14_000_000
START_STATION = 40.0

_TRAFFIC_CLEARANCE = 0.5
_RECOVERY_LENGTH = 30.0


def generate_scene(category: str, seed: int, duration_us: int = DURATION_US) -> Scene:
    """Invent a scene of one of `CATEGORIES`; the same category, seed and duration give the same scene.

    Half of the recordings start up to 0.6 m off the lane centre and a few degrees askew, and return to it. The roads
    are long enough for recordings of 20 s.

    Raises:
        InputError: there is no such category.
    """
    if category not in EVENTS:
        raise InputError(f"category {category!r} is not one of {', '.join(CATEGORIES)}")
    generator = make_generator("scene", category, seed)
    road = generate_road(generator, length=generator.uniform(310.0, 350.0), lanes=int(generator.integers(1, 3)))
    lane = int(generator.integers(road.lanes)) if category == "nominal" else road.lanes - 1
    approach = Approach(
        onset=START_STATION + _RECOVERY_LENGTH + generator.uniform(1.0, 20.0),
        center=road.lane_offset(lane),
        cruise=generator.uniform(9.0, 13.5),
    )
    event = EVENTS[category](road, approach, generator)
    recovers = generator.random() < 0.5
    offset = generator.uniform(-0.6, 0.6) if recovers else 0.0
    slope = generator.uniform(-0.05, 0.05) if recovers else 0.0
    offsets = (
        (START_STATION, approach.center + offset),
        (START_STATION + _RECOVERY_LENGTH, approach.center),
        *(event.offsets or ((approach.onset, approach.center),)),
        (road.length, approach.center),
    )
    ego = drive(road, offset_profile(offsets, slope), approach.cruise, event.limits, duration_us)
    agents = event.place_agents(ego)
    agents += _oncoming_traffic(road, ego, agents, generator)
    return Scene(
        name=f"{category}_{seed:06d}",
        category=category,
        factors=event.factors,
        vehicle=DEFAULT_VEHICLE,
        ego=ego.trajectory,
        agents=tuple(agents),
        lanes=road.driving_lanes(),
        road_edges=road.edges,
        drivable=(road.outline,),
        route=road.polyline(approach.center),
    )


def _oncoming_traffic(road: Road, ego: EgoMotion, others: list[Agent], generator: np.random.Generator) -> list[Agent]:
    """Cars of the other direction that come close to nobody."""
    times = sample_times(ego.duration_us)
    everyone, traffic = [ego_agent(ego.trajectory, DEFAULT_VEHICLE), *others], list[Agent]()
    for i in range(int(generator.integers(2, 6))):
        start, speed = generator.uniform(100.0, 1.4 * road.length), generator.uniform(8.0, 13.0)
        offset = road.lane_offset(int(generator.integers(road.lanes)), oncoming=True)
        stations = start - speed * times
        label = "heavy_truck" if generator.random() < 0.2 else "automobile"
        for car in moving(f"oncoming_{i}", label, road, times, stations, np.full_like(times, offset), turn=np.pi):
            if all(clearance(car, other) >= _TRAFFIC_CLEARANCE for other in [*everyone, *traffic]):
                traffic.append(car)
    return traffic
