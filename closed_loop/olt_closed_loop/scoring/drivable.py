"""Where a vehicle may drive, and when a drive leaves it.

With outlines of the drivable area, off the road is whatever they do not cover. With lanes and road edges only, it is
what lies beyond an edge: neither on a lane, nor to be reached from the nearest lane without crossing an edge. So a box
entirely beyond the edge is off the road, whichever way the edge is drawn.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from olt_closed_loop.rollouts.rollout_record import LaneLines, RolloutRecord
from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scoring.moving_boxes import MovingBox
from olt_generator.poses import Array

TOLERANCE = 1e-3
"""Metres by which areas are widened, so that outlines that share an edge leave no crack between them."""
LANE_WIDTH = 3.7
"""Width in metres of a lane whose borders are not known; AlpaSim's."""
NEAR = 25.0
"""Metres from the ego's way within which the lanes and outlines are put together at first."""
SAMPLE_US = 20_000
_EVERY = 5

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class DrivableArea:
    """Where a vehicle may drive, in the plane, relative to `origin` (2,) in metres.

    Attributes:
        area: where a vehicle may be without further question; parts of it far from the drive may be left out.
        edges: what it may not cross outside of the area; None when the area is all there is.
        left_out: how many lanes or outlines of `parts` the area is without.
        parts: of how many lanes or outlines the whole area consists.
        reach: metres from the drive within which the area has all its parts.
        whole: makes the whole area.
    """

    origin: Array
    area: BaseGeometry
    edges: BaseGeometry | None
    left_out: int = 0
    parts: int = 0
    reach: float = np.inf
    whole: Callable[[], BaseGeometry] | None = None

    def leaves(self, poses: Array, half_size: Array) -> Flags:
        """Which boxes (n,) at poses (n, 4), half as large as `half_size` (3,), are partly or wholly off the road."""
        points = corners(poses, half_size) - self.origin
        boxes = np.asarray(shapely.polygons(points))
        uncovered = ~np.asarray(shapely.covers(self.area, boxes))
        if self.edges is not None:
            boxes, points = boxes[uncovered], points[uncovered]
            # Beyond an edge is what touches it, or has it between a corner and the area.
            crossed = np.asarray(shapely.intersects(self.edges, self._ways(points))).any(axis=-1)
            uncovered[uncovered] = np.asarray(shapely.intersects(self.edges, boxes)) | crossed
        return uncovered

    def _ways(self, points: Array) -> NDArray[np.object_]:
        """The shortest lines from points (..., 2) to the area."""
        spots = np.asarray(shapely.points(points))
        ways = np.asarray(shapely.shortest_line(spots, self.area))
        # Beyond the reach a part that was left out may be nearer; an empty area has no lines.
        far = ~(np.asarray(shapely.length(ways)) <= self.reach)
        if self.whole is not None and far.any():
            ways[far] = shapely.shortest_line(spots[far], self.whole())
        return ways

    def may_be_left(self, poses: Array, distance: float) -> Flags:
        """Around which positions (n, 2 or more) the area does not cover everything within a distance in metres."""
        x, y = (poses[:, :2] - self.origin).T
        surroundings = shapely.box(x - distance, y - distance, x + distance, y + distance)
        return ~np.asarray(shapely.covers(self.area, surroundings))


def drivable_area_of(record: RolloutRecord, skip: bool = False) -> DrivableArea | None:
    """The drivable area of a rollout; None when its map has neither an outline nor lanes with edges.

    `skip` leaves out what lies farther than `NEAR` from the ego's way, which changes nothing for boxes of the ego.
    """
    origin, edges = record.poses[0, :2], None
    if record.drivable:
        lines, shapes = [[outline] for outline in record.drivable], [partial(_outlined, x) for x in record.drivable]
    elif record.lanes and record.road_edges:
        lines = _lines_of(record.lanes)
        shapes = [partial(lane_area, lane) for lane in record.lanes]
        edges = shapely.MultiLineString([edge[:, :2] - origin for edge in record.road_edges])
        shapely.prepare(edges)
    else:
        return None
    whole = cache(lambda: _union([shape(origin) for shape in shapes]))
    step = np.linalg.norm(np.diff(record.poses[:, :2], axis=0), axis=1).max(initial=0.0)
    # Corners of the ego lie within its size of the rig, and that within half a step of a sample.
    reach = NEAR - record.box.length - record.box.width - 0.5 * float(step)
    near = _within(lines, record.poses[:, :2], NEAR)
    if not skip or reach <= 0.0 or near.all():
        return DrivableArea(origin, whole(), edges, parts=len(shapes))
    area = _union([shape(origin) for shape, kept in zip(shapes, near, strict=True) if kept])
    return DrivableArea(origin, area, edges, int((~near).sum()), len(shapes), reach, whole)


def lanes_within(lanes: Sequence[LaneLines], places: Array, distance: float) -> list[LaneLines]:
    """The lanes whose bounds lie within a distance in metres of any of places (n, 2)."""
    return [lane for lane, near in zip(lanes, _within(_lines_of(lanes), places, distance), strict=True) if near]


def _lines_of(lanes: Sequence[LaneLines]) -> list[list[Array]]:
    return [[line for line in (lane.center, lane.left, lane.right) if line is not None] for lane in lanes]


def _within(lines: Sequence[Sequence[Array]], places: Array, distance: float) -> Flags:
    """Which groups of lines (each (k, 2 or more)) have their bounds within a distance of any of places (n, 2)."""
    sizes = [sum(len(line) for line in group) for group in lines]
    points = np.concatenate([line[:, :2] for group in lines for line in group])
    begins = np.cumsum([0, *sizes[:-1]])
    low, high = (extreme.reduceat(points, begins, axis=0) for extreme in (np.minimum, np.maximum))
    bounds = shapely.STRtree(shapely.box(*low.T, *high.T))
    near = np.zeros(len(lines), dtype=bool)
    near[bounds.query(shapely.points(places), predicate="dwithin", distance=distance)[1]] = True
    return near


def _outlined(outline: Array, origin: Array) -> BaseGeometry:
    return shapely.Polygon(outline[:, :2] - origin)


def lane_area(lane: LaneLines, origin: Array) -> BaseGeometry:
    """The area of a lane relative to `origin` (2,): between its borders, or about its centre line where it has none."""
    if lane.left is None or lane.right is None:
        return shapely.LineString(lane.center[:, :2] - origin).buffer(LANE_WIDTH / 2.0)
    return shapely.Polygon(np.concatenate([lane.left[:, :2], lane.right[::-1, :2]]) - origin)


def first_departure(
    drivable: DrivableArea, ego: MovingBox, start_us: int, end_us: int, skip: bool = True
) -> int | None:
    """The first time from `start_us` to `end_us` at which some part of the ego's box is off the road, or None.

    It is looked for every 20 ms and then narrowed to a microsecond. `skip` leaves out the times at which the whole
    surroundings of the ego are inside the area; this changes nothing.
    """
    times = np.append(np.arange(start_us, end_us, SAMPLE_US, dtype=np.int64), end_us)
    tested = np.ones(len(times), dtype=bool)
    if skip:  # judged from every fifth time and what the ego can drive in between
        ways = np.linalg.norm(np.diff(ego.poses[:, :2], axis=0), axis=1)
        fastest = float((ways / np.diff(ego.timestamps_us)).max(initial=0.0))
        reach = ego.radius + fastest * _EVERY * SAMPLE_US
        near_border = drivable.may_be_left(ego.at(times[::_EVERY], columns=2), reach)
        tested = np.repeat(near_border, _EVERY)[: len(times)]
    outside = np.flatnonzero(tested)[drivable.leaves(ego.at(times[tested]), ego.half_size)]
    if len(outside) == 0:
        return None
    before_us, after_us = int(times[max(outside[0] - 1, 0)]), int(times[outside[0]])
    while after_us - before_us > 1:
        times = np.unique(np.linspace(before_us, after_us, 33).round().astype(np.int64))
        index = 1 + int(np.argmax(drivable.leaves(ego.at(times[1:]), ego.half_size)))
        before_us, after_us = int(times[index - 1]), int(times[index])
    return after_us


def _union(areas: Sequence[BaseGeometry]) -> BaseGeometry:
    union = shapely.union_all([shapely.make_valid(area) for area in areas]).buffer(TOLERANCE)
    shapely.prepare(union)
    return union
