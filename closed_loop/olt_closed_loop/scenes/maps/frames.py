"""Road maps elsewhere, turned, in the mirror, and at other heights."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from olt_closed_loop.scenes.maps.lanes import Crossing, Lane
from olt_closed_loop.scenes.maps.road_map import RoadMap
from olt_generator.poses import Array

Move = Callable[[Array], Array]
"""From points (n, 3) to points (n, 3)."""


def moved(road_map: RoadMap, x: float, y: float, heading: float = 0.0) -> RoadMap:
    """The map turned about the origin by `heading` radians and then shifted by (x, y) metres."""
    cos, sin = np.cos(heading), np.sin(heading)
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return with_points(road_map, lambda points: points @ turn + [x, y, 0.0])


def mirrored(road_map: RoadMap) -> RoadMap:
    """The map mirrored at the x axis: left is right, and traffic that kept to the right keeps to the left."""
    flipped = with_points(road_map, lambda points: points * [1.0, -1.0, 1.0])
    return replace(
        flipped,
        lanes=tuple(map(_swapped, flipped.lanes)),
        # The area lies to the left of its edges, also in the mirror.
        road_edges=tuple(edge[::-1].copy() for edge in flipped.road_edges),
        drivable=tuple(outline[::-1].copy() for outline in flipped.drivable),
        stop_lines=tuple(replace(line, points=line.points[::-1].copy()) for line in flipped.stop_lines),
        crossings=tuple(_turned_round(place) for place in flipped.crossings),
    )


def with_points(road_map: RoadMap, move: Move) -> RoadMap:
    """The map with every point moved."""
    return RoadMap(
        tuple(
            replace(lane, center=move(lane.center), left=move(lane.left), right=move(lane.right))
            for lane in road_map.lanes
        ),
        tuple(map(move, road_map.road_edges)),
        tuple(map(move, road_map.drivable)),
        tuple(replace(line, points=move(line.points)) for line in road_map.stop_lines),
        tuple(replace(place, outline=move(place.outline)) for place in road_map.crossings),
        tuple(
            light if light.position is None else replace(light, position=move(light.position[None])[0])
            for light in road_map.lights
        ),
    )


def _swapped(lane: Lane) -> Lane:
    return replace(
        lane,
        left=lane.right,
        right=lane.left,
        left_neighbours=lane.right_neighbours,
        right_neighbours=lane.left_neighbours,
        left_marking=lane.right_marking,
        right_marking=lane.left_marking,
    )


def _turned_round(place: Crossing) -> Crossing:
    return replace(place, outline=place.outline[::-1].copy())
