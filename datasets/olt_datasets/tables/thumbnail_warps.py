"""Thumbnails as they would be had the image been cropped or turned."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from olt_toolkit.clips.fingerprint import COLUMNS, ROWS

SparseMatrix = scipy.sparse.csr_array
# What is neither enlarged nor reduced may still be moved, by this share of the image: a bar not taken for one, a turn.
_LOOSE_SHARE = 0.06


@dataclass(frozen=True)
class Warp:
    """Where a warped thumbnail's cells lie in a thumbnail: `scale` cells for one, about the middle, then moved.

    Attributes:
        scale: cells of the thumbnail that one of the warped one covers.
        along, down: by how many cells the middle is moved.
        turn: in radians.
        stretch: by how much more the scale is down than along.
    """

    scale: float
    along: float = 0.0
    down: float = 0.0
    turn: float = 0.0
    stretch: float = 1.0

    def matrix(self) -> SparseMatrix:
        """The bilinear warp (cells, cells), without entries for cells that lie outside of the thumbnail."""
        down, along = np.mgrid[:ROWS, :COLUMNS].astype(float)
        half_along, half_down = 0.5 * (COLUMNS - 1), 0.5 * (ROWS - 1)
        cosine, sine = self.scale * np.cos(self.turn), self.scale * np.sin(self.turn)
        from_middle, below_middle = along - half_along, down - half_down
        x = cosine * from_middle - sine * below_middle + half_along + self.along
        y = self.stretch * (sine * from_middle + cosine * below_middle) + half_down + self.down
        inside = (np.abs(x - half_along) <= 0.5 * COLUMNS) & (np.abs(y - half_down) <= 0.5 * ROWS)
        return _bilinear(x, y, inside)


@lru_cache(maxsize=4)
def list_crops(scales: tuple[float, ...], shifts: tuple[float, ...]) -> tuple[Warp, ...]:
    """Crops to `scales` of a thumbnail, or the other way round.

    Args:
        scales: cells of the thumbnail that one of the warped one covers.
        shifts: how far along and down, of the room between the two sizes: -1 and 1 are flush with a side.
    """
    crops = []
    for scale in scales:
        room = _LOOSE_SHARE if scale == 1.0 else 0.5 * abs(scale - 1.0)
        crops += [Warp(scale, along * room * COLUMNS, down * room * ROWS) for along in shifts for down in shifts]
    return tuple(crops)


@lru_cache(maxsize=512)
def stack_warps(warps: tuple[Warp, ...]) -> tuple[SparseMatrix, NDArray[np.float32]]:
    """Warps in one matrix (warps x cells, cells), and which cells (warps, cells) each fills: 1, else 0."""
    stacked = SparseMatrix(scipy.sparse.vstack([warp.matrix() for warp in warps]))
    filled = stacked.sum(axis=1) > 0.5
    return stacked, filled.reshape(len(warps), -1).astype(np.float32)


def _bilinear(x: NDArray[np.float64], y: NDArray[np.float64], inside: NDArray[np.bool_]) -> SparseMatrix:
    """The matrix that takes values at the places (ROWS, COLUMNS) from a thumbnail, 0 outside of it."""
    x, y = x.clip(0.0, COLUMNS - 1.0), y.clip(0.0, ROWS - 1.0)
    left, above = np.minimum(x.astype(int), COLUMNS - 2), np.minimum(y.astype(int), ROWS - 2)
    to_right, to_below = x - left, y - above
    corners = [
        (above, left, (1.0 - to_below) * (1.0 - to_right)),
        (above, left + 1, (1.0 - to_below) * to_right),
        (above + 1, left, to_below * (1.0 - to_right)),
        (above + 1, left + 1, to_below * to_right),
    ]
    cells = ROWS * COLUMNS
    rows = np.tile(np.arange(cells), len(corners))
    columns = np.concatenate([(row * COLUMNS + column).ravel() for row, column, _ in corners])
    weights = np.concatenate([(weight * inside).ravel() for _, _, weight in corners]).astype(np.float32)
    return scipy.sparse.coo_array((weights, (rows, columns)), (cells, cells)).tocsr()
