"""How much brighter one front frame is than another, by what both show.

Cameras adapt to the light, so a surface taken from another frame may not match its surroundings.
"""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import pixel_rays
from olt_generator.poses import invert
from olt_generator.views.front_view import FrontView

# Pixels are compared as means over blocks of so many along rows and columns.
_BLOCK = 8
# Grey levels between which a pixel tells of the light: neither black nor saturated.
_DARKEST, _BRIGHTEST = 16.0, 239.0
_LEAST_BLOCKS = 50
# Frames whose means are kept for the next comparison.
_KEPT = 64


class Brightness:
    """Compares the frames of a front view."""

    def __init__(self, front: FrontView) -> None:
        self._front = front
        self._means = lru_cache(_KEPT)(lambda index: _block_means(front.frames[index]))
        offset = _BLOCK // 2
        self._rays = pixel_rays(front.camera)[offset::_BLOCK, offset::_BLOCK]

    def ratio(self, index: int, other: int) -> float:
        """Factor that takes the grey levels of frame `other` to those of frame `index`; 1 where they share too little.

        The median over what the frames share, so that hidden surfaces and moving objects do not count.
        """
        front, here, there = self._front, self._means(index), self._means(other)
        rows, columns = there.shape
        offset = _BLOCK // 2
        distance = front.distance[other, offset::_BLOCK, offset::_BLOCK][:rows, :columns]
        usable = np.isfinite(distance) & (there > _DARKEST) & (there < _BRIGHTEST)
        T_index_other = invert(front.camera_poses[index]) @ front.camera_poses[other]
        rays = self._rays[:rows, :columns][usable]
        pixels, inside = front.camera.project(
            rays * distance[usable, None] @ T_index_other[:3, :3].T + T_index_other[:3, 3]
        )
        column, row = (pixels[inside] / _BLOCK).astype(np.int64).T
        seen = here[row.clip(0, rows - 1), column.clip(0, columns - 1)]
        shared = (seen > _DARKEST) & (seen < _BRIGHTEST)
        if shared.sum() < _LEAST_BLOCKS:
            return 1.0
        return float(np.median(seen[shared] / there[usable][inside][shared]))


def _block_means(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Mean grey level (h, w) of whole blocks of an image (H, W, 3)."""
    height, width = (side // _BLOCK * _BLOCK for side in image.shape[:2])
    grey = cv2.cvtColor(image[:height, :width], cv2.COLOR_RGB2GRAY)
    size = (width // _BLOCK, height // _BLOCK)
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
