"""When two moving boxes first touch, in continuous time.

Both boxes move in pieces of constant velocity and turn rate. On a piece of length h the offset along an axis that turns
by a, and the size of the boxes along it, leave the straight line between their values at the ends by no more than
(a^2 d + 2 a m + t^2 r) / 8: the largest second derivative over eight, with d the distance and m the relative way of the
centres, t the turn of the boxes against each other and r their radii. So a piece on which one axis keeps both ends
farther apart than that has no contact. Other pieces are cut in 16 and looked at again, down to a microsecond: nothing
is missed between samples, and the answer does not depend on how a drive was sampled.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scoring.moving_boxes import MovingBox, separations
from olt_generator.poses import Array

TOUCH = -1e-6
"""Overlap in metres (negative gap) from which boxes touch; rounding at far coordinates stays below it."""
_PARTS = 16
_RESOLUTION_US = 1.0


class _Pieces(NamedTuple):
    """Pieces (k,) of the common time of the ego and one other box each: the poses (k, 4) of both at the two ends."""

    other: NDArray[np.int64]
    start_us: Array
    end_us: Array
    ego_start: Array
    ego_end: Array
    other_start: Array
    other_end: Array

    def split(self) -> "_Pieces":
        """Each piece in 16 equal ones."""
        share = np.arange(_PARTS + 1) / _PARTS

        def cut(start: Array, end: Array) -> tuple[Array, Array]:
            shares = share.reshape(1, -1, *[1] * (start.ndim - 1))
            points = start[:, None] + (end - start)[:, None] * shares
            return points[:, :-1].reshape(-1, *start.shape[1:]), points[:, 1:].reshape(-1, *start.shape[1:])

        times = cut(self.start_us, self.end_us)
        ego, other = cut(self.ego_start, self.ego_end), cut(self.other_start, self.other_end)
        return _Pieces(np.repeat(self.other, _PARTS), *times, *ego, *other)


def first_contacts(ego: MovingBox, others: Sequence[MovingBox], start_us: int, end_us: int) -> Array:
    """When each other box (n,) first touches the ego from `start_us` to `end_us`.

    Returns:
        Microseconds after `start_us`; infinite where the two never touch.
    """
    contacts = np.full(len(others), np.inf)
    halves = np.array([box.half_size for box in others]).reshape(-1, 3)
    pieces = _common_pieces(ego, others, start_us, end_us)
    while len(pieces.other):
        theirs = halves[pieces.other]
        gaps, offsets = separations(pieces.ego_start, ego.half_size, pieces.other_start, theirs)
        end_gaps, end_offsets = separations(pieces.ego_end, ego.half_size, pieces.other_end, theirs)
        for touching, times in ((gaps, pieces.start_us), (end_gaps, pieces.end_us)):
            hit = touching.max(axis=1) < TOUCH
            np.minimum.at(contacts, pieces.other[hit], times[hit])
        same_side = offsets * end_offsets > 0.0
        apart = same_side & (np.minimum(gaps, end_gaps) - _bend(pieces, ego, theirs) > TOUCH)
        open_ = ~apart.any(axis=1) & (pieces.start_us < contacts[pieces.other])
        long = pieces.end_us - pieces.start_us > _RESOLUTION_US
        pieces = _Pieces._make(part[open_ & long] for part in pieces).split()
    return contacts


def _bend(pieces: _Pieces, ego: MovingBox, halves: Array) -> Array:
    """Bound (k, 5) on how far gaps on a piece fall below the line between those at its ends; heights do not."""
    starts, ends = pieces.other_start - pieces.ego_start, pieces.other_end - pieces.ego_end
    distance = np.maximum(np.hypot(*starts[:, :2].T), np.hypot(*ends[:, :2].T))
    way = np.hypot(*(ends - starts)[:, :2].T)
    turns = [
        np.abs(pieces.ego_end[:, 3] - pieces.ego_start[:, 3]),
        np.abs(pieces.other_end[:, 3] - pieces.other_start[:, 3]),
    ]
    radii = ego.radius + np.hypot(halves[:, 0], halves[:, 1])
    against = np.abs(ends[:, 3] - starts[:, 3]) ** 2 * radii
    ego_axes, other_axes = ((turn**2 * distance + 2.0 * turn * way + against) / 8.0 for turn in turns)
    return np.stack([ego_axes, ego_axes, other_axes, other_axes, np.zeros_like(way)], axis=-1)


def _common_pieces(ego: MovingBox, others: Sequence[MovingBox], start_us: int, end_us: int) -> _Pieces:
    """The pieces between neighbouring samples of either box; a box that is seen once has one of no length."""
    groups = [_Pieces(np.empty(0, np.int64), *(np.empty(0),) * 2, *(np.empty((0, 4)),) * 4)]
    for index, box in enumerate(others):
        low, high = max(start_us, int(box.timestamps_us[0])), min(end_us, int(box.timestamps_us[-1]))
        if low > high:
            continue
        together = np.array_equal(ego.timestamps_us, box.timestamps_us)
        samples = box.timestamps_us if together else np.union1d(ego.timestamps_us, box.timestamps_us)
        times = np.concatenate([[low], samples[(samples > low) & (samples < high)], [high]])
        after, ours, theirs = (times - start_us).astype(np.float64), ego.at(times), box.at(times)
        other = np.full(len(times) - 1, index)
        groups.append(_Pieces(other, after[:-1], after[1:], ours[:-1], ours[1:], theirs[:-1], theirs[1:]))
    return _Pieces._make(np.concatenate(parts) for parts in zip(*groups, strict=True))
