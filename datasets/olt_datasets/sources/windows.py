"""Windows of a drive: which images lie in one, and its ego motion as a recording holds it."""

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.poses import invert
from olt_generator.trajectory import Trajectory
from olt_toolkit.policy_window import Span


def images_within(front_us: NDArray[np.int64], window_us: Span, where: str) -> NDArray[np.intp]:
    """Numbers (m,) of the images at times (n,) that lie in [first, last].

    Raises:
        InputError: there are none; names `where`.
    """
    inside = np.flatnonzero((front_us >= window_us[0]) & (front_us <= window_us[1]))
    if len(inside) == 0:
        raise InputError(f"{where}: no front image lies between {window_us[0]} and {window_us[1]} us of the drive")
    return inside


def from_window_start(trajectory: Trajectory, start_us: int) -> Trajectory:
    """The whole trajectory of a drive in times since, and in the rig at, the first image of a window.

    Raises:
        InputError: it does not cover that time.
    """
    start = trajectory.interpolate(np.array([start_us]))[0]
    return Trajectory(trajectory.timestamps_us - start_us, invert(start) @ trajectory.T_world_rig)
