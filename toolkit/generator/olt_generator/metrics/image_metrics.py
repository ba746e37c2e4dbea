"""How close an image is to the true one: PSNR and SSIM of 8-bit images."""

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError

_WINDOW = 11
_WINDOW_SIGMA = 1.5


def psnr(a: NDArray[np.uint8], b: NDArray[np.uint8], mask: NDArray[np.bool_] | None = None) -> float:
    """Peak signal-to-noise ratio in dB of images (..., H, W, 3), inf where they are equal.

    Args:
        a: images.
        b: images of the same shape.
        mask: (..., H, W) pixels to count; all of them by default.

    Raises:
        InputError: the shapes differ or no pixel is left to count.
    """
    _check_shapes(a, b)
    difference = a.astype(np.float64) - b
    if mask is not None:
        difference = difference[mask]
    if difference.size == 0:
        raise InputError("PSNR: the mask leaves no pixel to compare")
    mean_square = float(np.mean(difference**2))
    return float("inf") if mean_square == 0.0 else float(10.0 * np.log10(255.0**2 / mean_square))


def ssim(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Structural similarity of two images (H, W, 3), mean over pixels and channels, 1 where they are equal.

    Wang et al. 2004: Gaussian window of 11 pixels and sigma 1.5, population moments, K1 = 0.01, K2 = 0.03; only
    windows that lie whole in the image count.

    Raises:
        InputError: the shapes differ or an image is smaller than the window.
    """
    _check_shapes(a, b)
    if min(a.shape[:2]) < _WINDOW:
        raise InputError(f"SSIM: images of {a.shape[1]} x {a.shape[0]} are smaller than the window of {_WINDOW} pixels")
    x, y = a.astype(np.float64), b.astype(np.float64)
    mean_x, mean_y = _window_mean(x), _window_mean(y)
    variance_x = _window_mean(x * x) - mean_x**2
    variance_y = _window_mean(y * y) - mean_y**2
    covariance = _window_mean(x * y) - mean_x * mean_y
    c1, c2 = (0.01 * 255.0) ** 2, (0.03 * 255.0) ** 2
    luminance = (2.0 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    structure = (2.0 * covariance + c2) / (variance_x + variance_y + c2)
    return float(np.mean(luminance * structure))


def _window_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    margin = _WINDOW // 2
    means = np.asarray(cv2.GaussianBlur(values, (_WINDOW, _WINDOW), _WINDOW_SIGMA), np.float64)
    return means[margin:-margin, margin:-margin]


def _check_shapes(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> None:
    if a.shape != b.shape:
        raise InputError(f"images of shapes {a.shape} and {b.shape} cannot be compared; give both at one size")
