"""The road map of a scene."""

from dataclasses import replace

from olt_closed_loop.scenes.maps.road_map import RoadMap
from olt_closed_loop.scenes.scene import Scene


def map_of(scene: Scene) -> RoadMap:
    """The map of a scene; it keeps nothing of what was asked of an earlier one."""
    return RoadMap(scene.lanes, scene.road_edges, scene.drivable, scene.stop_lines, scene.crossings, scene.lights)


def with_map(scene: Scene, road_map: RoadMap) -> Scene:
    """The scene on another map; its route, ego and agents stay."""
    return replace(
        scene,
        lanes=road_map.lanes,
        road_edges=road_map.road_edges,
        drivable=road_map.drivable,
        stop_lines=road_map.stop_lines,
        crossings=road_map.crossings,
        lights=road_map.lights,
    )
