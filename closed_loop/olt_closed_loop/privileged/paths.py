"""Where to drive: a path along the route that keeps clear of what stands, and of whom it overtakes.

Dynamic programming over a grid of stations and offsets, with the slope as part of the state, so that bends cost (the
lattice of Werling et al., ICRA 2010, without time); the result is smoothed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from olt_closed_loop.privileged.truth import Truth
from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scenes.polylines import arc_lengths, without_repeats, wrap
from olt_generator.poses import Array

STATION_STEP, OFFSET_STEP, FARTHEST = 2.0, 0.25, 6.0
"""Metres between stations, between offsets, and of the largest offset."""
CLEAR, ROOM = 0.45, 1.1
"""Metres that the vehicle keeps from everything at the very least, and that it would like to keep."""
BORDER = 0.35
"""Metres from the border of the road."""
STEEPEST = 2
"""Offset steps from one station to the next."""

_SMOOTHING, _ROUTE_SMOOTHING = 2.0, 1.5
_RETURN = 6.0
_TURNS_BACK, _TURNED = 5.0, 0.6
_BLOCKED, _TIGHT, _ASIDE, _SLOPE, _BEND = 1e4, 60.0, 0.5, 0.3, 1.5
_FINE = 0.25


@dataclass(frozen=True)
class Path:
    """A smooth path of the rig origin: position (x, y) by arc length, metres, and how long it is."""

    line: CubicSpline
    length: float

    def poses(self, arc: Array) -> tuple[Array, Array, Array]:
        """x, y, yaw (n,) at arc lengths (n,); straight on beyond its end."""
        inside = np.clip(arc, 0.0, self.length)
        tangent = self.line(inside, 1)
        yaw = np.arctan2(tangent[:, 1], tangent[:, 0])
        beyond = arc - inside
        x, y = self.line(inside).T
        return x + beyond * np.cos(yaw), y + beyond * np.sin(yaw), yaw

    def curvature(self, arc: Array) -> Array:
        """Absolute curvature (n,) at arc lengths (n,) on it, 1/m."""
        (dx, dy), (ddx, ddy) = self.line(arc, 1).T, self.line(arc, 2).T
        return np.abs(dx * ddy - dy * ddx) / np.maximum(np.hypot(dx, dy), 1e-6) ** 3


@dataclass(frozen=True)
class _Frame:
    """The route ahead as stations: points (n, 2), headings and curvatures (n,) every STATION_STEP metres."""

    points: Array
    headings: Array
    curvature: Array
    offset: float


def plan_path(
    truth: Truth,
    x: float,
    y: float,
    length: float,
    obstacles: Sequence[shapely.Geometry],
    yaw: float | None = None,
) -> Path:
    """The path from (x, y) along the route, `length` metres, past obstacles that keep their places.

    It starts along the route, or in the direction `yaw`, radians, where that is given.
    """
    frame = _frame(truth.route, x, y, length)
    offsets = np.arange(-FARTHEST, FARTHEST + OFFSET_STEP / 2, OFFSET_STEP)
    costs = _costs(truth, frame, offsets, obstacles)
    chosen = _smooth_offsets(offsets[_cheapest(costs, offsets, frame.offset)])
    stations = STATION_STEP * np.arange(len(chosen))
    chosen = chosen + (frame.offset - chosen[0]) * np.exp(-stations / _RETURN)
    if yaw is not None:
        slope = np.tan(np.clip(wrap(np.array(yaw - frame.headings[0])), -_TURNED, _TURNED))
        slope -= CubicSpline(stations, chosen)(0.0, 1)
        chosen = chosen + slope * stations * np.exp(-stations / _TURNS_BACK)
    normal = np.stack([-np.sin(frame.headings), np.cos(frame.headings)], axis=-1)
    points = without_repeats(frame.points + chosen[:, None] * normal)
    rough = CubicSpline(arc_lengths(points), points)
    fine = rough(np.arange(0.0, rough.x[-1], _FINE))
    arc = arc_lengths(fine)
    return Path(CubicSpline(arc, fine), float(arc[-1]))


def _frame(route: Array, x: float, y: float, length: float) -> _Frame:
    route = without_repeats(route[:, :2])
    line = shapely.LineString(route)
    begin = float(line.project(shapely.Point(x, y)))
    arc = arc_lengths(route)
    end = min(begin + length, arc[-1])
    fine = np.arange(0.0, arc[-1], _FINE)
    # Routes of maps have corners; the vehicle has none.
    points = np.stack([np.interp(fine, arc, column) for column in route.T], axis=-1)
    smooth = gaussian_filter1d(points, _ROUTE_SMOOTHING / _FINE, axis=0, mode="nearest")
    keep = np.minimum(np.minimum(fine, arc[-1] - fine) / (3.0 * _ROUTE_SMOOTHING), 1.0)[:, None]
    spline = CubicSpline(fine, keep * smooth + (1.0 - keep) * points)
    stations = np.arange(begin, end, STATION_STEP)
    tangent, bend = spline(stations, 1), spline(stations, 2)
    headings = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    curvature = (tangent[:, 0] * bend[:, 1] - tangent[:, 1] * bend[:, 0]) / np.hypot(*tangent.T) ** 3
    left = np.array([-np.sin(headings[0]), np.cos(headings[0])])
    return _Frame(spline(stations), headings, curvature, float((np.array([x, y]) - spline(begin)) @ left))


def _costs(truth: Truth, frame: _Frame, offsets: Array, obstacles: Sequence[shapely.Geometry]) -> Array:
    """What it costs (stations, slopes, offsets) to be there."""
    normal = np.stack([-np.sin(frame.headings), np.cos(frame.headings)], axis=-1)
    places = frame.points[:, None] + offsets[:, None] * normal[:, None]
    slopes = np.arctan2(OFFSET_STEP * np.arange(-STEEPEST, STEEPEST + 1), STATION_STEP)
    shape = len(places), len(slopes), len(offsets)
    x, y = (np.broadcast_to(places[:, None, :, axis], shape) for axis in (0, 1))
    yaw = np.broadcast_to(frame.headings[:, None, None] + slopes[:, None], shape)
    boxes = np.asarray(shapely.polygons(corners(truth.box_poses(x, y, yaw), truth.half_size)))
    costs = _ASIDE * np.broadcast_to(np.abs(offsets), boxes.shape)
    if truth.drivable is not None:
        inner = truth.drivable.buffer(-BORDER)
        shapely.prepare(inner)
        costs = costs + _BLOCKED * ~np.asarray(shapely.covers(inner, boxes))
    if len(obstacles):
        costs = costs + _nearness(boxes, obstacles)
    # Offsets beyond the centre of a bend do not exist.
    return costs + _BLOCKED * (1.0 - frame.curvature[:, None, None] * offsets < 0.3)


def _nearness(boxes: NDArray[np.object_], obstacles: Sequence[shapely.Geometry]) -> Array:
    """What it costs boxes to be near obstacles."""
    tree, flat = shapely.STRtree(list(obstacles)), boxes.ravel()
    (which, _), distances = tree.query_nearest(flat, max_distance=ROOM, return_distance=True, all_matches=False)
    gaps = np.full(len(flat), ROOM)
    gaps[which] = distances
    gaps = gaps.reshape(boxes.shape)
    return _TIGHT * (ROOM - gaps) ** 2 + _BLOCKED * (gaps < CLEAR) * (1.0 + CLEAR - gaps)


def _cheapest(costs: Array, offsets: Array, start: float) -> NDArray[np.int64]:
    """Indices (stations,) of the offsets of the cheapest path; it begins at the offset `start` without slope."""
    count, slopes = len(offsets), np.arange(-STEEPEST, STEEPEST + 1)
    total = np.full((len(slopes), count), np.inf)
    total[STEEPEST, np.argmin(np.abs(offsets - start))] = 0.0
    came: list[NDArray[np.int64]] = []
    for cost in costs[1:]:
        best, origin = np.full_like(total, np.inf), np.zeros(total.shape, dtype=np.int64)
        for to, slope in enumerate(slopes):
            for before in range(max(to - 1, 0), min(to + 2, len(slopes))):
                value = _shift(total[before], int(slope)) + _SLOPE * slope**2 + _BEND * (to - before) ** 2
                better = value < best[to]
                best[to][better], origin[to][better] = value[better], before
        total = best + cost
        came.append(origin)
    slope, place = np.unravel_index(int(np.argmin(total)), total.shape)
    indices = [int(place)]
    for origin in reversed(came):
        slope, place = origin[slope, place], place - slopes[slope]
        indices.append(int(place))
    return np.array(indices[::-1])


def _shift(values: Array, by: int) -> Array:
    """Values (n,) moved by some places; what comes in costs without bound."""
    moved = np.full_like(values, np.inf)
    if by >= 0:
        moved[by:] = values[: len(values) - by]
    else:
        moved[:by] = values[-by:]
    return moved


def _smooth_offsets(offsets: Array) -> Array:
    return gaussian_filter1d(offsets, _SMOOTHING, mode="nearest")
