"""Whether the images of a camera follow each other: none repeated, none out of its place.

An image resembles the ones before and after it more than those farther away while the camera moves. Whether time runs
forward or backward cannot be told so (`image_evidence`).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.verification.image_steps import CameraImages

# Images are compared with so many columns: the finer they are, the sooner all differ alike, near or far in time.
WIDTH = 32
# Images at most so many places apart are compared.
REACH = 6
# A vehicle that moves so far from one image to the next, metres, shows another picture.
LEAST_WAY = 0.25
# A repeated image differs from the one before by less than this share of what images usually do.
REPEATED_SHARE = 0.08
# Two images have changed places if they lie so much nearer to the images beyond the other than to their own.
CHANGED_SHARE = 0.85


@dataclass(frozen=True)
class FrameOrder:
    """How images follow each other.

    Attributes:
        moving: (m,) images from which the vehicle moves on to the next.
        repeated: (m,) moving images which the next one repeats.
        exchanged: (m,) moving images that would fit better behind the next one.
        nearest: share of the moving images whose most similar neighbour is the one before or after it, among `REACH`
            on either side; NaN where none moves.
        difference: how much neighbours differ, grey levels: exceeded by one in ten of those that move, so that it is
            that of others where most are repeated; NaN where none moves.
        contrast: standard deviation of the images, grey levels, median.
    """

    moving: NDArray[np.bool_]
    repeated: NDArray[np.bool_]
    exchanged: NDArray[np.bool_]
    nearest: float
    difference: float
    contrast: float


def find_order(images: CameraImages, ego_motion: EgoMotion) -> FrameOrder:
    """Compare each image with those around it."""
    count = len(images.grays)
    apart = _differences(images.grays)
    low, high = ego_motion.span_us
    positions = ego_motion.interpolate(np.clip(images.times_us, low, high))[:, :3, 3]
    way = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    moving = np.append(way >= LEAST_WAY, False)
    contrast = float(np.median(images.grays[:: max(1, count // 8)].std(axis=(1, 2))))
    if not moving.any():
        return FrameOrder(moving, np.zeros(count, bool), np.zeros(count, bool), float("nan"), float("nan"), contrast)
    difference = float(np.percentile(apart[moving, 0], 90.0))
    repeated = moving & (apart[:, 0] < REPEATED_SHARE * difference)
    return FrameOrder(moving, repeated, moving & _exchanged(apart), _nearest_share(apart, moving), difference, contrast)


def _differences(grays: NDArray[np.uint8]) -> Array:
    """Mean absolute difference (m, REACH) of each image to the next ones; infinite where there is none."""
    height = max(8, round(grays.shape[1] * WIDTH / grays.shape[2]))
    small = np.stack([cv2.resize(gray, (WIDTH, height), interpolation=cv2.INTER_AREA) for gray in grays])
    small = small.astype(np.float32)
    apart = np.full((len(small), REACH), np.inf)
    for lag in range(1, min(REACH, len(small) - 1) + 1):
        apart[:-lag, lag - 1] = np.abs(small[lag:] - small[:-lag]).mean(axis=(1, 2))
    return apart


def _exchanged(apart: Array) -> NDArray[np.bool_]:
    """Images i that fit better behind image i + 1: (i-1, i+1, i, i+2) is smoother than (i-1, i, i+1, i+2)."""
    found = np.zeros(len(apart), bool)
    own = apart[:-3, 0], apart[2:-1, 0]
    other = apart[:-3, 1], apart[1:-2, 1]
    found[1:-2] = (other[0] < CHANGED_SHARE * own[0]) & (other[1] < CHANGED_SHARE * own[1])
    # Where images in a row seem to, a row of like things passes, such as posts, at two images a post.
    alone = ~np.append(found[1:], False) & ~np.append(False, found[:-1])
    return found & alone


def _nearest_share(apart: Array, moving: NDArray[np.bool_]) -> float:
    """Share of the moving images whose nearest neighbour in appearance is their neighbour in time."""
    count = len(apart)
    before = np.full_like(apart, np.inf)
    for lag in range(1, min(REACH, count - 1) + 1):
        before[lag:, lag - 1] = apart[:-lag, lag - 1]
    # Only where both sides are whole, so that chance gives the same share everywhere.
    inner = moving & np.isfinite(apart).all(axis=1) & np.isfinite(before).all(axis=1)
    if not inner.any():
        return float("nan")
    nearest = np.minimum(before, apart)[inner].argmin(axis=1)
    return float(np.mean(nearest == 0))
