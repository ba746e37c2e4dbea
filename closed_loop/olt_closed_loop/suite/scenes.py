"""Scenes of the suite: an event, and how somebody who sees everything drives through it."""

from functools import lru_cache

from olt_closed_loop.scenes.hills import put_on_hills
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.scene_map import with_map
from olt_closed_loop.suite.catalogue import Entry, find_event
from olt_closed_loop.suite.event import Event
from olt_closed_loop.suite.recorded_drives import recorded_drive
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

PREFIX = "longtail/"
"""How the names of the suite's scenes begin, as in longtail/closed_lane or longtail/closed_lane:3."""


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
    return make_scene(*name_and_seed(source, PREFIX))


def name_and_seed(source: str, prefix: str) -> tuple[str, int]:
    """The event and the seed that PREFIX/NAME or PREFIX/NAME:SEED stands for; the seed is 0 where none is given.

    Raises:
        InputError: the seed is no number.
    """
    name, colon, seed = source.removeprefix(prefix).partition(":")
    if colon and not seed.isdecimal():
        raise InputError(f"scene {source!r}: {seed!r} is no seed; give {prefix}NAME or {prefix}NAME:SEED")
    return name, int(seed) if colon else 0


@lru_cache(maxsize=8)
def _make(entry: Entry, seed: int) -> Scene:
    event = entry.make(make_generator("suite event", entry.name, seed))
    return scene_of_event(f"longtail_{entry.name}_{seed}", entry.category, entry.factors, event, recorded_drive(event))


def scene_of_event(name: str, category: str, factors: tuple[str, ...], event: Event, ego: Trajectory) -> Scene:
    """The scene of an event with a recorded drive."""
    road_map, ground = event.ground.road_map, event.ground
    scene = Scene(
        name=name,
        category=category,
        factors=factors,
        vehicle=DEFAULT_VEHICLE,
        ego=ego,
        agents=event.agents,
        lanes=(),
        road_edges=(),
        drivable=(),
        route=road_map.route_line(ground.lanes),
    )
    scene = with_map(scene, road_map)
    return scene if event.hills is None else put_on_hills(scene, event.hills)
