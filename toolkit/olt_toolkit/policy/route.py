"""Position along a path, as an arc length that only grows and cannot jump to another passage of the same place.

And the route ahead, as policies are shown it.
"""

import math
from bisect import bisect_left, bisect_right

import numpy as np

from olt_generator.poses import Array

ROUTE_POINTS = 20
ROUTE_LENGTH = 80.0
"""Number of points and metres of the route that a policy is shown (docs/formats/alpasim.md)."""
_ROUTE_DISTANCES: Array = np.linspace(0.0, ROUTE_LENGTH, ROUTE_POINTS)
LOOK_AHEAD = 4.0
"""Metres that are searched beyond twice the distance moved: a point up to so far inside a corner still gets around."""


class PathTracker:
    """Follows a point that moves along a polyline.

    Each new position is searched for only ahead of the last one and within reach of the movement.
    """

    def __init__(self, path: Array) -> None:
        """Start at the beginning of `path` (n, 2 or more), n >= 1, metres; further columns go along with x and y."""
        moved = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1) > 0.0
        self._points = path[np.concatenate([[True], moved])]
        directions = np.diff(self._points[:, :2], axis=0)
        lengths = np.linalg.norm(directions, axis=1)
        self._starts = np.concatenate([[0.0], np.cumsum(lengths)])
        self._vertices: list[list[float]] = self._points[:, :2].tolist()
        self._units: list[list[float]] = (directions / lengths[:, None]).tolist()
        self._arc_lengths: list[float] = self._starts.tolist()
        self._last_point = self._points[0, :2]
        self.arc_length = 0.0
        self.distance = 0.0
        """Metres from the last point to its position on the path."""

    @property
    def length(self) -> float:
        """Length of the whole path, metres."""
        return float(self._starts[-1])

    def start_at(self, point: Array) -> None:
        """Place the position at the nearest point of the whole path to `point` (2,), metres."""
        self._search(point, 0.0, self.length)

    def advance(self, point: Array) -> float:
        """Move on to `point` (2,), metres; returns the new arc length in metres."""
        reach = LOOK_AHEAD + 2.0 * math.dist(point, self._last_point)
        self._search(point, self.arc_length, min(self.arc_length + reach, self.length))
        return self.arc_length

    def points_ahead(self, distances: Array) -> Array:
        """Points (m, 2 or more) of the path at distances (n,) ahead, metres; those beyond its end are left out."""
        asked = self.arc_length + distances
        asked = asked[asked <= self.length]
        return np.stack([np.interp(asked, self._starts, column) for column in self._points.T], axis=-1)

    def _search(self, point: Array, low: float, high: float) -> None:
        """Take the nearest point among the arc lengths from `low` to `high`.

        A plain loop: the few segments within reach of one step are too short an array for numpy to pay. Where a segment
        ends farther from the point than the nearest so far, the path cannot be nearer before it has made up for that,
        so as much of it is left out.
        """
        self._last_point = point
        x, y = point.tolist()
        index = max(bisect_right(self._arc_lengths, low) - 1, 0)
        last = bisect_left(self._arc_lengths, high)
        # At the very end, or on a path of one point, there is no segment left.
        self.arc_length, self.distance = low, math.dist((x, y), self._vertices[last])
        nearest = math.inf
        while index < last:
            (start_x, start_y), (unit_x, unit_y) = self._vertices[index], self._units[index]
            start, end = self._arc_lengths[index], self._arc_lengths[index + 1]
            along = (x - start_x) * unit_x + (y - start_y) * unit_y
            arc_length = min(max(start + along, start, low), end, high)
            along = arc_length - start
            distance = math.hypot(x - start_x - along * unit_x, y - start_y - along * unit_y)
            if distance < nearest:
                nearest = distance
                self.arc_length, self.distance = arc_length, distance
            index += 1
            end_x, end_y = self._vertices[index]
            farther = math.hypot(x - end_x, y - end_y) - nearest
            index = max(bisect_right(self._arc_lengths, end + farther, index) - 1, index)


def route_ahead(tracker: PathTracker | None, x: float, y: float, yaw: float) -> Array:
    """Move a tracker of the route on to a pose of the rig, and tell the route ahead in the rig frame.

    Returns:
        Points (20, 2) every 80 / 19 metres with what goes along, NaN where the route ends earlier or is not known.
    """
    if tracker is None:
        return np.full((ROUTE_POINTS, 2), np.nan)
    tracker.advance(np.array([x, y]))
    ahead = tracker.points_ahead(_ROUTE_DISTANCES)
    apart_x, apart_y = ahead[:, 0] - x, ahead[:, 1] - y
    cos, sin = np.cos(yaw), np.sin(yaw)
    route = np.full((ROUTE_POINTS, ahead.shape[1]), np.nan)
    route[: len(ahead), 0] = cos * apart_x + sin * apart_y
    route[: len(ahead), 1] = cos * apart_y - sin * apart_x
    route[: len(ahead), 2:] = ahead[:, 2:]
    return route


def routes_ahead(route: Array, poses: Array) -> Array:
    """The route ahead (n, 20, 2) at poses (n, 3) x, y, yaw of the rig, each 0.1 s after the one before.

    As the closed loop shows it to a policy that takes over at the first of them (`route_ahead`); the route (m, 2) has
    one point or more, and further columns, where there are any, go along.
    """
    tracker = PathTracker(route)
    tracker.start_at(poses[0, :2])
    return np.stack([route_ahead(tracker, *pose) for pose in poses.tolist()])
