"""Position along a path, as an arc length that only grows and cannot jump to another passage of the same place."""

import numpy as np

from olt_generator.poses import Array

LOOK_AHEAD = 4.0
"""Metres that are searched beyond twice the distance moved: a point up to so far inside a corner still gets around."""


class PathTracker:
    """Follows a point that moves along a polyline.

    Each new position is searched for only ahead of the last one and within reach of the movement.
    """

    def __init__(self, path: Array) -> None:
        """Start at the beginning of `path` (n, 2), n >= 1, metres."""
        moved = np.linalg.norm(np.diff(path, axis=0), axis=1) > 0.0
        self._points = path[np.concatenate([[True], moved])]
        self._directions = np.diff(self._points, axis=0)
        self._lengths = np.linalg.norm(self._directions, axis=1)
        self._starts = np.concatenate([[0.0], np.cumsum(self._lengths)])
        self._last_point = self._points[0]
        self.arc_length = 0.0
        self.distance = 0.0
        """Metres from the last point to its position on the path."""

    @property
    def length(self) -> float:
        """Length of the whole path, metres."""
        return float(self._starts[-1])

    def start_at(self, point: Array) -> None:
        """Place the position at the nearest point of the whole path to `point` (2,)."""
        self._search(point, 0.0, self.length)

    def advance(self, point: Array) -> float:
        """Move on to `point` (2,); returns the new arc length in metres."""
        reach = LOOK_AHEAD + 2.0 * float(np.linalg.norm(point - self._last_point))
        self._search(point, self.arc_length, min(self.arc_length + reach, self.length))
        return self.arc_length

    def points_ahead(self, distances: Array) -> Array:
        """Points (m, 2) of the path at these distances from the position; those beyond its end are left out."""
        asked = self.arc_length + distances
        asked = asked[asked <= self.length]
        return np.stack([np.interp(asked, self._starts, column) for column in self._points.T], axis=-1)

    def _search(self, point: Array, low: float, high: float) -> None:
        """Take the nearest point among the arc lengths from `low` to `high`."""
        self._last_point = point
        first = max(int(np.searchsorted(self._starts, low, side="right")) - 1, 0)
        last = int(np.searchsorted(self._starts, high, side="left"))
        part = slice(min(first, last), last)
        if part.start == part.stop:  # at the very end, or a path of one point
            self.arc_length, self.distance = low, float(np.linalg.norm(point - self._points[last]))
            return
        offsets = point - self._points[part]
        along = np.einsum("ij,ij->i", offsets, self._directions[part]) / self._lengths[part]
        along = np.clip(along, 0.0, self._lengths[part])
        arc_lengths = np.clip(self._starts[part] + along, low, high)
        along = (arc_lengths - self._starts[part]) / self._lengths[part]
        distances = np.linalg.norm(offsets - along[:, None] * self._directions[part], axis=1)
        nearest = int(np.argmin(distances))
        self.arc_length, self.distance = float(arc_lengths[nearest]), float(distances[nearest])
