"""The route ahead as a line: how far beside it the vehicle is, how it goes on, and how fast its bends let it be driven.

Toy only. Nothing that the policy sees tells where the road ends; how far beside a route it mostly does is known of the
roads that it learns from (docs/toy.md).
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from olt_generator.poses import Array
from olt_sft_recipes.toy.birds_eye import FRONT, OFFSETS, STATIONS

ROAD = (-2.1, -1.1, 4.5, 6.0)
"""Metres to the left of the route at which the vehicle has left the road for certain, begins to, and the same left."""
LATERAL = 2.0
"""Acceleration to the side at which bends are driven, m/s2."""
BENDS_WITHIN = 20.0
"""Metres ahead of which bends count."""


@dataclass(frozen=True)
class RouteLine:
    """The middle of the route grid.

    Attributes:
        poses: (stations, 3) x, y in metres and heading in the rig frame.
        cells: of the route grid, their places in the rig frame.
        known: whether there is a route; else the line is that of the present turn.
    """

    poses: Array
    cells: KDTree
    known: bool

    @classmethod
    def of(cls, along: Array, known: bool = True) -> "RouteLine":
        """That of the cells (stations, offsets, 3) of a route grid."""
        return cls(along.mean(axis=1), KDTree(along[..., :2].reshape(-1, 2)), known)

    def offsets(self, places: Array) -> Array:
        """Metres (...) to the left of the line of places (..., 2)."""
        x, y, yaw = np.moveaxis(self.poses[self._station(places)], -1, 0)
        return np.cos(yaw) * (places[..., 1] - y) - np.sin(yaw) * (places[..., 0] - x)

    def off_road(self, plans: Array) -> Array:
        """What share of its time a plan of plans (..., steps, 3) is likely off the road (...); 0 without a route.

        Looked up is where the front goes, which leaves it first.
        """
        if not self.known:
            return np.zeros(plans.shape[:-2])
        x, y, yaw = np.moveaxis(plans, -1, 0)
        offsets = self.offsets(np.stack([x + FRONT * np.cos(yaw), y + FRONT * np.sin(yaw)], axis=-1))
        return np.interp(offsets, ROAD, (1.0, 0.0, 0.0, 1.0)).mean(axis=-1)

    def beyond(self, pose: Array) -> Array:
        """Poses (n, 3) along the line from a pose (3,) on, as far to its side."""
        line = self.poses[int(self._station(pose[:2])) + 1 :]
        left = np.stack([-np.sin(line[:, 2]), np.cos(line[:, 2]), np.zeros(len(line))], axis=-1)
        poses = line + self.offsets(pose[:2]) * left
        ahead = (poses[:, 0] - pose[0]) * math.cos(pose[2]) + (poses[:, 1] - pose[1]) * math.sin(pose[2])
        return poses[ahead > 0.0]

    @cached_property
    def bend_speed(self) -> float:
        """Metres per second at which the sharpest bend close ahead is driven."""
        bends = np.abs(np.gradient(self.poses[:, 2], STATIONS))[STATIONS < BENDS_WITHIN]
        return math.sqrt(LATERAL / max(float(bends.max()), 1e-6))

    def _station(self, places: Array) -> NDArray[np.int64]:
        """Indices (...) of the stations of the cells nearest to places (..., 2)."""
        return np.asarray(self.cells.query(places)[1], dtype=np.int64) // len(OFFSETS)
