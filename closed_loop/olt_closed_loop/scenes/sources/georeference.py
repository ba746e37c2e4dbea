"""OpenDRIVE maps of NuRec scenes: from the map's frame, whose origin is a place on earth, to the scene's world.

The map's frame is taken for the plane that touches the earth at its origin, east, north and up (what `+proj=tmerc` is
near it; d metres away the earth lies d^2 / 12.7e6 m below, which is left out). Earth is the
ellipsoid WGS 84 (NIMA TR8350.2, section 4).
"""

import re
from dataclasses import replace

import numpy as np
import shapely

from olt_closed_loop.scenes.maps.lanes import Lane
from olt_closed_loop.scenes.sources.opendrive import parse_road_network
from olt_generator.errors import InputError
from olt_generator.poses import Array, transform

_SEMI_MAJOR_AXIS, _FLATTENING = 6_378_137.0, 1.0 / 298.257223563
_ORIGIN = re.compile(r"\+(lat_0|lon_0|h_0)=(-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)")


def map_in_world(content: bytes, T_world_base: Array) -> tuple[list[Lane], list[shapely.Polygon], tuple[str, ...]]:
    """Lanes and drivable areas of an OpenDRIVE file in a frame whose pose on earth is `T_world_base` (4, 4), and what
    was assumed.

    Raises:
        InputError: the file is damaged, says no place on earth, or the pose is none.
    """
    network = parse_road_network(content, "map.xodr")
    if T_world_base.shape != (4, 4) or not np.isfinite(T_world_base).all() or abs(np.linalg.det(T_world_base)) < 0.5:
        raise InputError("rig_trajectories.json: T_world_base is no 4 x 4 pose")
    T_earth_map = _pose_on_earth(network.georeference)
    T_world_map = np.linalg.inv(T_world_base) @ T_earth_map
    lanes, areas = network.lanes()
    moved = [
        replace(lane, **{name: transform(T_world_map, getattr(lane, name)) for name in ("center", "left", "right")})
        for lane in lanes
    ]

    def move(points: Array) -> Array:
        return transform(T_world_map, np.column_stack([points, np.zeros(len(points))]))[:, :2]

    return moved, [shapely.transform(area, move) for area in areas], (*network.notes, "map.xodr lies on a plane")


def _pose_on_earth(georeference: str | None) -> Array:
    """The pose (4, 4) of a map's frame in the earth-centred one."""
    found = dict(_ORIGIN.findall(georeference or ""))
    if "lat_0" not in found or "lon_0" not in found or "+proj=tmerc" not in (georeference or ""):
        raise InputError("map.xodr: geoReference says no +proj=tmerc with +lat_0 and +lon_0, and nothing else is read")
    latitude, longitude = np.radians(float(found["lat_0"])), np.radians(float(found["lon_0"]))
    height = float(found.get("h_0", 0.0))
    squared = _FLATTENING * (2.0 - _FLATTENING)
    normal = _SEMI_MAJOR_AXIS / np.sqrt(1.0 - squared * np.sin(latitude) ** 2)
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([east, np.cross(up, east), up])
    pose[:3, 3] = up * (normal + height) - np.array([0.0, 0.0, squared * normal * np.sin(latitude)])
    return pose
