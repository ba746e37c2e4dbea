"""The road ahead seen from above, and how far pieces of it shift between two frames.

The picture of each frame is laid on the plane of the road, metric, with the rotation between the frames taken out; what
lies on the road then differs by a shift along the direction of travel, which is the distance driven. The shift is found
by normalised correlation of all pixels, not of corners: asphalt has few corners, and lines that run along the road, on
which corners slide, say nothing about the shift and do no harm.

The grid is wider than the lane and cut into cells, each with its own shift, because much of what is seen there may be
no road at all: a vehicle ahead, lorries on both sides, the light of the headlamps.
"""

from copy import copy
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.motion.features import Gray
from olt_generator.poses import Array

# The grid, in camera heights ahead of the camera: nearer is bonnet, farther is a few pixels a metre.
NEAREST_HEIGHTS = 3.5
FARTHEST_HEIGHTS = 12.0
LENGTH_HEIGHTS = 9.0
SPACING_ALONG = 0.05
SPACING_ACROSS = 0.1
# Cells are so long, and so wide; their middles lie beside each other up to this far from the middle of the grid.
CELL_METRES = (2.0, 1.0)
FARTHEST_ACROSS = 4.5
# Half the width of the vehicle's own lane, metres.
OWN_LANE = 1.6
# Brightness changes over more than this length are light and shade of the lens, not road.
DETAIL_METRES = 1.0
# A cell must be seen to this share, and differ from its surroundings by so many grey levels.
LEAST_SEEN = 0.6
LEAST_CONTRAST = 1.0


@dataclass(frozen=True)
class RoadFrame:
    """Axes of the road in one camera, each (3,): along the drive, to the left, and up from the road."""

    along: Array
    left: Array
    up: Array

    def rotated(self, rotation: Array) -> "RoadFrame":
        """The same axes in a camera turned by `rotation` (3, 3)."""
        return RoadFrame(rotation @ self.along, rotation @ self.left, rotation @ self.up)


def road_frame(travel: Array, up: Array, direction: Array) -> RoadFrame:
    """Axes of the road in camera coordinates, from the `direction` (3,) of a step.

    The road contains the usual direction of `travel` (3,); of the rough `up` (3,) only the roll about it matters.
    """
    normal = _unit(up - (up @ travel) * travel)
    along = _unit(direction - (direction @ normal) * normal)
    return RoadFrame(along, np.cross(normal, along), normal)


@dataclass(frozen=True)
class RoadPicture:
    """Grey levels (along, across) of the road without their local mean, 0 where the road is not `seen`."""

    detail: NDArray[np.float32]
    seen: NDArray[np.bool_]


@dataclass(frozen=True)
class CellMatches:
    """How well every cell of the second picture of a pair agrees with the first one, by the distance driven.

    Attributes:
        along: (rows,) distance of the middle of each cell ahead of the second camera, metres, from near to far.
        across: (columns,) its distance to the left, metres.
        correlation: (columns, rows, shifts) for the shifts of `RoadGrid.shifts`; NaN where the road was not seen, and
            all over cells that show nothing.
    """

    along: Array
    across: Array
    correlation: Array


class RoadGrid:
    """The piece of road that one camera matches between frames."""

    def __init__(self, camera: Camera, height: float, axes: RoadFrame, hidden: NDArray[np.bool_]) -> None:
        """Lay the grid where the road becomes visible.

        Height is that of the camera above the road in metres; hidden pixels (H, W) show no road, such as the bonnet.

        Raises:
            InputError: no road is in view.
        """
        self.camera, self.height, self._shows = camera, height, (~hidden).astype(np.uint8)
        ahead = np.arange(NEAREST_HEIGHTS * height, FARTHEST_HEIGHTS * height, SPACING_ALONG)
        _, visible = self._locate(axes, ahead, np.linspace(-OWN_LANE, OWN_LANE, 9))
        visible = visible.mean(axis=1) > 0.5
        if not visible.any():
            raise InputError("odometry: the camera sees no road ahead, so speed is unknown; check its pitch and height")
        nearest = ahead[int(np.argmax(visible))]
        self.along = nearest + np.arange(0.0, LENGTH_HEIGHTS * height, SPACING_ALONG)
        half = FARTHEST_ACROSS + 0.5 * (CELL_METRES[1] - SPACING_ACROSS)
        self.across = np.arange(-half, half + 1e-9, SPACING_ACROSS)
        self.cell = round(CELL_METRES[0] / SPACING_ALONG), round(CELL_METRES[1] / SPACING_ACROSS)
        rows = len(self.along) - self.cell[0]
        self.shifts: Array = np.arange(-rows, rows + 1, dtype=np.float64) * SPACING_ALONG
        """Distances driven (shifts,) that are tried, metres; negative ones are driven backward."""

    def narrowed(self, farthest: float) -> "RoadGrid":
        """The same grid with only the cells whose middles are at most this far to either side, metres."""
        width = self.cell[1]
        middle = self.across[::width] + 0.5 * (width - 1) * SPACING_ACROSS
        narrow = copy(self)
        narrow.across = self.across[np.repeat(np.abs(middle) <= farthest, width)]
        return narrow

    def rectify(self, gray: Gray, axes: RoadFrame) -> RoadPicture:
        """The road seen from above."""
        pixels, seen = self._locate(axes, self.along, self.across)
        # Half a pixel beyond the middle of the last one is still in the picture.
        border = cv2.BORDER_REPLICATE
        table = pixels[..., 0], pixels[..., 1]
        picture = cv2.remap(gray, *table, cv2.INTER_LINEAR, borderMode=border).astype(np.float32)
        size = (round(DETAIL_METRES / SPACING_ACROSS), round(DETAIL_METRES / SPACING_ALONG))
        if seen.all():
            return RoadPicture(picture - cv2.blur(picture, size), seen)
        share = np.maximum(cv2.blur(seen.astype(np.float32), size), 1e-6)
        mean = cv2.blur(np.where(seen, picture, np.float32(0.0)), size) / share
        return RoadPicture(np.where(seen, picture - mean, np.float32(0.0)), seen)

    def match(self, first: RoadPicture, second: RoadPicture) -> CellMatches:
        """Correlation of the cells of the second picture that show something, for every shift.

        Normalised as `cv2.TM_CCOEFF_NORMED` is; all cells of a column are one product of matrices.
        """
        length, width = self.cell
        rows, columns = len(self.along) // length, len(self.across) // width
        size = length * width
        cells = self._cut(second.detail)[:, : rows * length].reshape(columns, rows, size)
        cells = cells - cells.mean(axis=-1, keepdims=True)
        contrast = np.sqrt(np.mean(cells**2, axis=-1))
        shows = (contrast >= LEAST_CONTRAST) & (self._sum_windows(second.seen)[:, ::length] >= LEAST_SEEN * size)
        cells /= np.maximum(contrast, LEAST_CONTRAST)[..., None] * np.sqrt(size)
        strips = self._cut(first.detail).reshape(columns, -1)
        # A copy: overlapping windows are no matrix to BLAS.
        windows = np.ascontiguousarray(np.lib.stride_tricks.sliding_window_view(strips, size, axis=1)[:, ::width])
        total, squares = self._sum_windows(first.detail), self._sum_windows(first.detail**2)
        spread = np.sqrt(np.maximum(squares - total**2 / size, 1e-6 * size))
        tried = self._sum_windows(first.seen) >= LEAST_SEEN * size
        scores = np.where(tried, np.matmul(windows, np.swapaxes(cells, 1, 2)).transpose(2, 0, 1) / spread, np.nan)
        middle = len(self.shifts) // 2
        found = np.full((columns, rows, len(self.shifts)), np.nan)
        for row in range(rows):
            at = middle - row * length
            found[:, row, at : at + scores.shape[-1]] = np.where(shows[:, row, None], scores[row], np.nan)
        starts = length * np.arange(rows), width * np.arange(columns)
        half = 0.5 * CELL_METRES[0], 0.5 * CELL_METRES[1]
        return CellMatches(self.along[starts[0]] + half[0], self.across[starts[1]] + half[1], found)

    def _cut(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """A picture (along, across) in columns of cells (columns, along, width)."""
        width = self.cell[1]
        return np.ascontiguousarray(picture.reshape(len(picture), -1, width).swapaxes(0, 1))

    def _sum_windows(self, picture: NDArray[np.float32] | NDArray[np.bool_]) -> Array:
        """Sums (columns, starts) over pieces of the size of a cell that start at each row of a picture."""
        length, width = self.cell
        sums = picture.reshape(len(picture), -1, width).sum(axis=2, dtype=np.float64).T
        until = np.cumsum(sums, axis=1)
        until[:, length:] -= until[:, :-length].copy()
        return until[:, length - 1 :]

    def _locate(self, axes: RoadFrame, along: Array, across: Array) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Pixels (along, across, 2) of places on the road, and which of them show it."""
        ahead = axes.along[:, None] * along
        aside = axes.left[:, None] * across - self.height * axes.up[:, None]
        # Single precision moves a place by less than a thousandth of a pixel.
        points: NDArray[Any] = ahead.astype(np.float32)[:, :, None] + aside.astype(np.float32)[:, None]
        pixels, inside = self.camera.project(np.moveaxis(points, 0, -1))
        table = pixels.astype(np.float32)
        return table, inside & (cv2.remap(self._shows, table[..., 0], table[..., 1], cv2.INTER_NEAREST) > 0)


def find_peak(scores: Array, low: int, high: int) -> float | None:
    """Place of the highest of the scores (n,) between two indices, by a parabola; None where it is no peak."""
    low, high = max(low, 1), min(high, len(scores) - 2)
    if high < low:
        return None
    peak = low + int(np.argmax(scores[low : high + 1]))
    left, middle, right = scores[peak - 1 : peak + 2]
    curvature = left - 2.0 * middle + right
    if not (left <= middle >= right and curvature < 0.0):
        return None
    return peak + 0.5 * float((left - right) / curvature)


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)
