"""Which box each ray of a view meets first.

Whether any ray of a block can meet a box is decided by one ray, the block's mean ray, against the box grown by the
width of the block's cone at the box's far side. Only the pairs of block and box that remain are cast ray by ray.
"""

from dataclasses import dataclass
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


@dataclass(frozen=True)
class Hits:
    """The rays that meet a box.

    Attributes:
        block, pixel: (n,) which ray: index of the block and of the pixel in it.
        box: (n,) index of the box that it meets first.
        distance: (n,) metres along the ray.
    """

    block: NDArray[np.intp]
    pixel: NDArray[np.intp]
    box: NDArray[np.intp]
    distance: FloatImage

    def before(self, distance: FloatImage) -> "Hits":
        """Those that lie before the given distance (b, p) of each ray, metres."""
        nearer = self.distance < distance[self.block, self.pixel]
        return Hits(self.block[nearer], self.pixel[nearer], self.box[nearer], self.distance[nearer])


class BoxFrames(NamedTuple):
    """The camera's place (x, y, z) in each box's own axes, the box's half sizes, and cosine and sine of its yaw."""

    x: FloatImage
    y: FloatImage
    z: FloatImage
    half_x: FloatImage
    half_y: FloatImage
    half_z: FloatImage
    cos: FloatImage
    sin: FloatImage


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


def cast(boxes: Boxes, position: Array, rays: FloatImage, middle: FloatImage, spread: FloatImage) -> Hits:
    """Cast world rays (3, b, p) from `position` (3,); `middle` (3, b) and `spread` (b,) are those of their blocks."""
    x, y, z = (position - boxes.center).T
    cos, sin = np.cos(boxes.yaw), np.sin(boxes.yaw)
    columns = (cos * x + sin * y, cos * y - sin * x, z, *boxes.half.T, cos, sin)
    frames = BoxFrames(*(column.astype(np.float32) for column in columns))
    reach = np.linalg.norm(boxes.center - position, axis=1) + np.linalg.norm(boxes.half, axis=1)
    growth = spread[:, None] * reach.astype(np.float32)
    grown = frames._replace(half_x=frames.half_x + growth, half_y=frames.half_y + growth, half_z=frames.half_z + growth)
    entry, leave = intersect(grown, middle[:, :, None])
    block, box = np.nonzero((entry <= leave) & (leave > 0.0))

    distance = np.empty((len(block), rays.shape[2]), dtype=np.float32)
    for start in range(0, len(block), CHUNK):
        chunk = slice(start, start + CHUNK)
        column = box[chunk, None]
        entry, leave = intersect(BoxFrames(*(values[column] for values in frames)), rays[:, block[chunk]])
        reached = np.where(entry > 0.0, entry, leave)
        distance[chunk] = np.where((entry <= leave) & (leave > 0.0), reached, np.float32(np.inf))
    return _nearest(block, box, distance, rays.shape[1])


def intersect(frames: BoxFrames, rays: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Where world rays (3, ...) enter and leave boxes (slab method); boxes and rays broadcast together.

    The ray misses where it leaves before it enters, or leaves behind the camera.
    """
    x, y, z = rays
    ahead, left = frames.cos * x + frames.sin * y, frames.cos * y - frames.sin * x
    entry_x, leave_x = _slab(frames.x, frames.half_x, ahead)
    entry_y, leave_y = _slab(frames.y, frames.half_y, left)
    entry_z, leave_z = _slab(frames.z, frames.half_z, z)
    return np.maximum(np.maximum(entry_x, entry_y), entry_z), np.minimum(np.minimum(leave_x, leave_y), leave_z)


def _slab(origin: FloatImage, half: FloatImage, direction: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Where rays enter and leave the space between two planes at -half and half."""
    inverse = np.float32(1.0) / np.where(np.abs(direction) < 1e-9, np.float32(1e-9), direction)
    middle, reach = -origin * inverse, half * np.abs(inverse)
    return middle - reach, middle + reach


def _nearest(block: NDArray[np.intp], box: NDArray[np.intp], distance: FloatImage, blocks: int) -> Hits:
    """The nearest of the distances (pairs, p) for every ray of all blocks."""
    pair, pixel = np.nonzero(distance < np.inf)
    met = distance[pair, pixel]
    ray = block[pair] * distance.shape[1] + pixel
    best = np.full(blocks * distance.shape[1], np.inf, dtype=np.float32)
    np.minimum.at(best, ray, met)
    first = met == best[ray]
    return Hits(block[pair[first]], pixel[first], box[pair[first]], met[first])
