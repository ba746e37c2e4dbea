"""The route ahead as a line: where places are along and beside it, and how fast its bends let it be driven.

Toy only.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from olt_generator.poses import Array
from olt_sft_recipes.toy.birds_eye import STATIONS

LATERAL = 2.0
"""Acceleration to the side at which bends are driven, m/s2."""
BENDS_WITHIN = 20.0
"""Metres ahead of which bends count."""
STEP = 0.5
"""Metres between places of the line."""
_BEHIND, _BEYOND = 6.0, 60.0
_LEAST = 0.3


@dataclass(frozen=True)
class RouteLine:
    """The middle of the route grid.

    Attributes:
        poses: (stations, 3) x, y in metres and heading in the rig frame at STATIONS; it goes on straight at both ends.
    """

    poses: Array

    @classmethod
    def of(cls, along: Array) -> "RouteLine":
        """That of the cells (stations, offsets, 3) of a route grid."""
        return cls(along.mean(axis=1))

    @cached_property
    def _fine(self) -> tuple[Array, Array, Array, Array, Array]:
        """Station, x, y, heading and curvature (n,) of places every STEP."""
        station = np.arange(STATIONS[0] - _BEHIND, STATIONS[-1] + _BEYOND, STEP)
        x, y, heading = (np.interp(station, STATIONS, column) for column in self.poses.T)
        beyond = station - np.clip(station, STATIONS[0], STATIONS[-1])
        x, y = x + beyond * np.cos(heading), y + beyond * np.sin(heading)
        return station, x, y, heading, np.gradient(heading, station)

    def locate(self, poses: Array) -> Array:
        """Station, metres to the left of the line and turn against it (..., 3) of poses (..., 3) of x, y, yaw."""
        station, x, y, heading, _ = self._fine
        nearest = np.argmin((poses[..., 0, None] - x) ** 2 + (poses[..., 1, None] - y) ** 2, axis=-1)
        dx, dy, yaw = poses[..., 0] - x[nearest], poses[..., 1] - y[nearest], heading[nearest]
        along, left = np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx
        turned = (poses[..., 2] - yaw + np.pi) % (2.0 * np.pi) - np.pi
        return np.stack([station[nearest] + along, left, turned], axis=-1)

    def path_beside(self, stations: Array, offsets: Array) -> tuple[Array, Array]:
        """Poses (n, 3) of a path that is at rising stations (n,) so many metres to the left (n,), and its turn (n,)."""
        known, *columns = self._fine
        x, y, heading, curvature = (np.interp(stations, known, column) for column in columns)
        turned = np.arctan(np.gradient(offsets, stations) / np.maximum(1.0 - curvature * offsets, _LEAST))
        poses = np.stack([x - offsets * np.sin(heading), y + offsets * np.cos(heading), heading + turned], axis=-1)
        return poses, turned

    def beyond(self, pose: Array) -> Array:
        """Poses (n, 3) along the line from a pose (3,) on, as far to its side."""
        station, left, _ = self.locate(pose)
        stations = np.arange(station + STEP, self._fine[0][-1], STEP)
        return self.path_beside(stations, np.full(len(stations), left))[0] if len(stations) > 1 else np.empty((0, 3))

    @cached_property
    def bend_speed(self) -> float:
        """Metres per second at which the sharpest bend close ahead is driven."""
        bends = np.abs(np.gradient(self.poses[:, 2], STATIONS))[STATIONS < BENDS_WITHIN]
        return math.sqrt(LATERAL / max(float(bends.max()), 1e-6))
