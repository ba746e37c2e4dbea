"""Scenes of the suite: an event, and how somebody who sees everything drives through it."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from olt_closed_loop.privileged.holds import holds_of
from olt_closed_loop.privileged.plan import plan_drive
from olt_closed_loop.privileged.truth import Truth, area_of
from olt_closed_loop.scenes.driving import SAMPLE_US
from olt_closed_loop.scenes.hills import put_on_hills
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.scene_map import with_map
from olt_closed_loop.suite.catalogue import Entry, find_event
from olt_closed_loop.suite.courses import DURATION_US
from olt_closed_loop.suite.event import Event
from olt_generator.errors import InputError
from olt_generator.poses import planar_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

PREFIX = "longtail/"
"""How the names of the suite's scenes begin, as in longtail/closed_lane or longtail/closed_lane:3."""
SEES_US = 2_000_000
"""Until when the recorded driver drives as if nothing were ahead."""
_BEYOND_US = 3_000_000


def make_scene(name: str, seed: int = 0) -> Scene:
    """The scene of an event; the same name and seed give the same scene.

    The recorded ego is a drive planned with the truth (`privileged.plan`).

    Raises:
        InputError: there is no such event.
    """
    return _make(find_event(name), seed)


def with_seed(source: str, seed: int) -> str:
    """The source of an event of the suite with a seed; others, and those that have one, stay as they are."""
    return f"{source}:{seed}" if source.startswith(PREFIX) and ":" not in source else source


def scene_of(source: str) -> Scene:
    """The scene that longtail/NAME or longtail/NAME:SEED stands for.

    Raises:
        InputError: there is no such event, or the seed is no number.
    """
    name, colon, seed = source.removeprefix(PREFIX).partition(":")
    if colon and not seed.isdecimal():
        raise InputError(f"scene {source!r}: {seed!r} is no seed; give {PREFIX}NAME or {PREFIX}NAME:SEED")
    return make_scene(name, int(seed) if colon else 0)


@lru_cache(maxsize=8)
def _make(entry: Entry, seed: int) -> Scene:
    event = entry.make(make_generator("suite event", entry.name, seed))
    road_map, ground = event.ground.road_map, event.ground
    scene = Scene(
        name=f"longtail_{entry.name}_{seed}",
        category=entry.category,
        factors=entry.factors,
        vehicle=DEFAULT_VEHICLE,
        ego=_planned(event),
        agents=event.agents,
        lanes=(),
        road_edges=(),
        drivable=(),
        route=road_map.route_line(ground.lanes),
    )
    scene = with_map(scene, road_map)
    return scene if event.hills is None else put_on_hills(scene, event.hills)


def _planned(event: Event) -> Trajectory:
    """The recorded drive, 20 s long: until the hand-over as if nothing were ahead, as who has seen nothing yet."""
    ground, road_map = event.ground, event.ground.road_map
    route, end_us = road_map.route_line(ground.lanes)[:, :2], DURATION_US + _BEYOND_US
    holds = holds_of(road_map.lanes, road_map.lights, route, end_us)
    area = area_of(road_map.drivable)
    truth = Truth(route, area, event.agents, holds, DEFAULT_VEHICLE, ground.cruise, end_us)
    x, y, _ = ground.course.locate(ground.start)
    first = plan_drive(replace(truth, agents=(), holds=()), 0, float(x[0]), float(y[0]), ground.cruise)
    x, y, _ = first.poses(np.array([SEES_US, SEES_US + SAMPLE_US]))
    speed = float(np.hypot(x[1] - x[0], y[1] - y[0])) / (1e-6 * SAMPLE_US)
    then = plan_drive(truth, SEES_US, float(x[0]), float(y[0]), speed)
    times = np.arange(0, DURATION_US + 1, SAMPLE_US, dtype=np.int64)
    parts = first.poses(times[times < SEES_US]), then.poses(times[times >= SEES_US])
    return Trajectory(times, planar_pose(*(np.concatenate(part) for part in zip(*parts, strict=True))))
