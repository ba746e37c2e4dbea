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
