"""A timed sequence of rig poses."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, make_pose


@dataclass(frozen=True)
class Trajectory:
    """Rig poses over time.

    Attributes:
        timestamps_us: (n,) int64 microseconds, strictly increasing.
        T_world_rig: (n, 4, 4) float64, the pose of the rig in a fixed frame.
    """

    timestamps_us: NDArray[np.int64]
    T_world_rig: Array

    def __post_init__(self) -> None:
        if len(self.timestamps_us) != len(self.T_world_rig) or len(self.timestamps_us) == 0:
            raise InputError(
                f"trajectory: {len(self.timestamps_us)} timestamps for {len(self.T_world_rig)} poses; "
                "give one pose per timestamp and at least one"
            )
        steps = np.diff(self.timestamps_us)
        if np.any(steps <= 0):
            index = int(np.argmax(steps <= 0)) + 1
            raise InputError(f"trajectory: timestamp {index} is not after the one before it; sort and deduplicate them")
        if not np.all(np.isfinite(self.T_world_rig)):
            index = int(np.argmin(np.isfinite(self.T_world_rig).all(axis=(1, 2))))
            raise InputError(f"trajectory: pose {index} is not finite")

    def __len__(self) -> int:
        return len(self.timestamps_us)

    @property
    def times(self) -> Array:
        """Seconds (n,) since the first pose."""
        return (self.timestamps_us - self.timestamps_us[0]) * 1e-6

    @property
    def positions(self) -> Array:
        """Positions (n, 3) of the rig origin, metres."""
        return self.T_world_rig[:, :3, 3]

    @property
    def path_length(self) -> float:
        """Length of the driven path in metres."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def interpolate(self, timestamps_us: NDArray[np.int64]) -> Array:
        """Poses (m, 4, 4) at the given times: linear in position, spherical in rotation.

        Raises:
            InputError: a time lies outside the first and last pose.
        """
        query = np.atleast_1d(np.asarray(timestamps_us, dtype=np.int64))
        first, last = int(self.timestamps_us[0]), int(self.timestamps_us[-1])
        if query.min() < first or query.max() > last:
            raise InputError(
                f"trajectory covers {first} to {last} us; {int(query.min())} to {int(query.max())} us was asked for"
            )
        if len(self) == 1:
            return np.repeat(self.T_world_rig, len(query), axis=0)
        # Only the poses around the times are looked at: a camera asks for one time after another.
        start = max(int(np.searchsorted(self.timestamps_us, query.min(), side="right")) - 1, 0)
        end = max(int(np.searchsorted(self.timestamps_us, query.max())), start + 1) + 1
        around, poses = self.timestamps_us[start:end], self.T_world_rig[start:end]
        if len(around) == 1:
            return np.repeat(poses, len(query), axis=0)
        # Offsets from the first time keep microseconds exact in float64.
        offsets, known = (query - first).astype(np.float64), (around - first).astype(np.float64)
        rotation = Slerp(known, Rotation.from_matrix(poses[:, :3, :3]))(offsets).as_matrix()
        position = np.stack([np.interp(offsets, known, axis) for axis in poses[:, :3, 3].T], axis=-1)
        return make_pose(rotation, position)

    def in_first_frame(self) -> "Trajectory":
        """The same motion expressed in the frame of its first pose."""
        return Trajectory(self.timestamps_us, invert(self.T_world_rig[0]) @ self.T_world_rig)
