"""Corners and their tracks through a video."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

Gray = NDArray[np.uint8]
Pixels = NDArray[np.float32]

NO_PIXELS: Pixels = np.zeros((0, 2), np.float32)

CELL_PIXELS = 32
BORDER_PIXELS = 8
SPACING_PIXELS = 6
CORNER_WINDOW = 5
MIN_CORNER_STRENGTH = 1e-5
# OpenCV works on eight pixels of a row at a time and on what is left one by one: 15 take longer than 17.
TRACK_WINDOW = (17, 17)
PYRAMID_LEVELS = 4
TRACK_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
MAX_RETURN_PIXELS = 0.5


@dataclass(frozen=True)
class TrackedPair:
    """Points in frame `key` and where the same points are in frame `current`.

    Attributes:
        key, current: indices of the frames.
        points: (n,) identity of each point, the same throughout the video.
        key_pixels, current_pixels: (n, 2) pixels.
    """

    key: int
    current: int
    points: NDArray[np.int64]
    key_pixels: Pixels
    current_pixels: Pixels


def detect_corners(
    gray: Gray, per_cell: int, hidden: NDArray[np.bool_] | None = None, present: Pixels = NO_PIXELS
) -> Pixels:
    """The strongest Shi-Tomasi corners of every grid cell, (n, 2) pixels.

    A few corners a cell, however weak beside the strongest of the image, keep the road and the distance in play.

    Args:
        gray: (H, W) image.
        per_cell: how many points a cell holds at most.
        hidden: (H, W) pixels where no point is wanted.
        present: (k, 2) points that are there already: they count in their cells, and none is found next to them.
    """
    strength = cv2.cornerMinEigenVal(gray, CORNER_WINDOW)
    is_peak = (strength == cv2.dilate(strength, np.ones((7, 7), np.uint8))) & (strength > MIN_CORNER_STRENGTH)
    allowed = np.zeros(gray.shape, np.uint8)
    allowed[BORDER_PIXELS:-BORDER_PIXELS, BORDER_PIXELS:-BORDER_PIXELS] = 1
    if hidden is not None:
        allowed[hidden] = 0
    for row, column in np.transpose(_nearest_pixels(present)).tolist():
        cv2.circle(allowed, (column, row), SPACING_PIXELS, 0, cv2.FILLED)
    taken = np.sort(_cells(*_nearest_pixels(present), gray.shape[1]))
    rows, columns = np.nonzero(is_peak & (allowed > 0))
    cells = _cells(rows, columns, gray.shape[1])
    order = np.lexsort((-strength[rows, columns], cells))
    rank_in_cell = np.arange(len(order)) - np.searchsorted(cells[order], cells[order])
    present_in_cell = np.searchsorted(taken, cells[order], "right") - np.searchsorted(taken, cells[order], "left")
    kept = order[rank_in_cell + present_in_cell < per_cell]
    return np.stack([columns[kept], rows[kept]], axis=-1).astype(np.float32)


def track_corners(previous: Gray, current: Gray, pixels: Pixels) -> tuple[Pixels, NDArray[np.bool_]]:
    """Follow points (n, 2) from one frame to the next with pyramidal Lucas-Kanade.

    Returns:
        Points (n, 2) in the current frame, and which of them lie in it and lead back to where they came from.
    """
    forward, found = _follow(previous, current, pixels)
    found &= ((forward >= 0) & (forward <= np.array(current.shape[::-1]) - 1)).all(axis=1)
    backward, found_back = _follow(current, previous, forward[found])
    found[found] = found_back & (np.linalg.norm(backward - pixels[found], axis=1) < MAX_RETURN_PIXELS)
    return forward, found


def track_from_keyframes(
    grays: Sequence[Gray], keyframes: Sequence[int], hidden: NDArray[np.bool_], per_cell: int, window: int
) -> Iterator[TrackedPair]:
    """Yield, for every frame after the first, the points it shares with the latest earlier keyframe.

    Points live on from keyframe to keyframe while they can be followed, and new ones take the place of those lost.

    Args:
        grays, keyframes: the video, and indices of its frames, the first and the last among them.
        hidden: (H, W) pixels that move with the camera (`static_mask`); points that get there are dropped.
        per_cell: points that are followed in every cell of the image.
        window: keyframes over which a point is followed at most, because errors of following add up.
    """
    points, pixels, ages = np.zeros(0, np.int64), NO_PIXELS, np.zeros(0, np.int64)
    found_so_far = 0
    for key, next_key in pairwise(keyframes):
        kept = (ages < window) & ~hidden[_nearest_pixels(pixels)]
        new = detect_corners(grays[key], per_cell, hidden, pixels[kept])
        points = np.concatenate([points[kept], found_so_far + np.arange(len(new))])
        pixels = np.concatenate([pixels[kept], new])
        ages = np.concatenate([ages[kept] + 1, np.ones(len(new), np.int64)])
        found_so_far += len(new)
        key_pixels = pixels
        for current in range(key + 1, next_key + 1):
            pixels, found = track_corners(grays[current - 1], grays[current], pixels)
            points, ages, key_pixels, pixels = points[found], ages[found], key_pixels[found], pixels[found]
            yield TrackedPair(key, current, points, key_pixels, pixels)


def _nearest_pixels(pixels: Pixels) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns (n,)."""
    column, row = np.rint(pixels).astype(np.int64).T
    return row, column


def _cells(rows: NDArray[np.int64], columns: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    return (rows // CELL_PIXELS) * width + columns // CELL_PIXELS


def _follow(previous: Gray, current: Gray, pixels: Pixels) -> tuple[Pixels, NDArray[np.bool_]]:
    if len(pixels) == 0:
        return pixels, np.zeros(0, dtype=np.bool_)
    guess = np.empty_like(pixels)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        previous, current, pixels, guess, winSize=TRACK_WINDOW, maxLevel=PYRAMID_LEVELS, criteria=TRACK_STOP
    )
    return np.asarray(moved, dtype=np.float32), found[:, 0] > 0
