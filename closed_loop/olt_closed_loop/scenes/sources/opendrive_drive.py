"""OpenDRIVE road networks alone: a drive along their lanes that nobody recorded, so that the network can be driven.

The way begins where the longest one does and goes straight on at forks; its speed is low enough for its bends.
"""

from pathlib import Path

import numpy as np

from olt_closed_loop.scenes.polylines import arc_lengths, points_along, without_repeats
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.sources.assembly import RecordedDrive, assemble_scene, heading_along, scaled_car
from olt_closed_loop.scenes.sources.opendrive import DRIVING, LaneKey, RoadNetwork, read_road_network
from olt_closed_loop.scenes.sources.openscenario.motion import Roads
from olt_generator.errors import InputError
from olt_generator.poses import Array, planar_pose
from olt_generator.trajectory import Trajectory

LONGEST_WAY = 300.0
SPEED, SIDEWAYS, ALONG = 10.0, 1.5, 1.0
"""m/s, and m/s^2 sideways and along."""
_STEP_US = 100_000
_SPACING = 0.5


def read_road_drive(path: Path) -> Scene:
    """A road network with a drive along its lanes.

    Raises:
        InputError: the file is no OpenDRIVE file, uses what is not read, or has no lane for cars.
    """
    network = read_road_network(path)
    vehicle, _ = scaled_car(4.6, 1.85)
    way = _longest_way(network)
    times, positions, heading = _drive(way)
    lanes, areas = network.lanes()
    try:
        return assemble_scene(
            RecordedDrive(
                name=f"opendrive_{path.stem}",
                vehicle=vehicle,
                ego=Trajectory(times, planar_pose(positions[:, 0], positions[:, 1], heading)),
                agents=(),
                lanes=lanes,
                areas=areas,
                assumptions=(
                    "a road network, and no drive was recorded on it: the ego drives along lanes up to "
                    f"{LONGEST_WAY:g} m or their end, at most at {SPEED:g} m/s",
                    f"the ego is a car of {vehicle.length:g} x {vehicle.width:g} m",
                    *network.notes,
                ),
            )
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _longest_way(network: RoadNetwork) -> Array:
    """The middle (n, 2) of the lanes of the longest way that begins with a lane, up to LONGEST_WAY."""
    keys = [
        LaneKey(road.id, section, number)
        for road in network.roads.values()
        for section, strips in enumerate(road.sections)
        for number, strip in strips.items()
        if strip.kind in DRIVING
    ]
    if not keys:
        raise InputError("the road network has no lane for cars")
    lengths = [_way_length(network, key) for key in keys]
    first = keys[int(np.argmax(np.minimum(lengths, LONGEST_WAY)))]
    roads = Roads(network)
    road = network.roads[first.road]
    way = road.ahead(first.lane)
    start = road.starts[first.section] if way > 0 else road.section_end(first.section)
    # On the border of two sections the lane of the next one may have another number.
    here = roads.on_lane(first.road, first.lane, start + way * min(0.01, 0.1 * road.length))
    points = []
    for _ in range(int(LONGEST_WAY / _SPACING)):
        pose = roads.pose(here)
        points.append((pose.x, pose.y))
        following = roads.advance(here, _SPACING / roads.stretch(here))
        if following is None:
            break
        here = following
    line = without_repeats(np.array(points))
    if len(line) < 5:
        raise InputError("the road network's lanes are shorter than a car")
    return line


def _way_length(network: RoadNetwork, key: LaneKey) -> float:
    """Metres along straight continuations from the start of a lane, up to a little more than LONGEST_WAY."""
    roads, length, seen = Roads(network), 0.0, set[LaneKey]()
    here: LaneKey | None = key
    while here is not None and here not in seen and length < LONGEST_WAY:
        seen.add(here)
        road = network.roads[here.road]
        length += road.section_end(here.section) - road.starts[here.section]
        following = network.following(here)
        here = roads.choose(here, following, frozenset()) if following else None
    return length


def _drive(way: Array) -> tuple[np.ndarray, Array, Array]:
    """Times (n,) in microseconds, positions (n, 2) and headings (n,) of a drive along a way (m, 2)."""
    arc = arc_lengths(way)
    heading = np.unwrap(heading_along(way))
    bend = np.abs(np.gradient(heading, arc))
    speed = np.minimum(SPEED, np.sqrt(SIDEWAYS / np.maximum(bend, 1e-6)))
    steps = np.diff(arc)
    for index in range(1, len(speed)):
        speed[index] = min(speed[index], np.sqrt(speed[index - 1] ** 2 + 2.0 * ALONG * steps[index - 1]))
    for index in range(len(speed) - 2, -1, -1):
        speed[index] = min(speed[index], np.sqrt(speed[index + 1] ** 2 + 2.0 * ALONG * steps[index]))
    seconds = np.concatenate([[0.0], np.cumsum(2.0 * steps / (speed[1:] + speed[:-1]))])
    times_us = np.arange(0, int(seconds[-1] * 1e6), _STEP_US, dtype=np.int64)
    along = np.interp(times_us * 1e-6, seconds, arc)
    return times_us, points_along(way, along), np.interp(along, arc, heading)
