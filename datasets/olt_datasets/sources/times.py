"""Times of a drive: which images lie in a window or stand beside others, and the ego motion from a window's start."""

import numpy as np
from numpy.typing import NDArray

from olt_generator import InputError, Trajectory
from olt_toolkit.policy.window import Span

# An image further in time than this from the front image that it is to stand beside is taken for missing.
FARTHEST_US = 100_000


def images_within(front_us: NDArray[np.int64], window_us: Span, where: str) -> NDArray[np.intp]:
    """Numbers (m,) of the images at times (n,) in microseconds that lie in [first, last]; InputError if none does."""
    inside = np.flatnonzero((front_us >= window_us[0]) & (front_us <= window_us[1]))
    if len(inside) == 0:
        raise InputError(f"{where}: no front image lies between {window_us[0]} and {window_us[1]} us of the drive")
    return inside


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
