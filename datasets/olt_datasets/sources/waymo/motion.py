"""The trajectory of a Waymo E2E drive, put together from what each of its frames tells of past and future.

Every frame holds a path: its own past and future positions, four a second, in its own rig. There is no global pose and
no heading. But the paths of two frames are pieces of one and the same drive, so the rigid motion that lays the path of
one on the path of the other over the time that they share is the pose of one frame in the other: position and heading.
A drive is such frames chained one to the next. Motion is in the plane; what a frame tells of heights is not used.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from olt_datasets.sources.waymo.frames import STATE_US
from olt_generator import InputError, Trajectory
from olt_generator.poses import Array, planar_pose

# Two paths must share this much time to be laid on one another.
_MIN_SHARED_US = 1_000_000
# A path that stays within this radius, metres, has no direction: the vehicle stands and does not turn.
_STANDING_RADIUS = 0.5
# Paths of one drive have the same length where they share time, up to this many metres and this share.
_LENGTH_TOLERANCE, _LENGTH_SHARE = 0.5, 0.05
# Slower than this, m/s, the tangent of a path is noise, and the heading is kept.
_MIN_TANGENT_SPEED = 0.5


@dataclass(frozen=True)
class FramePath:
    """The path of one frame: positions (n, 2), metres in its rig, at offsets (n,) from its time; 0 is among them."""

    time_us: int
    offsets_us: NDArray[np.int64]
    positions: Array

    @classmethod
    def from_states(cls, time_us: int, past: ArrayLike, future: ArrayLike) -> "FramePath":
        """The path of past states (n, 2), the last of them now, and future states (m, 2); either may be flat."""
        past, future = np.reshape(past, (-1, 2)), np.reshape(future, (-1, 2))
        offsets_us = STATE_US * np.arange(1 - len(past), len(future) + 1, dtype=np.int64)
        return cls(time_us, offsets_us, np.concatenate([past, future]))

    @property
    def times_us(self) -> NDArray[np.int64]:
        """Times (n,) of the positions in the drive."""
        return self.time_us + self.offsets_us


def chain_paths(paths: list[FramePath], where: str) -> Trajectory:
    """The trajectory of a drive in the rig of its first frame, from paths in order of time, at least one.

    It has the poses of all frames, before them the past of the first, and after them the future of the last. Paths of
    neighbours must be of one drive and share enough time, else InputError.
    """
    T_first_frame = [np.eye(4)]
    for before, after in pairwise(paths):
        T_first_frame.append(T_first_frame[-1] @ _pose_of(after, before, where))
    poses = np.stack(T_first_frame)
    first, last = paths[0], paths[-1]
    past, future = first.offsets_us < 0, last.offsets_us > 0
    return Trajectory(
        np.concatenate([first.times_us[past], [path.time_us for path in paths], last.times_us[future]]),
        np.concatenate([_poses_along(first)[past], poses, poses[-1] @ _poses_along(last)[future]]),
    )


def _pose_of(frame: FramePath, other: FramePath, where: str) -> Array:
    """Pose (4, 4) of a frame in the rig of another, earlier one."""
    shared = (frame.times_us >= other.times_us[0]) & (frame.times_us <= other.times_us[-1])
    times_us = frame.times_us[shared]
    between = f"{where}: frames at {other.time_us / 1e6:.1f} s and {frame.time_us / 1e6:.1f} s"
    if len(times_us) == 0 or times_us[-1] - times_us[0] < _MIN_SHARED_US:
        raise InputError(f"{between} have no paths that meet; copy the shards with the frames between them")
    here = frame.positions[shared]
    there = CubicSpline(other.times_us, other.positions)(times_us)
    lengths = _path_length(here), _path_length(there)
    if abs(lengths[0] - lengths[1]) > _LENGTH_TOLERANCE + _LENGTH_SHARE * max(lengths):
        raise InputError(
            f"{between} tell of paths of {lengths[0]:.1f} and {lengths[1]:.1f} m over the same time; "
            "they are not of one drive, give Waymo's shards unchanged"
        )
    # The planar motion that brings the points of one closest to those of the other (Kabsch, in the plane).
    here_middle, there_middle = here.mean(axis=0), there.mean(axis=0)
    a, b = here - here_middle, there - there_middle
    yaw = 0.0
    if np.linalg.norm(a, axis=1).max() > _STANDING_RADIUS:
        yaw = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    x, y = there_middle - planar_pose(0.0, 0.0, yaw)[:2, :2] @ here_middle
    return planar_pose(x, y, yaw)


def _poses_along(path: FramePath) -> Array:
    """Poses (n, 4, 4) along a path in the rig of its frame, where its heading is 0; elsewhere they head along it."""
    times, now = path.offsets_us * 1e-6, path.offsets_us == 0
    velocity = CubicSpline(times, path.positions)(times, 1)
    known = now | (np.linalg.norm(velocity, axis=1) > _MIN_TANGENT_SPEED)
    tangent = np.where(now, 0.0, np.arctan2(velocity[:, 1], velocity[:, 0]))
    # The tangent of a vehicle that backs up points the other way.
    heading = np.unwrap(tangent[known], period=np.pi)
    yaw = np.interp(times, times[known], heading - heading[now[known]])
    return planar_pose(path.positions[:, 0], path.positions[:, 1], yaw)


def _path_length(positions: Array) -> float:
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
