"""Forward splatting of an image with known distances into another camera, the nearest surface always in front.

Distance is measured along the unit ray of a pixel, not along the optical axis, because the rays of wide lenses may
stand square to it.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.poses import Array

# Distances in metres between which a surface is warped: the limits of the released generator
# (docs/formats/generator.md).
NEAREST = 0.5
FARTHEST = 200.0

# Source pixels worked on at a time: their intermediate arrays stay in the processor's cache.
BLOCK_PIXELS = 16384


@dataclass(frozen=True)
class Warp:
    """An image seen from another camera.

    Attributes:
        image: (h, w, 3) uint8, black where nothing lands.
        visible: (h, w) bool, where a source pixel lands.
        distance: (h, w) float32 metres from the target to the surface that lands, inf where none does.
    """

    image: NDArray[np.uint8]
    visible: NDArray[np.bool_]
    distance: NDArray[np.float32]


@dataclass(frozen=True)
class Landing:
    """Where a block of source pixels lands: the `k` that stay within the limits, in source order.

    Attributes:
        source: (k,) index of the pixel in the flattened source image.
        row, column: (k,) target pixel; up to the footprint's radius outside of the target image.
        distance: (k,) float32 metres from the target.
    """

    source: NDArray[np.int64]
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    distance: NDArray[np.float32]


def splat(
    image: NDArray[np.uint8],
    distance: NDArray[np.float32],
    source: Camera,
    target: Camera,
    T_target_source: Array,
    radius: int = 1,
    limits: tuple[float, float] = (NEAREST, FARTHEST),
) -> Warp:
    """Warp `image` from `source` to `target`; every source pixel covers (2 radius + 1)^2 target pixels.

    The nearest surface wins; of surfaces equally near, the pixel that comes first in the source image. The bytes do
    not depend on the order of the work, hence not on the number of threads.

    Args:
        image: (H, W, 3) uint8.
        distance: (H, W) metres along each pixel's ray; NaN, inf and what is not within the limits is dropped.
        source, target: cameras of `image` and of the wanted view.
        T_target_source: (4, 4) pose of the source camera in the target camera.
        radius: half width of the footprint in target pixels.
        limits: metres; surfaces as near to either camera as the first, or as far from the source as the second, are
            dropped.

    Raises:
        InputError: image or distance have another size than the source camera.
    """
    if image.shape != (source.height, source.width, 3):
        raise InputError(_size_mismatch("image", image.shape, source))
    width, height = target.width + 2 * radius, target.height + 2 * radius
    # One integer sorts by distance, then by source pixel: the bits of positive floats sort like their values. The
    # empty key stands for a pixel after the last, at infinity behind all others.
    closest = np.repeat(_sortable(np.array([np.inf], np.float32), np.array([distance.size])), width * height)
    for landing in land(distance, source, target, T_target_source, radius, limits):
        pixel = (landing.row + radius) * width + landing.column + radius
        np.minimum.at(closest, pixel, _sortable(landing.distance, landing.source))
    winner = spread_nearest(closest.reshape(height, width), radius)
    index = winner & 0xFFFFFFFF
    colours = np.concatenate([image.reshape(-1, 3), np.zeros((1, 3), np.uint8)])
    surface_distance = (winner >> 32).astype(np.int32).view(np.float32)
    return Warp(colours.take(index, axis=0), index < distance.size, surface_distance)


def splat_reference(image: NDArray[np.uint8], landings: Iterable[Landing], target: Camera, radius: int = 1) -> Warp:
    """What `splat` must equal bit for bit, by the painter's algorithm: footprints painted one by one, far to near."""
    warp = Warp(
        np.zeros((target.height, target.width, 3), np.uint8),
        np.zeros((target.height, target.width), bool),
        np.full((target.height, target.width), np.inf, np.float32),
    )
    points = [
        point
        for landing in landings
        for point in zip(landing.distance, landing.source, landing.row, landing.column, strict=True)
    ]
    for point_distance, pixel, row, column in sorted(points, reverse=True):
        rows = slice(max(row - radius, 0), max(row + radius + 1, 0))
        columns = slice(max(column - radius, 0), max(column + radius + 1, 0))
        warp.image[rows, columns] = image.reshape(-1, 3)[pixel]
        warp.visible[rows, columns] = True
        warp.distance[rows, columns] = point_distance
    return warp


def land(
    distance: NDArray[np.float32],
    source: Camera,
    target: Camera,
    T_target_source: Array,
    radius: int = 1,
    limits: tuple[float, float] = (NEAREST, FARTHEST),
) -> Iterator[Landing]:
    """Lift the source pixels by their distance, move them to the target camera and round to its pixels.

    Single precision: it moves a point by less than a thousandth of a pixel. Yields one block of source pixels after the
    other; arguments and errors are those of `splat`.
    """
    if distance.shape != (source.height, source.width):
        raise InputError(_size_mismatch("distance", distance.shape, source))
    # Footprints may reach into the image from outside, so the target is widened by their radius.
    widened = target.cropped(-radius, -radius, target.width + 2 * radius, target.height + 2 * radius)
    rotation, translation = T_target_source[:3, :3].astype(np.float32), T_target_source[:3, 3:].astype(np.float32)
    all_distances, all_rays = distance.astype(np.float32, copy=False).ravel(), _ray_rows(source)
    for first in range(0, distance.size, BLOCK_PIXELS):
        block = all_distances[first : first + BLOCK_PIXELS]
        # What is dropped becomes NaN, which no camera sees: cheaper than to pick out the others.
        kept = np.where((block > limits[0]) & (block < limits[1]), block, np.float32(np.nan))
        points: NDArray[Any] = rotation @ all_rays[:, first : first + BLOCK_PIXELS]
        points *= kept
        points += translation
        pixels, inside = widened.project(points.T)
        landed = np.flatnonzero(inside)
        target_distance = np.sqrt((points.take(landed, axis=1) ** 2).sum(axis=0))
        far_enough = target_distance > limits[0]
        landed = landed[far_enough]
        column, row = (np.floor(pixels[:, axis].take(landed) + 0.5).astype(np.int64) - radius for axis in (0, 1))
        yield Landing(first + landed, row, column, target_distance[far_enough])


@lru_cache(maxsize=32)
def _ray_rows(camera: Camera) -> NDArray[np.float32]:
    """Unit rays (3, height * width), one row per axis so that projections read contiguous memory; read-only."""
    rows = np.ascontiguousarray(pixel_rays(camera).reshape(-1, 3).T, np.float32)
    rows.flags.writeable = False
    return rows


def _size_mismatch(what: str, shape: tuple[int, ...], source: Camera) -> str:
    return (
        f"splat: {what} {shape} for a source camera of {source.width} x {source.height}; give the camera at the size "
        "of image and distance"
    )


def _sortable(distance: NDArray[np.float32], source: NDArray[np.int64]) -> NDArray[np.int64]:
    return distance.view(np.int32).astype(np.int64) << 32 | source


def spread_nearest(keys: NDArray[np.int64], radius: int) -> NDArray[np.int64]:
    """The smallest of the keys (h + 2 radius, w + 2 radius) within `radius` pixels of each of (h, w)."""
    height, width = keys.shape[0] - 2 * radius, keys.shape[1] - 2 * radius
    offsets = range(1, 2 * radius + 1)
    along_rows = keys[:, :width].copy()
    for offset in offsets:
        np.minimum(along_rows, keys[:, offset : offset + width], out=along_rows)
    along_both = along_rows[:height].copy()
    for offset in offsets:
        np.minimum(along_both, along_rows[offset : offset + height], out=along_both)
    return along_both
