"""Lanes, outlines, edges and routes from what maps of recorded drives hold."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from olt_closed_loop.scenes.polylines import arc_lengths, heading_at, length_of, resample, without_repeats, wrap
from olt_closed_loop.scenes.scene import Lane
from olt_generator.poses import Array

ROUTE_BEYOND = 400.0
"""Metres that a route goes on after the recording ends: 20 s at 20 m/s."""
NO_ROAD = "the map holds no lanes and no drivable area: leaving the road is not measured"
_ROUTE_SPACING = 0.2
_LANE_DISTANCE, _LANE_TURN = 4.0, np.radians(22.5)
"""How near a lane must be, and how well aligned, to be the one that is driven on (docs/formats/alpasim.md)."""
_JOINING_DISTANCE = 5.0
"""Metres after which a route that leaves the recording is on the lane's centre line."""
_SUCCESSOR_GAP, _SUCCESSOR_TURN = 0.5, np.radians(60.0)


def lane_between(name: str, left: Array, right: Array, successors: tuple[str, ...]) -> Lane:
    """A lane between two borders (n, 3) and (m, 3); all its lines get the same number of points."""
    count = max(len(left), len(right), 2 + int(max(length_of(left), length_of(right)) / 2.0))
    left, right = resample(left, count), resample(right, count)
    return Lane(name, 0.5 * (left + right), left, right, successors)


def lane_around(name: str, center: Array, half_width: float) -> Lane:
    """A lane of constant width around its centre line (n, 3), n >= 2, without repeated points."""
    direction = np.gradient(center[:, :2], axis=0)
    ahead = np.diff(center[:, :2], axis=0, append=2.0 * center[-1:, :2] - center[-2:-1, :2])
    direction = np.where(np.any(direction, axis=1, keepdims=True), direction, ahead)  # where the line folds back
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    to_left = half_width * np.column_stack([-direction[:, 1], direction[:, 0], np.zeros(len(center))])
    return Lane(name, center, center + to_left, center - to_left)


def outlines(areas: Sequence[BaseGeometry]) -> tuple[Array, ...]:
    """Valid counter-clockwise outlines (n, 3) at height 0 whose union is that of the areas, which have no holes."""
    parts = shapely.get_parts([shapely.make_valid(area) for area in areas])
    polygons = [part for part in parts if part.geom_type == "Polygon" and part.area > 0.0]
    return tuple(_ring(shapely.orient_polygons(polygon).exterior)[:-1] for polygon in polygons)


def edges(areas: Sequence[BaseGeometry]) -> tuple[Array, ...]:
    """The borders of the union of areas as closed polylines (n, 3) at height 0 with the area to their left."""
    union = shapely.union_all([shapely.make_valid(area) for area in areas])
    polygons = [shapely.orient_polygons(part) for part in shapely.get_parts(union) if part.geom_type == "Polygon"]
    rings = [ring for polygon in polygons for ring in (polygon.exterior, *polygon.interiors)]
    return tuple(_ring(ring) for ring in rings)


def _ring(ring: BaseGeometry) -> Array:
    points = shapely.get_coordinates(ring)
    return np.column_stack([points, np.zeros(len(points))])


def link_by_place(lanes: Sequence[Lane]) -> list[Lane]:
    """The lanes with those as successors that begin where they end and go on in about the same direction."""
    if not lanes:
        return []
    starts, ends = (np.stack([lane.center[at, :2] for lane in lanes]) for at in (0, -1))
    first = np.array([heading_at(lane.center, 0.0) for lane in lanes])
    last = np.array([heading_at(lane.center, length_of(lane.center)) for lane in lanes])
    gap = np.linalg.norm(ends[:, None] - starts[None], axis=-1)
    follows = (gap < _SUCCESSOR_GAP) & (np.abs(wrap(first[None] - last[:, None])) < _SUCCESSOR_TURN)
    return [
        replace(lane, successors=tuple(lanes[j].id for j in np.flatnonzero(row).tolist()))
        for lane, row in zip(lanes, follows, strict=True)
    ]


def route_along(path: Array, yaw: float, lanes: Sequence[Lane]) -> Array:
    """The line (n, 3) that a recorded drive follows, and goes on after its end.

    Beyond the recording it follows the lane in which the recording ends, at forks the successor whose direction is
    closest, and straight on where the lanes end. `path` (m, 3) holds the recorded positions, `yaw` is the heading at
    the last of them.
    """
    kept = [path[0]]
    for point in path[1:]:
        if np.linalg.norm(point[:2] - kept[-1][:2]) >= _ROUTE_SPACING:
            kept.append(point)
    recorded = np.stack(kept)
    beyond = _lanes_ahead(path[-1], yaw, lanes)
    line = without_repeats(np.concatenate([recorded, beyond])) if len(beyond) else recorded
    heading, missing = yaw, ROUTE_BEYOND
    if len(beyond):
        heading, missing = heading_at(line, length_of(line)), ROUTE_BEYOND - length_of(beyond)
    if missing <= 0.0:
        return line
    end = line[-1] + missing * np.array([np.cos(heading), np.sin(heading), 0.0])
    return np.concatenate([line, end[None]])


def _lanes_ahead(position: Array, yaw: float, lanes: Sequence[Lane]) -> Array:
    """Centre line (n, 3) from the lane at a pose on, at most ROUTE_BEYOND long; (0, 3) where there is no lane."""
    lane, along = _lane_at(position, yaw, lanes)
    by_id = {lane.id: lane for lane in lanes}
    points, length, seen = np.zeros((0, 3)), 0.0, set[str]()
    start = along + _JOINING_DISTANCE
    while lane is not None and lane.id not in seen and length < ROUTE_BEYOND:
        seen.add(lane.id)
        points = np.concatenate([points, lane.center[arc_lengths(lane.center) >= start]])
        length, start = length_of(points) if len(points) else 0.0, 0.0
        heading = heading_at(lane.center, length_of(lane.center))
        following = [by_id[name] for name in lane.successors if name in by_id]
        lane = min(
            following, key=lambda other: abs(wrap(np.array(heading_at(other.center, 0.0) - heading))), default=None
        )
    return points[arc_lengths(points) <= ROUTE_BEYOND] if len(points) else points


def _lane_at(position: Array, yaw: float, lanes: Sequence[Lane]) -> tuple[Lane | None, float]:
    """The nearest lane that leads along `yaw`, and how far along it the position is."""
    here = shapely.Point(position[:2])
    best, nearest, along = None, _LANE_DISTANCE, 0.0
    for lane in lanes:
        line = shapely.LineString(lane.center[:, :2])
        distance, at = line.distance(here), line.project(here)
        if distance < nearest and abs(wrap(np.array(heading_at(lane.center, at) - yaw))) < _LANE_TURN:
            best, nearest, along = lane, distance, at
    return best, along
