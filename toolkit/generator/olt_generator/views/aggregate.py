"""What other frames of the front camera saw of what a camera sees now.

Everything is taken to stand still; pixels of moving objects must be left out of what is gathered. All frames land in
one z-buffer. The nearest surface wins; surfaces whose distances agree to a few per cent are one surface, and of that
the frame wins that was nearest to it: it shows it the finest and the least obliquely, and errs least about its place.
Then the frame that was asked first wins, then the first pixel, so the bytes do not depend on the order of the work.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.poses import Array
from olt_generator.views.splat import NEAREST, land, spread_nearest

# Distances that differ by less than this share are one surface: about the error of a good distance estimate.
SURFACE_TOLERANCE = 0.05
# The same for the distances of the frames from a surface: below it, they see it equally well.
_FINENESS_STEP = 0.02

# Metres that stand for infinity: farther than any clip is long, and finite.
_INFINITY = 1e6

# Keys are, from the highest bit: 12 bits of distance, 12 bits of distance from the source, 8 bits of source, 31 bits
# of pixel.
_DISTANCE_BIT, _FINENESS_BIT, _SOURCE_BIT = 51, 39, 31
_NOTHING = np.int64(2**63 - 1)


@dataclass(frozen=True)
class SourceFrame:
    """One frame to gather from.

    Attributes:
        image: (H, W, 3) uint8.
        distance: (H, W) metres along the rays, inf for what is so far that only its direction matters; NaN for what
            must not be taken.
        T_target_camera: (4, 4) pose of its camera in the target camera.
    """

    image: NDArray[np.uint8]
    distance: NDArray[np.float32]
    T_target_camera: Array


def gather(
    sources: Sequence[SourceFrame], camera: Camera, target: Camera, radius: int = 1
) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.bool_]]:
    """Gather what `sources`, at least one frame of `camera`, show of the view of `target`; arguments as in `splat`.

    Returns:
        The image (h, w, 3), black where nothing lands; which of the sources each pixel (h, w) comes from, their number
        where nothing lands; and the pixels (h, w) of which only the direction is known.
    """
    width, height = target.width + 2 * radius, target.height + 2 * radius
    closest = np.full(width * height, _NOTHING)
    for number, source in enumerate(sources):
        finite = np.where(np.isposinf(source.distance), np.float32(_INFINITY), source.distance)
        for landing in land(finite, camera, target, source.T_target_camera, radius, (NEAREST, 2.0 * _INFINITY)):
            key = _level(landing.distance, SURFACE_TOLERANCE) << _DISTANCE_BIT
            key |= _level(finite.take(landing.source), _FINENESS_STEP) << _FINENESS_BIT
            key |= (number << _SOURCE_BIT) | landing.source
            np.minimum.at(closest, (landing.row + radius) * width + landing.column + radius, key)
    winner = spread_nearest(closest.reshape(height, width), radius)
    landed = winner != _NOTHING
    number = np.where(landed, winner >> _SOURCE_BIT & 0xFF, len(sources))
    colours = np.concatenate([*(source.image.reshape(-1, 3) for source in sources), np.zeros((1, 3), np.uint8)])
    index = np.where(landed, number * sources[0].distance.size + (winner & 0x7FFFFFFF), len(colours) - 1)
    far_level = _level(np.array([0.5 * _INFINITY], np.float32), SURFACE_TOLERANCE)
    return colours.take(index, axis=0), number, landed & (winner >> _DISTANCE_BIT > far_level)


def _level(distance: NDArray[np.float32], step: float) -> NDArray[np.int64]:
    """Distance of at least `NEAREST` on a logarithmic scale with the given relative step."""
    return (np.log(distance / np.float32(NEAREST)) * np.float32(1.0 / np.log1p(step))).astype(np.int64)
