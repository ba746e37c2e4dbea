"""How much brighter one front frame is than another, by what both show.

Cameras adapt to the light, so a surface taken from another frame may not match its surroundings.
"""

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


def relative_brightness(front: FrontView, index: int, other: int) -> float:
    """Factor that takes the grey levels of frame `other` to those of frame `index`; 1 where they share too little.

    The median over what the frames share, so that hidden surfaces and moving objects do not count.
    """
    here, there = (_block_means(front.frames[frame]) for frame in (index, other))
    offset = _BLOCK // 2
    rows, columns = there.shape
    rays = pixel_rays(front.camera)[offset::_BLOCK, offset::_BLOCK][:rows, :columns].reshape(-1, 3)
    distance = front.distance[other, offset::_BLOCK, offset::_BLOCK][:rows, :columns].ravel()
    usable = np.isfinite(distance) & (there.ravel() > _DARKEST) & (there.ravel() < _BRIGHTEST)
    T_index_other = invert(front.camera_poses[index]) @ front.camera_poses[other]
    points = rays[usable] * distance[usable, None] @ T_index_other[:3, :3].T + T_index_other[:3, 3]
    pixels, inside = front.camera.project(points)
    column, row = (pixels[inside] / _BLOCK).astype(np.int64).T
    seen = here[row.clip(0, rows - 1), column.clip(0, columns - 1)]
    shared = (seen > _DARKEST) & (seen < _BRIGHTEST)
    if shared.sum() < _LEAST_BLOCKS:
        return 1.0
    return float(np.median(seen[shared] / there.ravel()[usable][inside][shared]))


def brightened(image: NDArray[np.uint8], factor: float) -> NDArray[np.uint8]:
    """The image with its grey levels multiplied, saturated at 255."""
    table = np.clip(np.rint(factor * np.arange(256)), 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(image, table), np.uint8)


def _block_means(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Mean grey level (h, w) of whole blocks of an image (H, W, 3)."""
    height, width = (side // _BLOCK * _BLOCK for side in image.shape[:2])
    grey = cv2.cvtColor(image[:height, :width], cv2.COLOR_RGB2GRAY)
    size = (width // _BLOCK, height // _BLOCK)
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
