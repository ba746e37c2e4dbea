"""Distances made coherent: what is not trusted takes the distance of what surrounds it, up to the edges in the picture.

A thing that moves has no parallax that could be trusted, and its parts get distances that have nothing to do with one
another; warped by them, a lorry is torn to shreds. Its place may be wrong either way, its look need not be.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

# Columns at which the picture is smoothed: as fine as distances by parallax are.
_COLUMNS = 208
# How far distances spread, and the difference in colour that stops them (Min et al., Fast Global Image Smoothing Based
# on Weighted Least Squares, 2014).
_SPREAD, _EDGE = 100.0, 8.0
# Trust from which on a distance stays what it is, and the weight of those that are not trusted at all.
_TRUSTED, _LEAST_WEIGHT = 0.4, 0.05


def make_coherent(
    image: NDArray[np.uint8], distance: NDArray[np.float32], trust: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Distance (H, W) in which what has little `trust` (H, W), 0 to 1, is a mean over its surroundings.

    Given are the picture (H, W, 3) and finite distances (H, W), NaN for what is not known, which stays so.
    """
    height, width = distance.shape
    size = (min(width, _COLUMNS), max(1, round(height * min(width, _COLUMNS) / width)))
    known = ~np.isnan(distance)
    weight = np.where(known, _LEAST_WEIGHT + (1.0 - _LEAST_WEIGHT) * trust, 0.0).astype(np.float32)
    log = np.log(np.where(known, distance, np.float32(1.0)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    log, weight = (cv2.resize(values, size, interpolation=cv2.INTER_NEAREST) for values in (log, weight))
    # One thread: how several share the rows shows in the last bits of the smoother.
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        smoother = cv2.ximgproc.createFastGlobalSmootherFilter(small, _SPREAD, _EDGE)
        mean = smoother.filter(weight * log) / np.maximum(smoother.filter(weight), np.float32(1e-6))
    finally:
        cv2.setNumThreads(threads)
    smooth = cv2.resize(np.exp(mean), (width, height), interpolation=cv2.INTER_NEAREST)
    return np.where(known & (trust < _TRUSTED), smooth, distance)
