"""When what was recorded is there: the stretches of its samples between gaps and jumps.

How long a gap is depends on who asks (`sources.tracks`, `scoring.moving_boxes`); that a jump is no motion does not.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array

FASTEST = 100.0
"""m/s; nothing on a road is faster, so samples farther apart are not of one motion."""


def jumps(timestamps_us: NDArray[np.int64], positions: Array) -> NDArray[np.bool_]:
    """Which steps (n - 1,) between samples at rising times (n,) and places (n, 2), metres, nothing on a road makes."""
    ways = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return ways > FASTEST * 1e-6 * np.diff(timestamps_us)


def stretches_between(away: NDArray[np.bool_]) -> Iterator[slice]:
    """The samples (n,) in order, parted at the steps (n - 1,) that are `away`."""
    ends = [0, *(np.flatnonzero(away) + 1).tolist(), len(away) + 1]
    return (slice(first, last) for first, last in pairwise(ends))
