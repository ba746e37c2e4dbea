"""Straight lines in time along which one sequence of images may lie on another: any offset, half to double speed.

Source: M. Milford, G. Wyeth: SeqSLAM, ICRA 2012.
"""

import numpy as np
from numpy.typing import NDArray

SPEEDS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.11, 1.25, 1.43, 1.67, 2.0)
_LEAST_SHARE = 0.35
"""Of the images of the shorter sequence that must be matched."""
_TINY = 1e-6


def list_lines(short: NDArray[np.float64], long: NDArray[np.float64]) -> NDArray[np.int64]:
    """Which image of the longer sequence (lines, k) lies on each image of the shorter; its length for none.

    Args:
        short, long: ascending times (k,), (n,) in one unit.
    """
    mine, theirs = short - short.mean(), long - long.mean()
    my_step, their_step = (np.ptp(each) / max(len(each) - 1, 1) for each in (mine, theirs))
    fewest = min(len(mine), len(theirs))
    least = max(min(2, fewest), _LEAST_SHARE * fewest)
    between = 0.5 * (theirs[1:] + theirs[:-1])
    lines = []
    for speed in SPEEDS:
        step = max(their_step, my_step * speed)
        reach = 0.5 * (np.ptp(mine) * speed + np.ptp(theirs))
        offsets = np.arange(-reach, reach + _TINY, 0.5 * step) if step > 0.0 else np.zeros(1)
        moments = mine * speed + offsets[:, None]
        nearest = np.searchsorted(between, moments)
        near = np.abs(moments - theirs[nearest]) <= 0.5 * step + _TINY
        found = np.where(near, nearest, len(theirs))
        lines.append(found[near.sum(axis=1) >= least])
    return np.unique(np.concatenate(lines), axis=0)
