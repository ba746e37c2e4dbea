"""Filling of pixels that no camera has seen, by a classical method: smooth colours from what surrounds them.

What is filled is invented and must be reported as such; nothing here adds detail.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

MID_GREY = 128

# Halvings of the image over which holes are closed from their edges; what lies deeper than some 2^2 pixels is
# background. More lets the colours of a house run into the sky beside it.
EDGE_LEVELS = 2


def fill_holes(
    image: NDArray[np.uint8], visible: NDArray[np.bool_], background: NDArray[np.float32] | None = None
) -> NDArray[np.uint8]:
    """Fill the pixels (H, W) that are not `visible` in `image` (H, W, 3); visible pixels keep their bytes.

    Cracks close from their edges. Deep inside, holes take the colours of `background` (H, W, 3); without one, those of
    their far surroundings, and an image without visible pixels comes back mid-grey.
    """
    if background is None and not visible.any():
        return np.full_like(image, MID_GREY)
    filled, hole = image.copy(), ~visible
    levels = 64 if background is None else EDGE_LEVELS
    filled[hole] = np.clip(np.rint(_behind(_weighted(image, visible), background, levels)[hole]), 0, 255)
    return filled


def interpolate(values: NDArray[np.generic], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Smooth values (H, W, channels up to 3) that equal `values` where they are `known` (H, W), at least one pixel.

    Values are averaged over ever coarser levels of an image pyramid until every hole is covered, and blended back
    down (Gortler et al., The Lumigraph, 1996, pull-push).
    """
    return _pull_push(_weighted(values, known))


def _weighted(values: NDArray[np.generic], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Values (H, W, channels) times weight, and the weight as last channel."""
    weighted = np.empty((*known.shape, values.shape[-1] + 1), np.float32)
    weighted[..., :-1], weighted[..., -1] = values, 1.0
    weighted[~known] = 0.0
    return weighted


def _pull_push(
    weighted: NDArray[np.float32], background: NDArray[np.float32] | None = None, levels: int = 64
) -> NDArray[np.float32]:
    """Values (h, w, channels) of a pyramid level that is given as values times weight, and weight as last channel.

    After `levels` halvings the rest is `background` (h, w, channels); without one the pyramid must end at one pixel.
    """
    height, width = weighted.shape[:2]
    if background is not None and (levels == 0 or max(height, width) == 1):
        return np.asarray(weighted[..., :-1] + background * (1.0 - weighted[..., -1:]), np.float32)
    if max(height, width) == 1:
        return weighted[..., :-1] / weighted[..., -1:]
    behind = _behind(weighted, background, levels)
    behind *= 1.0 - weighted[..., -1:]
    return weighted[..., :-1] + behind


def _behind(weighted: NDArray[np.float32], background: NDArray[np.float32] | None, levels: int) -> NDArray[np.float32]:
    """Values (h, w, channels) of the next coarser level, enlarged: what shows where nothing is known on this one."""
    height, width = weighted.shape[:2]
    coarser = cv2.pyrDown(weighted)
    # A pixel counts as known once a quarter of it is, so that holes are closed from as near as possible.
    weight = coarser[..., -1:]
    coarser = np.asarray(coarser * (np.minimum(4.0 * weight, 1.0) / np.maximum(weight, 1e-12)), np.float32)
    coarser_background = None if background is None else np.asarray(cv2.pyrDown(background), np.float32)
    enlarged = cv2.pyrUp(_pull_push(coarser, coarser_background, levels - 1), dstsize=(width, height))
    return np.asarray(enlarged, np.float32).reshape(height, width, -1)
