"""Fingerprints of clips: what the front images look like, in few bytes, for the search of near-duplicates.

A fingerprint holds up to 16 images of a window, each as a thumbnail of 20 x 10 signs: whether a place is brighter than
its surroundings. Signs of local contrast stay through another size, coding, brightness, gamma or lack of colour; a crop
or a turn moves them by a cell or two, a mirrored image mirrors them, and the comparison (`olt_datasets.tables`) allows
for both. Black bars at the sides are no part of an image. An image with next to no contrast (fog, a plain wall, black)
tells nothing and is left out, so that the fingerprint of a window of such images is empty. An image with contrast in
some parts alone, such as a cone of light on a road by night, is marked as dim: drives by night are alike in these.

Format: 30 bytes an image, in order of time: the moment in milliseconds since the window's first image (big-endian, 4
bytes), 1 where it is dim and else 0, and 200 bits, row by row from the upper left, the first in the highest bit; 480
bytes for 16 images.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

IMAGES = 16
"""Most images of a fingerprint."""
COLUMNS, ROWS = 20, 10
RECORD = np.dtype([("time_ms", ">u4"), ("dim", np.uint8), ("signs", np.uint8, COLUMNS * ROWS // 8)])
"""One image of a fingerprint."""

_OVERSAMPLING = 4
# Surroundings reach as far as a third of the image's height.
_SURROUNDINGS_CELLS = 1.5
_LEAST_CONTRAST = 2.5
"""Grey levels, root mean square: below it an image tells nothing."""
_SOME_CONTRAST, _LIT_SHARE = 1.0, 0.75
"""Grey levels, and the share of cells that have as much contrast in an image that is not dim."""
_DARK = 32
"""Grey levels: a bar at the side of an image is darker, at 98 of 100 of its pixels in all images."""
_WIDEST_BAR = 0.36
_WIDEST_LONE_BAR = 0.12
_BAR_DIFFERENCE = 0.03


def fingerprint_times(first_us: int, last_us: int) -> NDArray[np.int64]:
    """The moments (16,) of a window whose images a fingerprint would like: the middles of equal parts.

    Fewer images, at other moments, make a fingerprint too, which finds less: images should be at most as far apart as
    the vehicle needs for some ten metres.
    """
    middles = 2 * np.arange(IMAGES, dtype=np.int64) + 1
    return first_us + middles * (last_us - first_us) // (2 * IMAGES)


def fingerprint_images(frames: NDArray[np.uint8], times_us: NDArray[np.int64]) -> bytes:
    """What the images (k, H, W, 3) RGB of a window look like, at ascending times (k,) from any origin.

    Of more than 16 images, 16 evenly chosen ones are taken. Empty where no image has contrast.
    """
    if len(frames) > IMAGES:
        chosen = (2 * np.arange(IMAGES) + 1) * len(frames) // (2 * IMAGES)
        frames, times_us = frames[chosen], times_us[chosen]
    grey = _without_bars(np.stack([cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames]))
    contrasts = [_local_contrast(image) for image in grey]
    records = np.zeros(len(frames), RECORD)
    records["time_ms"] = (times_us - times_us[0]) // 1000
    records["signs"] = [np.packbits(contrast >= 0.0) for contrast in contrasts]
    records["dim"] = [np.mean(np.abs(contrast) > _SOME_CONTRAST) < _LIT_SHARE for contrast in contrasts]
    telling = [float(np.sqrt(np.mean(contrast**2))) >= _LEAST_CONTRAST for contrast in contrasts]
    return records[telling].tobytes()


def unpack_signs(signs: NDArray[np.uint8]) -> NDArray[np.float32]:
    """-1 or 1 (..., 200) of the bits of images (..., 25)."""
    return 2.0 * np.unpackbits(signs, axis=-1).astype(np.float32) - 1.0


def _local_contrast(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """How much brighter the cells (ROWS, COLUMNS) of an image (H, W) are than their surroundings, in grey levels."""
    size = (_OVERSAMPLING * COLUMNS, _OVERSAMPLING * ROWS)
    fine = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    sigma = _OVERSAMPLING * _SURROUNDINGS_CELLS
    surroundings = cv2.GaussianBlur(fine, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    difference = fine - surroundings
    # Bounded by the spread around, so that a lamp does not decide over its cell alone.
    spread = cv2.GaussianBlur(difference**2, (0, 0), 2.0 * sigma, borderType=cv2.BORDER_REFLECT)
    bound = 2.5 * (np.sqrt(spread) + 4.0)
    cells = cv2.resize(np.clip(difference, -bound, bound), (COLUMNS, ROWS), interpolation=cv2.INTER_AREA)
    return cells.astype(np.float32)


def _without_bars(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Images (k, H, W) without the black bars that all of them have at two opposite sides, or narrow ones at one."""
    brightest = grey.max(axis=0)
    return grey[:, _between_bars(brightest), _between_bars(brightest.T)]


def _between_bars(brightest: NDArray[np.uint8]) -> slice:
    """Which rows of an image (H, W) are between bars above and below it."""
    shown = np.flatnonzero(np.percentile(brightest, 98, axis=1) >= _DARK)
    count = len(brightest)
    if not len(shown):
        return slice(0, count)
    above, below = int(shown[0]), count - 1 - int(shown[-1])
    if abs(above - below) <= _BAR_DIFFERENCE * count and above <= _WIDEST_BAR * count:
        return slice(above, count - below)
    widest = _WIDEST_LONE_BAR * count
    return slice(above if above <= widest else 0, count - (below if below <= widest else 0))
