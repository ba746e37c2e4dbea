"""Which image of another camera stands beside each front image, and the ego motion over a recording's time."""

import numpy as np
from numpy.typing import NDArray

from olt_generator.trajectory import Trajectory

# An image further in time than this from the front image that it is to stand beside is taken for missing.
FARTHEST_US = 100_000


def nearest_images(times_us: NDArray[np.int64], wanted_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number (m,) of the image at increasing times (n,) nearest to each wanted time; of two as near, the earlier."""
    after = np.minimum(np.searchsorted(times_us, wanted_us), len(times_us) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(wanted_us - times_us[before]) <= np.abs(times_us[after] - wanted_us), before, after)


def farthest_apart(times_us: NDArray[np.int64], wanted_us: NDArray[np.int64]) -> int:
    """Largest time in microseconds between a wanted image (m,) and the nearest of those at times (n,)."""
    return int(np.abs(times_us[nearest_images(times_us, wanted_us)] - wanted_us).max())


def starting_at(drive: Trajectory, start_us: int) -> Trajectory:
    """The motion of a drive over the time of a recording that starts at `start_us`, in the same world."""
    return Trajectory(drive.timestamps_us - start_us, drive.T_world_rig)
