"""Which box each ray of a view meets first.

Boxes are asked for from coarse squares of pixels to fine ones: whether any ray of a square can meet a box is decided by
one ray, the square's mean ray, against the box grown by the width of the square's cone at the box's far side. Only the
pairs of finest square and box that remain are cast ray by ray.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.sensors.boxes import Boxes
from olt_closed_loop.sensors.camera_rays import Squares
from olt_closed_loop.sensors.textures import FloatImage
from olt_generator.poses import Array

# Boxes farther away (metres), or that cover less than this share of a pixel, are left out.
_FARTHEST = 160.0
_SMALLEST = 0.5

# Pairs of square and box that are cast at once: few enough to stay in the processor's cache.
_CHUNK = 256
_TINY = np.float32(1e-12)


class Hits(NamedTuple):
    """Rays (n,): the pixel of each, its number in the finest squares, the box it meets first, and how far, metres."""

    pixel: NDArray[np.intp]
    ray: NDArray[np.intp]
    box: NDArray[np.intp]
    distance: FloatImage


def boxes_in_view(boxes: Boxes, position: Array, axis: Array, field: float, finest: float) -> Boxes:
    """The boxes that a camera at `position` (3,) may see.

    It looks along `axis` (3,), its field reaches `field` radians from that, and its finest pixel is `finest` radians.
    """
    offset = boxes.center - position
    away = np.sqrt(np.einsum("ni,ni->n", offset, offset))
    radius = np.sqrt(np.einsum("ni,ni->n", boxes.half, boxes.half))
    near = np.flatnonzero((away - radius < _FARTHEST) & (radius > np.sin(_SMALLEST * 0.5 * finest) * away))
    offset, away, radius = offset[near], away[near], radius[near]
    off_axis = np.arccos(np.clip(offset @ axis / np.maximum(away, 1e-9), -1.0, 1.0))
    apparent = np.arcsin(np.minimum(radius / np.maximum(away, 1e-9), 1.0))
    return boxes.select(near[(away <= radius) | (off_axis - apparent <= field)])


def cast(
    boxes: Boxes, squares: Sequence[Squares], rays: FloatImage, pixels: NDArray[np.intp], farthest: FloatImage
) -> Hits:
    """Cast the rays (3, b, p) of the finest squares, which belong to `pixels` (b, p), from the origin against boxes.

    `squares` have their mean rays in the same axes. Only what is met before `farthest` (n,) metres is told.
    """
    origin = -np.einsum("nij,ni->nj", boxes.axes, boxes.center)
    place, half = (np.ascontiguousarray(values.T, dtype=np.float32) for values in (origin, boxes.half))
    axes = np.ascontiguousarray(np.moveaxis(boxes.axes, 0, -1), dtype=np.float32)
    shapes = (place, half, axes, bool(np.all(boxes.axes[:, 2, :2] == 0.0)))
    reach = (np.linalg.norm(boxes.center, axis=1) + np.linalg.norm(boxes.half, axis=1)).astype(np.float32)
    square, box = _search(shapes, reach, squares)
    if len(square) == 0:
        nothing = np.zeros(0, dtype=np.intp)
        return Hits(nothing, nothing, nothing, np.zeros(0, dtype=np.float32))
    distance = np.empty((len(square), pixels.shape[1]), dtype=np.float32)
    for start in range(0, len(square), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        entry, leave = _intersect(shapes, box[chunk, None], rays.take(square[chunk], axis=1))
        missed = entry > leave
        missed |= leave <= 0.0
        reached = np.where(entry > 0.0, entry, leave)
        np.copyto(reached, np.float32(np.inf), where=missed)
        distance[chunk] = reached
    return _nearest(distance, square, box, pixels, farthest)


_Shapes = tuple[FloatImage, FloatImage, FloatImage, bool]
"""The origin in each box's own axes (3, n), half the box (3, n), its axes (3, 3, n), and whether all stand upright."""


def _search(
    shapes: _Shapes, reach: FloatImage, squares: Sequence[Squares]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs (n,) of finest square, in order, and box that a ray of the square may meet."""
    count = squares[0].spread.size
    square, box = np.divmod(np.arange(count * len(reach)), max(len(reach), 1))
    for index, level in enumerate(squares):
        if index:
            inside = squares[index - 1].children[square]
            there = inside >= 0
            square, box = inside[there], np.broadcast_to(box[:, None], inside.shape)[there]
        growth = level.spread[square] * reach[box]
        entry, leave = _intersect(shapes, box, level.middle.take(square, axis=1), growth)
        met = (entry <= leave) & (leave > 0.0)
        square, box = square[met], box[met]
    order = np.argsort(square, kind="stable")
    return square[order], box[order]


def _nearest(
    distance: FloatImage,
    square: NDArray[np.intp],
    box: NDArray[np.intp],
    pixels: NDArray[np.intp],
    farthest: FloatImage,
) -> Hits:
    """The first box of every ray, from distances (n, p) of pairs (n,) of square and box, in order of the squares."""
    first = np.flatnonzero(np.diff(square, prepend=-1))
    best = np.minimum.reduceat(distance, first, axis=0)
    # The order of the pairs decides between two boxes that are met at the same distance.
    number = np.repeat(np.arange(len(first)), np.diff(first, append=len(square)))
    met = best < farthest[pixels[square[first]]]
    best[~met] = -np.inf
    pair, ray = np.nonzero(distance == best[number])
    found = distance[pair, ray]
    ray += square[pair] * pixels.shape[1]
    # A square over the edge has a pixel several times.
    return Hits(np.take(pixels, ray), ray, box[pair], found)


def _intersect(
    shapes: _Shapes, box: NDArray[np.intp], rays: FloatImage, growth: FloatImage | None = None
) -> tuple[FloatImage, FloatImage]:
    """Where rays (3, ...) enter and leave boxes of an index that broadcasts with them (slab method).

    The ray misses where it leaves before it enters, or leaves behind the origin. Boxes may be grown by `growth` metres.
    """
    place, half, axes, upright = shapes
    (x, y, z), entry, leave = rays, None, None
    for axis in range(3):
        if upright and axis == 2:
            direction = z + _TINY
        else:
            direction = axes[0, axis].take(box) * x
            direction += axes[1, axis].take(box) * y
            if not upright:
                direction += axes[2, axis].take(box) * z
            direction += _TINY
        inverse = np.reciprocal(direction, out=direction)
        size = half[axis].take(box)
        middle = place[axis].take(box) * -inverse
        reach = np.abs(inverse, out=inverse)
        reach *= size if growth is None else size + growth
        near, far = middle - reach, np.add(middle, reach, out=reach)
        entry = near if entry is None else np.maximum(entry, near, out=entry)
        leave = far if leave is None else np.minimum(leave, far, out=leave)
    assert entry is not None and leave is not None
    return entry, leave
