"""Boxes over time in single precision, as AlpaSim keeps them.

Positions, yaws and corners are float32, so that far from the origin they lie on a grid: 0.06 m at 1e6 m.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.alpasim.series import UnmeasuredError
from olt_closed_loop.drive_record import EgoBox
from olt_closed_loop.scene import Agent
from olt_generator.poses import Array

SHRINK = 0.02
ROUNDNESS = 0.5
QUADRANT_SEGMENTS = 16

Single = NDArray[np.float32]
Geometries = NDArray[np.object_]


@dataclass(frozen=True)
class RoundedBox:
    """A box shrunk by 2 % whose corners are rounded by half of half its shorter side."""

    length: float
    width: float

    @classmethod
    def of(cls, length: float, width: float) -> "RoundedBox":
        """The shape that stands for a box of that size."""
        return cls(*(float(np.float32(side)) * (1.0 - SHRINK) for side in (length, width)))

    @property
    def corner_radius(self) -> float:
        """Radius of the corners, metres."""
        return ROUNDNESS * min(self.length, self.width) / 2.0

    @property
    def reach(self) -> float:
        """Radius of the circle about the centre that holds the box, metres."""
        return float(np.hypot(self.length, self.width)) / 2.0

    def corners(self, positions: Single, yaws: Single) -> Single:
        """Corners (n, 4, 2): front left, front right, rear right, rear left."""
        (x, y), cos, sin = positions.T, np.cos(yaws), np.sin(yaws)
        ahead, aside = self.length / 2.0, self.width / 2.0
        signs = ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))
        corners = [
            (x + along * ahead * cos - across * aside * sin, y + along * ahead * sin + across * aside * cos)
            for along, across in signs
        ]
        return np.moveaxis(np.array(corners, dtype=np.float32), -1, 0)

    def polygons(self, positions: Single, yaws: Single) -> Geometries:
        """Outlines (n,): the boxes eroded and dilated by the corner radius."""
        boxes = shapely.polygons(self.corners(positions, yaws))
        eroded = shapely.buffer(boxes, -self.corner_radius, quad_segs=QUADRANT_SEGMENTS)
        return np.asarray(shapely.buffer(eroded, self.corner_radius, quad_segs=QUADRANT_SEGMENTS))

    def end_zones(self, positions: Single, yaws: Single) -> tuple[Geometries, Geometries]:
        """The parts (n,) of the outlines within a corner radius of the front edge, and of the rear edge."""
        corners, outlines = self.corners(positions, yaws), self.polygons(positions, yaws)
        edges = (shapely.linestrings(corners[:, :2]), shapely.linestrings(corners[:, 2:]))
        front, rear = (shapely.buffer(edge, self.corner_radius, quad_segs=QUADRANT_SEGMENTS) for edge in edges)
        return np.asarray(shapely.intersection(front, outlines)), np.asarray(shapely.intersection(rear, outlines))


@dataclass(frozen=True)
class Track:
    """Box centres (n, 2) in single precision and unwrapped yaws (n,) at times (n,)."""

    times_us: NDArray[np.int64]
    positions: Single
    yaws: Array

    def exists(self, times_us: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which times (m,) lie between the first and the last sample, both included."""
        return (times_us >= self.times_us[0]) & (times_us <= self.times_us[-1])

    def at(self, times_us: NDArray[np.int64]) -> tuple[Single, Single]:
        """Positions (m, 2) and yaws (m,), wrapped.

        Raises:
            UnmeasuredError: a time lies outside the track.
        """
        if not self.exists(times_us).all():
            raise UnmeasuredError(f"a time outside {self.times_us[0]} to {self.times_us[-1]} us is asked for")
        after = np.clip(np.searchsorted(self.times_us, times_us, side="right"), 1, max(len(self.times_us) - 1, 1))
        before, after = after - 1, np.minimum(after, len(self.times_us) - 1)
        span = np.maximum(self.times_us[after] - self.times_us[before], 1)
        share = (times_us - self.times_us[before]) / span
        start, end = self.positions[before], self.positions[after]
        positions = (start + (end - start) * share[:, None].astype(np.float32)).astype(np.float32)
        return positions, wrapped(self.yaws[before] + (self.yaws[after] - self.yaws[before]) * share)


def ego_track(times_us: NDArray[np.int64], rig_poses: Array, box: EgoBox) -> Track:
    """The track of the ego's box centre along rig poses whose columns are x, y, ..., yaw."""
    half_yaws = 0.5 * rig_poses[:, -1]
    z, w = np.sin(half_yaws).astype(np.float32), np.cos(half_yaws).astype(np.float32)
    offsets = np.float32(box.rear_axle_to_center) * np.stack([1.0 - 2.0 * z * z, 2.0 * w * z], axis=-1)
    positions = rig_poses[:, :2].astype(np.float32) + offsets
    return Track(times_us, positions.astype(np.float32), np.unwrap(rig_poses[:, -1]))


def agent_track(agent: Agent) -> Track:
    """The track of an agent's box centre."""
    return Track(agent.timestamps_us, agent.poses[:, :2].astype(np.float32), np.unwrap(agent.poses[:, 3]))


def wrapped(yaws: Array) -> Single:
    """Yaws (n,) as single precision angles from -pi to pi."""
    return np.arctan2(np.sin(yaws), np.cos(yaws)).astype(np.float32)
