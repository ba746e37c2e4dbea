"""Filling of pixels that no camera has seen, by a classical method: smooth colours from what surrounds them.

What is filled is invented and must be reported as such; nothing here adds detail.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

MID_GREY = 128


def fill_holes(image: NDArray[np.uint8], visible: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Fill the pixels (H, W) that are not `visible` in `image` (H, W, 3); visible pixels keep their bytes.

    An image without visible pixels comes back mid-grey.
    """
    if not visible.any():
        return np.full_like(image, MID_GREY)
    filled = np.clip(np.rint(interpolate(image, visible)), 0, 255).astype(np.uint8)
    return np.where(visible[..., None], image, filled)


def interpolate(values: NDArray[np.generic], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Smooth values (H, W, channels up to 3) that equal `values` where they are `known` (H, W), at least one pixel.

    Values are averaged over ever coarser levels of an image pyramid until every hole is covered, and blended back
    down (Gortler et al., The Lumigraph, 1996, pull-push).
    """
    weight = known[..., None]
    return _pull_push(np.concatenate([np.where(weight, values, 0), weight], axis=-1, dtype=np.float32))


def _pull_push(weighted: NDArray[np.float32]) -> NDArray[np.float32]:
    """Values (h, w, channels) of a pyramid level that is given as values times weight, and weight as last channel."""
    height, width = weighted.shape[:2]
    if max(height, width) == 1:
        return weighted[..., :-1] / weighted[..., -1:]
    coarser = cv2.pyrDown(weighted)
    # A pixel counts as known once a quarter of it is, so that holes are closed from as near as possible.
    weight = coarser[..., -1:]
    coarser = np.asarray(coarser * (np.minimum(4.0 * weight, 1.0) / np.maximum(weight, 1e-12)), np.float32)
    enlarged = cv2.pyrUp(_pull_push(coarser), dstsize=(width, height))
    background = np.asarray(enlarged, np.float32).reshape(height, width, -1)
    background *= 1.0 - weighted[..., -1:]
    return weighted[..., :-1] + background
