"""Boxes over time in single precision, as AlpaSim keeps them.

Positions, yaws and corners are float32, so that far from the origin they lie on a grid: 0.06 m at 1e6 m.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout_record import EgoBox
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.alpasim.series import UnmeasuredError
from olt_generator.poses import Array

SHRINK = 0.02
ROUNDNESS = 0.5
QUADRANT_SEGMENTS = 16

Single = NDArray[np.float32]
Times = NDArray[np.int64]
Indices = NDArray[np.int64]
Geometries = NDArray[np.object_]


@dataclass(frozen=True)
class RoundedBoxes:
    """Boxes (n,) shrunk by 2 % whose corners are rounded by half of half their shorter side."""

    lengths: Array
    widths: Array

    @classmethod
    def of(cls, lengths: Sequence[float], widths: Sequence[float]) -> "RoundedBoxes":
        """The shapes that stand for boxes of these sizes."""
        return cls(
            *(np.array(sides, dtype=np.float32).astype(np.float64) * (1.0 - SHRINK) for sides in (lengths, widths))
        )

    def select(self, indices: Indices) -> "RoundedBoxes":
        """The shapes (m,) at some indices."""
        return RoundedBoxes(self.lengths[indices], self.widths[indices])

    @property
    def corner_radii(self) -> Array:
        """Radii (n,) of the corners, metres."""
        return ROUNDNESS * np.minimum(self.lengths, self.widths) / 2.0

    @property
    def reaches(self) -> Array:
        """Radii (n,) of the circles about the centres that hold the boxes, metres."""
        return np.hypot(self.lengths, self.widths) / 2.0

    @property
    def half_sizes(self) -> Array:
        """Halves (n, 3) of length and width; heights are 0."""
        return np.stack([self.lengths / 2.0, self.widths / 2.0, np.zeros(len(self.lengths))], axis=-1)

    def corners(self, positions: Single, yaws: Single) -> Single:
        """Corners (m, 4, 2): front left, front right, rear right, rear left; one shape (1,) or one each (m,)."""
        (x, y), cos, sin = positions.T, np.cos(yaws), np.sin(yaws)
        ahead, aside = (self.half_sizes[:, axis].astype(np.float32) for axis in (0, 1))
        signs = ((1, 1), (1, -1), (-1, -1), (-1, 1))
        corners = [
            (x + along * ahead * cos - across * aside * sin, y + along * ahead * sin + across * aside * cos)
            for along, across in signs
        ]
        return np.moveaxis(np.array(corners, dtype=np.float32), -1, 0)

    def polygons(self, positions: Single, yaws: Single) -> Geometries:
        """Outlines (m,): the boxes eroded and dilated by the corner radius."""
        boxes = shapely.polygons(self.corners(positions, yaws))
        eroded = shapely.buffer(boxes, -self.corner_radii, quad_segs=QUADRANT_SEGMENTS)
        return np.asarray(shapely.buffer(eroded, self.corner_radii, quad_segs=QUADRANT_SEGMENTS))

    def end_zones(self, positions: Single, yaws: Single) -> tuple[Geometries, Geometries]:
        """The parts (m,) of the outlines within a corner radius of the front edge, and of the rear edge."""
        corners, outlines = self.corners(positions, yaws), self.polygons(positions, yaws)
        edges = (shapely.linestrings(corners[:, :2]), shapely.linestrings(corners[:, 2:]))
        front, rear = (shapely.buffer(edge, self.corner_radii, quad_segs=QUADRANT_SEGMENTS) for edge in edges)
        return np.asarray(shapely.intersection(front, outlines)), np.asarray(shapely.intersection(rear, outlines))


@dataclass(frozen=True)
class BoxTracks:
    """Box centres over time, of many boxes in one table.

    Attributes:
        firsts: (k + 1,) the samples of track i are the rows from `firsts[i]` to `firsts[i + 1]`, one at least.
        times_us: (n,) int64, strictly increasing within a track.
        positions: (n, 2) single precision.
        yaws: (n,) unwrapped within a track.
    """

    firsts: Indices
    times_us: Times
    positions: Single
    yaws: Array

    def __len__(self) -> int:
        return len(self.firsts) - 1

    def exists(self, times_us: Times, tracks: Indices | int = 0) -> NDArray[np.bool_]:
        """Which times (m,) lie between the first and the last sample of the track (m,) asked for, both included."""
        first, last = self._spans(tracks)
        return (times_us >= first) & (times_us <= last)

    def _spans(self, tracks: Indices | int) -> tuple[Times, Times]:
        """First and last time (m,) of tracks (m,)."""
        return self.times_us[self.firsts[tracks]], self.times_us[self.firsts[np.add(tracks, 1)] - 1]

    def at(self, times_us: Times, tracks: Indices | int = 0) -> tuple[Single, Single]:
        """Positions (m, 2) in metres and yaws (m,) from -pi to pi of the tracks (m,) at these times.

        Raises:
            UnmeasuredError: a time lies outside its track.
        """
        exists = self.exists(times_us, tracks)
        if not exists.all():
            first, last = (np.broadcast_to(ends, exists.shape)[np.argmin(exists)] for ends in self._spans(tracks))
            raise UnmeasuredError(f"a time outside {first} to {last} us is asked for")
        # Tracks are put one behind the other on one axis of time, so that one search finds the samples of all. The only
        # sample of a track is both before and after.
        start, owners = self.times_us[:1], np.repeat(np.arange(len(self)), np.diff(self.firsts))
        length = 2 * np.abs(self.times_us - start).max(initial=0) + 1
        known, asked = self.times_us - start + length * owners, times_us - start + length * np.asarray(tracks)
        first, last = self.firsts[tracks], self.firsts[np.add(tracks, 1)] - 1
        after = np.clip(np.searchsorted(known, asked, side="right"), first + 1, np.maximum(last, first + 1))
        before, after = after - 1, np.minimum(after, last)
        span = np.maximum(self.times_us[after] - self.times_us[before], 1)
        share = (times_us - self.times_us[before]) / span
        begin, end = self.positions[before], self.positions[after]
        positions = (begin + (end - begin) * share[:, None].astype(np.float32)).astype(np.float32)
        yaws = self.yaws[before] + (self.yaws[after] - self.yaws[before]) * share
        return positions, np.arctan2(np.sin(yaws), np.cos(yaws)).astype(np.float32)


def ego_track(times_us: Times, rig_poses: Array, box: EgoBox) -> BoxTracks:
    """The one track of the ego's box centre along rig poses whose columns are x, y, ..., yaw."""
    return ego_tracks([times_us], [rig_poses], box)


def ego_tracks(times_us: Sequence[Times], rig_poses: Sequence[Array], box: EgoBox) -> BoxTracks:
    """The tracks of the ego's box centre along several ways of the rig."""
    poses = np.concatenate([np.empty((0, 3)), *(poses[:, [0, 1, -1]] for poses in rig_poses)])
    half_yaws = 0.5 * poses[:, 2]
    z, w = np.sin(half_yaws).astype(np.float32), np.cos(half_yaws).astype(np.float32)
    offsets = np.float32(box.rear_axle_to_center) * np.stack([1.0 - 2.0 * z * z, 2.0 * w * z], axis=-1)
    positions = poses[:, :2].astype(np.float32) + offsets
    return _tracks(times_us, positions.astype(np.float32), poses[:, 2])


def agent_tracks(agents: Sequence[Agent]) -> BoxTracks:
    """The tracks of the agents' box centres."""
    poses = np.concatenate([np.empty((0, 4)), *(agent.poses for agent in agents)])
    return _tracks([agent.timestamps_us for agent in agents], poses[:, :2].astype(np.float32), poses[:, 3])


def _tracks(times_us: Sequence[Times], positions: Single, yaws: Array) -> BoxTracks:
    """The table of tracks; yaws are unwrapped in the tracks that have a jump."""
    firsts, unwrapped = np.cumsum([0, *map(len, times_us)]), yaws.copy()
    jumps = np.flatnonzero(np.abs(np.diff(yaws)) >= np.pi) + 1
    for track in np.unique(np.searchsorted(firsts, jumps, side="right") - 1):
        rows = slice(firsts[track], firsts[track + 1])
        unwrapped[rows] = np.unwrap(yaws[rows])
    return BoxTracks(firsts, np.concatenate([np.empty(0, np.int64), *times_us]), positions, unwrapped)
