"""Whether the ego is on a lane, against its direction, or at the edge of the road."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import KDTree
from shapely.geometry.base import BaseGeometry

from olt_closed_loop.rollouts.rollout_record import RolloutRecord
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
    """The map; areas of lanes and the search tree of edges are made when they are first needed."""

    def __init__(self, record: RolloutRecord) -> None:
        if not record.lanes:
            raise UnmeasuredError("the rollout has no lanes")
        self._lanes, self._edges = record.lanes, record.road_edges
        self.centers = [shapely.LineString(lane.center[:, :2]) for lane in record.lanes]
        self._areas: dict[int, BaseGeometry] = {}

    def area(self, lane: int) -> BaseGeometry:
        """The area of a lane, repaired where its outline crosses itself."""
        if lane not in self._areas:
            left, right = self._lanes[lane].left, self._lanes[lane].right
            if left is None:
                area = shapely.buffer(self.centers[lane], LANE_WIDTH / 2.0, quad_segs=16)
            elif right is None:
                raise UnmeasuredError("a lane near the ego has a left border and no right one")
            else:
                area = shapely.make_valid(shapely.Polygon(np.concatenate([left[:, :2], right[::-1, :2]])))
            shapely.prepare(area)
            self._areas[lane] = area
        return self._areas[lane]

    @cached_property
    def edges(self) -> tuple[KDTree, Geometries]:
        """A search tree of all vertices (n, 3) of road edges, and the edge (n,) that each is of."""
        if not self._edges:
            raise UnmeasuredError("the map has no road edges")
        tree, owner = _vertex_tree(self._edges)
        return tree, np.array([shapely.LineString(edge[:, :2]) for edge in self._edges], dtype=object)[owner]


def measure_road(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """Off road, wrong lane, and the distance to the border of the lanes around.

    Raises:
        UnmeasuredError: there is no map, or a lane near the ego lacks its right border, or an edge is needed and none
            is there.
    """
    record, times = surroundings.record, surroundings.record.timestamps_us
    road = _RoadMap(record)
    # Half the height of the ego's box lies between its centre and the ground, which counts in the 6 m.
    heights = record.poses[:, 2] + 0.5 * record.box.height
    positions = np.column_stack([surroundings.ego.positions, heights]).astype(np.float64)
    tree, lane_of = _vertex_tree([lane.center for lane in record.lanes])
    near = [tuple(np.unique(lane_of[hits]).tolist()) for hits in tree.query_ball_point(positions, NEAR_LANE)]
    offroad, wrong_lane, border = (np.zeros(len(times)) for _ in range(3))
    for lanes in sorted(set(near)):
        at = np.array([sample for sample, others in enumerate(near) if others == lanes])
        outlines, union = surroundings.ego_outlines[at], shapely.union_all([road.area(lane) for lane in lanes])
        shapely.prepare(union)
        in_union = shapely.contains(union, outlines)
        if in_union.any():
            border[at[in_union]] = _distances_to_border(union, outlines[in_union])
        on_lane = in_union if len(lanes) > 1 else np.zeros(len(at), dtype=bool)
        for lane in lanes:
            on_lane = on_lane | shapely.contains(road.area(lane), outlines)
            on_it = at[shapely.contains(road.area(lane), surroundings.ego_centers[at])]
            wrong_lane[on_it] = np.maximum(wrong_lane[on_it], _against(road.centers[lane], surroundings, on_it))
        off_lane = at[~on_lane]
        if len(off_lane):
            edge_tree, edge_of = road.edges
            edges = edge_of[edge_tree.query(positions[off_lane])[1]]
            offroad[off_lane] = shapely.distance(edges, surroundings.ego_outlines[off_lane]) < AT_EDGE
    return {
        "offroad": MetricSeries(times, offroad, "max"),
        "wrong_lane": MetricSeries(times, wrong_lane, "max"),
        "min_distance_to_lane_boundary_m": MetricSeries(times, border, "min"),
    }


def _distances_to_border(area: BaseGeometry, outlines: Geometries) -> Array:
    """Distances (n,) of outlines to the border of an area; a tree of its segments finds the nearest one."""
    rings = [shapely.get_coordinates(ring) for ring in shapely.get_parts(shapely.boundary(area))]
    ends = np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])
    tree = shapely.STRtree(np.asarray(shapely.linestrings(ends)))
    _, distances = tree.query_nearest(outlines, return_distance=True, all_matches=False)
    return distances


def _against(line: shapely.LineString, surroundings: Surroundings, at: NDArray[np.int64]) -> Array:
    """1 where (n,) a lane, which holds the ego's centre, runs more than 120 degrees from its yaw, else 0.

    The difference of the angles is not wrapped, so that near +-180 degrees a proper lane can count as wrong.
    """
    along = shapely.line_locate_point(line, surroundings.ego_centers[at])
    ahead, behind = (
        shapely.get_coordinates(shapely.line_interpolate_point(line, place))
        for place in (np.minimum(along + _LOOK, shapely.length(line)), np.maximum(along - _LOOK, 0.0))
    )
    direction = ahead - behind
    turned = np.abs(np.arctan2(direction[:, 1], direction[:, 0]) - surroundings.ego_places[1][at])
    return (turned > WRONG_WAY).astype(np.float64)


def _vertex_tree(lines: Sequence[Array]) -> tuple[KDTree, NDArray[np.int64]]:
    """A search tree of all vertices, and the line (n,) that each belongs to."""
    owner = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    return KDTree(np.concatenate(lines)), owner
