"""Whether the ego is on a lane, against its direction, or at the edge of the road."""

from collections.abc import Iterator
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import KDTree
from shapely.geometry.base import BaseGeometry

from olt_closed_loop.rollouts.rollout_record import LaneLines, RolloutRecord
from olt_closed_loop.scoring.alpasim.series import MetricSeries, UnmeasuredError
from olt_closed_loop.scoring.alpasim.surroundings import Surroundings
from olt_closed_loop.scoring.alpasim.tracks import Geometries
from olt_generator.poses import Array

NEAR_LANE = 6.0
LANE_WIDTH = 3.7
AT_EDGE = 1e-3
WRONG_WAY = np.pi * 2.0 / 3.0
_LOOK = 0.01


class _RoadMap:
    """The map with its search trees over vertices."""

    def __init__(self, record: RolloutRecord) -> None:
        if not record.lanes:
            raise UnmeasuredError("the rollout has no lanes")
        self.lanes, self.edges = record.lanes, record.road_edges
        self.centers = [shapely.LineString(lane.center[:, :2]) for lane in self.lanes]
        self._areas: dict[int, BaseGeometry] = {}
        self._lane_tree, self._lane_of = _vertex_tree([lane.center for lane in self.lanes])

    @cached_property
    def _edge_tree(self) -> tuple[KDTree, NDArray[np.int64]]:
        if not self.edges:
            raise UnmeasuredError("the map has no road edges")
        return _vertex_tree(list(self.edges))

    @cached_property
    def _edge_lines(self) -> Geometries:
        return np.array([shapely.LineString(edge[:, :2]) for edge in self.edges], dtype=object)

    def lanes_near(self, positions: Array) -> list[tuple[int, ...]]:
        """For positions (n, 3), the lanes with a vertex of the centre line within 6 m."""
        return [
            tuple(np.unique(self._lane_of[hits]).tolist())
            for hits in self._lane_tree.query_ball_point(positions, NEAR_LANE)
        ]

    def area(self, lane: int) -> BaseGeometry:
        """The area of a lane, repaired where its outline crosses itself."""
        if lane not in self._areas:
            self._areas[lane] = _lane_area(self.lanes[lane], self.centers[lane])
            shapely.prepare(self._areas[lane])
        return self._areas[lane]

    def edges_at(self, positions: Array) -> Geometries:
        """For positions (n, 3), the edge that owns the nearest vertex."""
        tree, edge_of = self._edge_tree
        return self._edge_lines[edge_of[tree.query(positions)[1]]]


def measure_road(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """Off road, wrong lane, and the distance to the border of the lanes around.

    Raises:
        UnmeasuredError: there is no map, or a lane near the ego lacks its right border, or an edge is needed and none
            is there.
    """
    record = surroundings.record
    road = _RoadMap(record)
    times = record.timestamps_us
    positions = _box_centers(surroundings)
    offroad, wrong_lane, border = (np.zeros(len(times)) for _ in range(3))
    for lanes, at in _by_lanes(road.lanes_near(positions)):
        outlines, union = surroundings.ego_outlines[at], _union(road, lanes)
        in_union = shapely.contains(union, outlines)
        if in_union.any():
            border[at[in_union]] = _distances_to_border(union, outlines[in_union])
        on_lane = in_union if len(lanes) > 1 else np.zeros(len(at), dtype=bool)
        for lane in lanes:
            on_lane = on_lane | shapely.contains(road.area(lane), outlines)
            on_it = at[shapely.contains(road.area(lane), surroundings.ego_centers[at])]
            wrong_lane[on_it] = np.maximum(wrong_lane[on_it], _against(road, lane, surroundings, on_it))
        off_lane = at[~on_lane]
        if len(off_lane):
            gaps = shapely.distance(road.edges_at(positions[off_lane]), surroundings.ego_outlines[off_lane])
            offroad[off_lane] = gaps < AT_EDGE
    return {
        "offroad": MetricSeries(times, offroad, "max"),
        "wrong_lane": MetricSeries(times, wrong_lane, "max"),
        "min_distance_to_lane_boundary_m": MetricSeries(times, border, "min"),
    }


def _box_centers(surroundings: Surroundings) -> Array:
    """Centres (n, 3) of the ego's box; half its height lies between it and the ground, which counts in the 6 m."""
    record = surroundings.record
    heights = record.poses[:, 2] + 0.5 * record.box.height
    return np.column_stack([surroundings.ego.positions, heights]).astype(np.float64)


def _by_lanes(near: list[tuple[int, ...]]) -> Iterator[tuple[tuple[int, ...], NDArray[np.int64]]]:
    """The samples that have the same lanes near, so that each union of lanes is made once."""
    for lanes in sorted(set(near)):
        yield lanes, np.array([sample for sample, others in enumerate(near) if others == lanes])


def _union(road: _RoadMap, lanes: tuple[int, ...]) -> BaseGeometry:
    union = shapely.union_all([road.area(lane) for lane in lanes])
    shapely.prepare(union)
    return union


def _distances_to_border(area: BaseGeometry, outlines: Geometries) -> Array:
    """Distances (n,) of outlines to the border of an area; a tree of its segments finds the nearest one."""
    rings = [shapely.get_coordinates(ring) for ring in shapely.get_parts(shapely.boundary(area))]
    ends = np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])
    tree = shapely.STRtree(np.asarray(shapely.linestrings(ends)))
    _, distances = tree.query_nearest(outlines, return_distance=True, all_matches=False)
    return distances


def _against(road: _RoadMap, lane: int, surroundings: Surroundings, at: NDArray[np.int64]) -> Array:
    """1 where (n,) the lane, which holds the ego's centre, runs more than 120 degrees from its yaw, else 0.

    The difference of the angles is not wrapped, so that near +-180 degrees a proper lane can count as wrong.
    """
    centers = surroundings.ego_centers[at]
    line = road.centers[lane]
    along = shapely.line_locate_point(line, centers)
    ahead, behind = (
        shapely.get_coordinates(shapely.line_interpolate_point(line, place))
        for place in (np.minimum(along + _LOOK, shapely.length(line)), np.maximum(along - _LOOK, 0.0))
    )
    direction = ahead - behind
    turned = np.abs(np.arctan2(direction[:, 1], direction[:, 0]) - surroundings.ego_places[1][at])
    return (turned > WRONG_WAY).astype(np.float64)


def _lane_area(lane: LaneLines, center: shapely.LineString) -> BaseGeometry:
    if lane.left is None:
        return shapely.buffer(center, LANE_WIDTH / 2.0, quad_segs=16)
    if lane.right is None:
        raise UnmeasuredError("a lane near the ego has a left border and no right one")
    return shapely.make_valid(shapely.Polygon(np.concatenate([lane.left[:, :2], lane.right[::-1, :2]])))


def _vertex_tree(lines: list[Array]) -> tuple[KDTree, NDArray[np.int64]]:
    """A search tree of all vertices, and the line (n,) that each belongs to."""
    owner = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    return KDTree(np.concatenate(lines)), owner
