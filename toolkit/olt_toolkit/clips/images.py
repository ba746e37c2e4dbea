"""Whole sequences of images scaled, and cropped as `olt_generator.cameras.fit_camera` does with their camera."""

import cv2
import numpy as np
from numpy.typing import NDArray


def fit_images(frames: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Scale images (n, H, W, 3) by one factor until they cover (width, height), then crop about the centre."""
    factor = max(width / frames.shape[2], height / frames.shape[1])
    size = (round(frames.shape[2] * factor), round(frames.shape[1] * factor))
    left, top = (size[0] - width) // 2, (size[1] - height) // 2
    # Area averaging does not alias when it shrinks; it has nothing to average when it enlarges.
    interpolation = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_CUBIC
    fitted = np.empty((len(frames), height, width, 3), np.uint8)
    for frame, target in zip(frames, fitted, strict=True):
        target[:] = cv2.resize(frame, size, interpolation=interpolation)[top : top + height, left : left + width]
    return fitted


def resize_images(frames: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Scale images (n, H, W, 3) to exactly (width, height); each new pixel is the mean of the area that it covers."""
    if frames.shape[1:3] == (height, width):
        return frames
    return np.stack([cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA) for frame in frames])


def resize_masks(masks: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Scale masks (n, H, W) to (width, height); each new pixel takes the value of the one nearest to its centre."""
    if masks.shape[1:] == (height, width):
        return masks
    return np.stack([cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST_EXACT) for mask in masks])


def largest_rectangle(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Rows and columns of the largest upright rectangle inside a mask (H, W); empty where there is none."""
    best, found = 0, (slice(0, 0), slice(0, 0))
    heights = np.zeros(mask.shape[1] + 1, int)  # of set pixels above each column, and a lowest one at the end
    for row, line in enumerate(mask):
        heights[:-1] = (heights[:-1] + 1) * line
        open_bars: list[tuple[int, int]] = []  # first column and height, heights increasing
        for column, height in enumerate(heights.tolist()):
            first = column
            while open_bars and open_bars[-1][1] >= height:
                first, tall = open_bars.pop()
                if tall * (column - first) > best:
                    best = tall * (column - first)
                    found = slice(row + 1 - tall, row + 1), slice(first, column)
            open_bars.append((first, height))
    return found
