"""On which side of the picture the sky is: a vote over frames by day, without a model."""

from collections import Counter
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

Side = Literal["top", "right", "bottom", "left"]
SIDES: tuple[Side, ...] = ("top", "right", "bottom", "left")

_FRAMES = 15
# Pictures of this many cells along the longer side; the sky is told in the outer quarter of each side.
_CELLS, _BORDER = 64, 0.25
# A cell is like sky if it is bright, for the picture and as such, and has less contrast, inside and around, than this.
_BRIGHTER_THAN, _LEAST_BRIGHTNESS, _MOST_CONTRAST = 0.6, 90.0, 6.0
# A side is the sky's if so much of it is like sky, and so much more than of the side across from it.
_SKY_SHARE, _MORE_THAN_ACROSS = 0.4, 0.3
# Of the frames so many say the same, and hardly any something else.
_AGREEMENT, _DISSENT = 0.5, 0.1


def find_sky_side(frames: NDArray[np.uint8]) -> Side | None:
    """The side of the sky in frames (n, H, W, 3) RGB, if half of them tell it and hardly any tells another one.

    None at night, and where the scene fills the picture.
    """
    chosen = np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))
    votes: Counter[Side] = Counter(side for index in chosen if (side := _sky_side(frames[index])) is not None)
    if not votes:
        return None
    side, count = votes.most_common(1)[0]
    is_clear = count >= _AGREEMENT * len(chosen) and votes.total() - count <= _DISSENT * len(chosen)
    return side if is_clear else None


def _sky_side(frame: NDArray[np.uint8]) -> Side | None:
    height, width = frame.shape[:2]
    scale = _CELLS / max(height, width)
    size = max(4, round(width * scale)), max(4, round(height * scale))
    grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
    # Contrast within cells counts as well as that between them.
    mean = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    square = cv2.resize(cv2.multiply(grey, grey, dtype=cv2.CV_32F), size, interpolation=cv2.INTER_AREA)
    inside = np.sqrt(np.maximum(square - mean**2, 0.0))
    around = cv2.morphologyEx(mean, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    bright = mean > max(_LEAST_BRIGHTNESS, float(np.quantile(mean, _BRIGHTER_THAN)) - 1.0)
    like_sky = bright & (inside < _MOST_CONTRAST) & (around < 2.0 * _MOST_CONTRAST)
    rows, columns = (max(1, round(_BORDER * side)) for side in like_sky.shape)
    borders = like_sky[:rows], like_sky[:, -columns:], like_sky[-rows:], like_sky[:, :columns]
    shares = np.array([border.mean() for border in borders])
    best = int(np.argmax(shares))
    is_clear = shares[best] >= _SKY_SHARE and shares[best] - shares[(best + 2) % 4] >= _MORE_THAN_ACROSS
    return SIDES[best] if is_clear else None
