"""Corners and their tracks through a video."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

Gray = NDArray[np.uint8]
Pixels = NDArray[np.float32]

CELL_PIXELS = 32
CORNERS_PER_CELL = 4
BORDER_PIXELS = 8
CORNER_WINDOW = 5
MIN_CORNER_STRENGTH = 1e-5
TRACK_WINDOW = (15, 15)
PYRAMID_LEVELS = 4
TRACK_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
MAX_RETURN_PIXELS = 0.5


@dataclass(frozen=True)
class TrackedPair:
    """Points (n, 2) of frame `key` and where the same points are in frame `current`, in pixels."""

    key: int
    current: int
    key_pixels: Pixels
    current_pixels: Pixels

    @property
    def flow(self) -> NDArray[np.float64]:
        """Length (n,) of each point's motion in pixels."""
        return np.linalg.norm(self.current_pixels.astype(np.float64) - self.key_pixels, axis=1)


def detect_corners(gray: Gray) -> Pixels:
    """The strongest Shi-Tomasi corners of every grid cell, (n, 2) pixels.

    A few corners a cell, however weak beside the strongest of the image, keep the road and the distance in play.
    """
    strength = cv2.cornerMinEigenVal(gray, CORNER_WINDOW)
    is_peak = (strength == cv2.dilate(strength, np.ones((7, 7), np.uint8))) & (strength > MIN_CORNER_STRENGTH)
    inner = np.zeros_like(is_peak)
    inner[BORDER_PIXELS:-BORDER_PIXELS, BORDER_PIXELS:-BORDER_PIXELS] = True
    rows, columns = np.nonzero(is_peak & inner)
    cells = (rows // CELL_PIXELS) * gray.shape[1] + columns // CELL_PIXELS
    order = np.lexsort((-strength[rows, columns], cells))
    rank_in_cell = np.arange(len(order)) - np.searchsorted(cells[order], cells[order])
    kept = order[rank_in_cell < CORNERS_PER_CELL]
    return np.stack([columns[kept], rows[kept]], axis=-1).astype(np.float32)


def track_corners(previous: Gray, current: Gray, pixels: Pixels) -> tuple[Pixels, NDArray[np.bool_]]:
    """Follow points (n, 2) from one frame to the next with pyramidal Lucas-Kanade.

    Returns:
        Points (n, 2) in the current frame, and which of them lead back to where they came from.
    """
    if len(pixels) == 0:
        return pixels, np.zeros(0, dtype=np.bool_)
    forward, found = _follow(previous, current, pixels)
    backward, found_back = _follow(current, previous, forward)
    returned = np.linalg.norm(backward - pixels, axis=1) < MAX_RETURN_PIXELS
    return forward, found & found_back & returned


def track_from_keyframes(grays: Sequence[Gray], keyframes: Sequence[int]) -> Iterator[TrackedPair]:
    """Yield, for every frame after the first, the points it shares with the latest earlier keyframe."""
    for key, next_key in pairwise(keyframes):
        key_pixels = pixels = detect_corners(grays[key])
        for current in range(key + 1, next_key + 1):
            pixels, found = track_corners(grays[current - 1], grays[current], pixels)
            key_pixels, pixels = key_pixels[found], pixels[found]
            yield TrackedPair(key, current, key_pixels, pixels)


def _follow(previous: Gray, current: Gray, pixels: Pixels) -> tuple[Pixels, NDArray[np.bool_]]:
    guess = np.empty_like(pixels)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        previous, current, pixels, guess, winSize=TRACK_WINDOW, maxLevel=PYRAMID_LEVELS, criteria=TRACK_STOP
    )
    return np.asarray(moved, dtype=np.float32), found[:, 0] > 0
