"""The drivable area of lanes and junctions, and its edges."""

from collections.abc import Iterable, Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from olt_closed_loop.scenes.maps.cross_sections import PAVED
from olt_closed_loop.scenes.maps.lanes import Lane
from olt_generator.poses import Array

_CRACK = 1e-4
"""Metres over which areas that touch grow together."""
_CAP = 0.01
LEAST_ISLAND = 2.0
"""Square metres of the smallest island."""


def lane_polygon(lane: Lane) -> BaseGeometry:
    """The area between a lane's borders; of a lane that crosses itself, or whose borders do, piece by piece."""
    left, right = lane.left[:, :2], lane.right[:, :2]
    if len(left) < 2:
        return shapely.Polygon()
    polygon = shapely.Polygon(np.concatenate([left, right[::-1]]))
    if polygon.is_valid:
        return polygon
    pieces = shapely.polygons(np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1))
    return shapely.union_all(shapely.make_valid(pieces))


def paved_area(lanes: Iterable[Lane], more: Iterable[BaseGeometry] = ()) -> BaseGeometry:
    """The area of all lanes that are paved for vehicles and of further polygons, grown together.

    Gaps between lanes of less than LEAST_ISLAND square metres are paved as well.
    """
    parts = [lane_polygon(lane) for lane in lanes if lane.type in PAVED]
    grown = shapely.buffer([*parts, *more], _CRACK, join_style="mitre")
    area = shapely.union_all(grown).buffer(-_CRACK, join_style="mitre")
    return shapely.union_all([_without_small_holes(part) for part in shapely.get_parts(area)])


def _without_small_holes(polygon: BaseGeometry) -> BaseGeometry:
    if not isinstance(polygon, shapely.Polygon):
        return polygon
    islands = [ring for ring in polygon.interiors if shapely.Polygon(ring).area >= LEAST_ISLAND]
    return shapely.Polygon(polygon.exterior, islands)


def outlines_of(area: BaseGeometry) -> tuple[Array, ...]:
    """Counter-clockwise outlines (n, 3) without holes whose union is the area; the last point repeats the first."""
    return tuple(_line(polygon.exterior) for polygon in _without_holes(area))


def edges_of(area: BaseGeometry, road_ends: Sequence[Array]) -> tuple[Array, ...]:
    """The borders of an area as polylines (n, 3) with the area to their left, open at road ends (2, 2 or 3)."""
    polygons = [shapely.orient_polygons(part) for part in shapely.get_parts(area)]
    rings = [ring for polygon in polygons for ring in (polygon.exterior, *polygon.interiors)]
    ends = shapely.union_all([shapely.LineString(end[:, :2]).buffer(_CAP) for end in road_ends])
    lines = [_open_line(shapely.LineString(ring.coords), ends) for ring in rings]
    return tuple(_line(part) for line in lines for part in shapely.get_parts(line))


def _open_line(ring: shapely.LineString, ends: BaseGeometry) -> BaseGeometry:
    if not ring.intersects(ends):
        return ring
    return shapely.line_merge(ring.difference(ends), directed=True)


def _without_holes(area: BaseGeometry) -> list[shapely.Polygon]:
    """Polygons without holes: those that have some are cut through the middle of the first one, again and again."""
    open_, done = list(shapely.get_parts(area))[::-1], list[shapely.Polygon]()
    while open_:
        polygon = open_.pop()
        if polygon.geom_type != "Polygon" or polygon.area <= _CRACK**2:
            continue
        if not polygon.interiors:
            done.append(shapely.orient_polygons(polygon))
            continue
        x = shapely.centroid(shapely.Polygon(polygon.interiors[0])).x
        west, south, east, north = polygon.buffer(1.0).bounds
        halves = shapely.box([west, x], [south, south], [x, east], [north, north])
        open_ += [part for half in halves for part in shapely.get_parts(polygon.intersection(half))]
    return done


def _line(line: BaseGeometry) -> Array:
    points = shapely.get_coordinates(line)
    return np.column_stack([points, np.zeros(len(points))])
