"""Where a vehicle may drive, and when a drive leaves it.

With outlines of the drivable area, off the road is whatever they do not cover. With lanes and road edges only, it is
what lies beyond an edge: neither on a lane, nor to be reached from the nearest lane without crossing an edge. So a box
entirely beyond the edge is off the road, whichever way the edge is drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass

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
SAMPLE_US = 20_000
_EVERY = 5

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class DrivableArea:
    """Where a vehicle may drive, in the plane, relative to `origin` (2,) in metres.

    Attributes:
        area: where a vehicle may be without further question.
        edges: what it may not cross outside of the area; None when the area is all there is.
    """

    origin: Array
    area: BaseGeometry
    edges: BaseGeometry | None

    def leaves(self, poses: Array, half_size: Array) -> Flags:
        """Which boxes (n,) at poses (n, 4), half as large as `half_size` (3,), are partly or wholly off the road."""
        points = corners(poses, half_size) - self.origin
        boxes = np.asarray(shapely.polygons(points))
        uncovered = ~np.asarray(shapely.covers(self.area, boxes))
        if self.edges is not None:
            boxes, points = boxes[uncovered], points[uncovered]
            # Beyond an edge is what touches it, or has it between a corner and the area.
            ways = shapely.shortest_line(shapely.points(points), self.area)
            crossed = np.asarray(shapely.intersects(self.edges, ways)).any(axis=-1)
            uncovered[uncovered] = np.asarray(shapely.intersects(self.edges, boxes)) | crossed
        return uncovered

    def may_be_left(self, poses: Array, distance: float) -> Flags:
        """Around which positions (n, 2 or more) the area does not cover everything within a distance in metres."""
        x, y = (poses[:, :2] - self.origin).T
        surroundings = shapely.box(x - distance, y - distance, x + distance, y + distance)
        return ~np.asarray(shapely.covers(self.area, surroundings))


def drivable_area_of(record: RolloutRecord) -> DrivableArea | None:
    """The drivable area of a rollout; None when its map has neither an outline nor lanes with edges."""
    origin = record.poses[0, :2]
    if record.drivable:
        outlines = [shapely.Polygon(outline[:, :2] - origin) for outline in record.drivable]
        return DrivableArea(origin, _union(outlines), None)
    if not (record.lanes and record.road_edges):
        return None
    edges = shapely.MultiLineString([edge[:, :2] - origin for edge in record.road_edges])
    shapely.prepare(edges)
    return DrivableArea(origin, _union([lane_area(lane, origin) for lane in record.lanes]), edges)


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
