"""Which box each ray of a view meets first.

Whether any ray of a block can meet a box is decided by one ray, the block's mean ray, against the box grown by the
width of the block's cone at the box's far side. Only the pairs of block and box that remain are cast ray by ray.
"""

from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.sensors.boxes import Boxes
from olt_closed_loop.sensors.camera_rays import CameraRays
from olt_closed_loop.sensors.textures import FloatImage
from olt_generator.poses import Array

# Boxes farther away (metres), or that cover less than this share of a pixel, are left out.
_FARTHEST = 160.0
_SMALLEST = 0.5

# Blocks that are worked on at once: few enough to stay in the processor's cache.
CHUNK = 64


class Hits(NamedTuple):
    """Rays (n,), by index of block and of pixel in it, the box that each meets first, and how far along, metres."""

    block: NDArray[np.intp]
    pixel: NDArray[np.intp]
    box: NDArray[np.intp]
    distance: FloatImage


def boxes_in_view(boxes: Boxes, position: Array, axis: Array, camera_rays: CameraRays) -> Boxes:
    """The boxes that a camera at `position` (3,) looking along `axis` (3,) may see."""
    offset = boxes.center - position
    away = np.linalg.norm(offset, axis=1)
    radius = np.linalg.norm(boxes.half, axis=1)
    off_axis = np.arccos(np.clip(offset @ axis / np.maximum(away, 1e-9), -1.0, 1.0))
    apparent = np.arcsin(np.minimum(radius / np.maximum(away, 1e-9), 1.0))
    inside = (away <= radius) | (off_axis - apparent <= camera_rays.field)
    large = apparent > _SMALLEST * 0.5 * float(camera_rays.angles.min())
    return boxes.select(inside & large & (away - radius < _FARTHEST))


def cast(
    boxes: Boxes, position: Array, rays: FloatImage, middle: FloatImage, spread: FloatImage, farthest: FloatImage
) -> Hits:
    """Cast world rays (3, b, p) from `position` (3,); `middle` (3, b) and `spread` (b,) are those of their blocks.

    Only what a ray meets before `farthest` (b, p) metres is told.
    """
    # The camera's place in each box's own axes, half the box, and cosine and sine of its yaw: (3, n), (3, n), (2, n).
    (x, y, z), (cos, sin) = (position - boxes.center).T, (np.cos(boxes.yaw), np.sin(boxes.yaw))
    columns = (np.stack([cos * x + sin * y, cos * y - sin * x, z]), boxes.half.T, np.stack([cos, sin]))
    place, half, turn = (column.astype(np.float32) for column in columns)
    reach = np.linalg.norm(boxes.center - position, axis=1) + np.linalg.norm(boxes.half, axis=1)
    growth = spread[:, None] * reach.astype(np.float32)
    entry, leave = _intersect(place, half[:, None] + growth, turn, middle[:, :, None])
    block, box = np.nonzero((entry <= leave) & (leave > 0.0))

    distance = np.empty((len(block), rays.shape[2]), dtype=np.float32)
    for start in range(0, len(block), CHUNK):
        chunk = slice(start, start + CHUNK)
        these = box[chunk, None]
        entry, leave = _intersect(place[:, these], half[:, these], turn[:, these], rays[:, block[chunk]])
        reached = np.where(entry > 0.0, entry, leave)
        distance[chunk] = np.where((entry <= leave) & (leave > 0.0), reached, np.float32(np.inf))
    # The nearest for every ray: each keeps its number over all blocks.
    pair, pixel = np.nonzero(distance < farthest[block])
    met, ray = distance[pair, pixel], block[pair] * distance.shape[1] + pixel
    best = np.full(farthest.size, np.inf, dtype=np.float32)
    np.minimum.at(best, ray, met)
    first = met == best[ray]
    return Hits(block[pair[first]], pixel[first], box[pair[first]], met[first])


def _intersect(
    place: FloatImage, half: FloatImage, turn: FloatImage, rays: FloatImage
) -> tuple[FloatImage, FloatImage]:
    """Where world rays (3, ...) enter and leave boxes (slab method); boxes and rays broadcast together.

    The ray misses where it leaves before it enters, or leaves behind the camera.
    """
    (x, y, z), (cos, sin), entries, leaves = rays, turn, [], []
    for origin, size, direction in zip(place, half, (cos * x + sin * y, cos * y - sin * x, z), strict=True):
        inverse = np.float32(1.0) / np.where(np.abs(direction) < 1e-9, np.float32(1e-9), direction)
        middle, reach = -origin * inverse, size * np.abs(inverse)
        entries.append(middle - reach)
        leaves.append(middle + reach)
    return reduce(np.maximum, entries), reduce(np.minimum, leaves)
