"""Poses that no vehicle can have been at, judged by the poses around them."""

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_generator.twists import vector_from_rotation

# Each pose is compared with so many before and behind it.
NEIGHBOURS = 3
# How far and how fast a vehicle and its noise may go from one pose to another: m, m/s, rad, rad/s.
REACH, SPEED = 1.0, 80.0
ANGLE, TURN_RATE = 0.2, 1.5


def find_outliers(trajectory: Trajectory) -> NDArray[np.bool_]:
    """Poses (n,) from which most of the neighbours cannot be reached."""
    n, rotations = len(trajectory), trajectory.T_world_rig[:, :3, :3]
    reached, compared = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    for offset in range(1, min(NEIGHBOURS, n - 1) + 1):
        seconds = trajectory.times[offset:] - trajectory.times[:-offset]
        distance = np.linalg.norm(trajectory.positions[offset:] - trajectory.positions[:-offset], axis=1)
        turn = vector_from_rotation(np.swapaxes(rotations[:-offset], -1, -2) @ rotations[offset:])
        angle = np.linalg.norm(turn, axis=1)
        reachable = (distance <= REACH + SPEED * seconds) & (angle <= ANGLE + TURN_RATE * seconds)
        for side in (slice(offset, n), slice(0, n - offset)):
            reached[side] += reachable
            compared[side] += 1
    return 2 * reached < compared


def replace_outliers(trajectory: Trajectory) -> Array:
    """Poses (n, 4, 4) with the outliers interpolated between the others; at the ends, the nearest of these."""
    outliers = find_outliers(trajectory)
    if not outliers.any() or outliers.all():
        return trajectory.T_world_rig
    times = trajectory.timestamps_us
    credible = Trajectory(times[~outliers], trajectory.T_world_rig[~outliers])
    poses = trajectory.T_world_rig.copy()
    poses[outliers] = credible.interpolate(
        np.clip(times[outliers], credible.timestamps_us[0], credible.timestamps_us[-1])
    )
    return poses
