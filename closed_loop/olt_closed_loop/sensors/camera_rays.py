"""A camera's rays, and the squares of pixels in which what they meet is searched for."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.sensors.textures import FloatImage
from olt_generator.cameras import Camera, pixel_rays

STRIP_ROWS = 8
"""Rows that a rolling shutter takes together: at 20 m/s and 30 ms a picture the nearest road is off by 0.2 pixels."""

# Sides of the squares in pixels, from coarse to fine; each holds whole squares of the next. Those whose rays spread
# more than the tangent says are not used.
_SIDES = (64, 16, 8)
_WIDEST = 0.6


@dataclass(frozen=True)
class Squares:
    """Squares of pixels, n of one size, each a cone of rays.

    Attributes:
        middle: (3, n) unit mean ray of each, in camera axes.
        spread: (n,) tangent of the largest angle between the mean ray and the rays of the square.
        children: (n, k) the next finer squares in each, -1 for those outside the image; (n, 0) for the finest.
    """

    middle: FloatImage
    spread: FloatImage
    children: NDArray[np.intp]


@dataclass(frozen=True)
class CameraRays:
    """The rays of a camera, or of some rows of it, one through the centre of each of its n pixels, row by row.

    Attributes:
        rays: (3, n) unit rays in camera axes.
        angles: (n,) angle between neighbouring pixels, radians.
        squares: from the coarsest to the finest.
        pixels: (b, p) the pixels of each of the finest squares; a square over the edge repeats its last ones.
        field: largest angle between a ray of the camera and the optical axis, radians.
        finest: smallest angle between neighbouring pixels of the camera, radians.
        size: (height, width) in pixels.
    """

    rays: FloatImage
    angles: FloatImage
    squares: tuple[Squares, ...]
    pixels: NDArray[np.intp]
    field: float
    finest: float
    size: tuple[int, int]

    @cached_property
    def strips(self) -> "tuple[CameraRays, ...]":
        """The rays of every `STRIP_ROWS` rows."""
        height, width = self.size
        # In single precision cones would come out too narrow.
        rays, angles = self.rays.T.reshape(height, width, 3).astype(np.float64), self.angles.reshape(height, width)
        cuts = [slice(first, first + STRIP_ROWS) for first in range(0, height, STRIP_ROWS)]
        strips = (_group(rays[cut], angles[cut]) for cut in cuts)
        return tuple(replace(strip, field=self.field, finest=self.finest) for strip in strips)


@lru_cache(maxsize=16)
def camera_rays(camera: Camera) -> CameraRays:
    """The rays of a camera; cached, because they do not depend on where the camera is."""
    rays = pixel_rays(camera)
    angles = np.linalg.norm(np.diff(rays, axis=1, append=2.0 * rays[:, -1:] - rays[:, -2:-1]), axis=-1)
    return _group(rays, angles)


def strip_rows(camera: Camera) -> NDArray[np.float64]:
    """The middle row (n,) of each strip of a rolling shutter, as a pixel coordinate."""
    first = np.arange(0, camera.height, STRIP_ROWS)
    return (first + np.minimum(first + STRIP_ROWS, camera.height) - 1) / 2


def _group(rays: NDArray[np.floating], angles: NDArray[np.floating]) -> CameraRays:
    """Rays (height, width, 3) and the angles (height, width) between them, with their squares."""
    height, width = angles.shape
    squares: list[Squares] = []
    finer = 0
    for side in reversed(_SIDES):
        middle, spread = _cones(_squares_of(rays, side))
        if squares and spread.max() > _WIDEST:
            break
        squares.insert(0, Squares(middle, spread, _children(height, width, side, finer)))
        finer = side
    return CameraRays(
        rays=np.ascontiguousarray(rays.reshape(-1, 3).T, dtype=np.float32),
        angles=angles.ravel().astype(np.float32),
        squares=tuple(squares),
        pixels=_squares_of(np.arange(height * width).reshape(height, width), _SIDES[-1]),
        field=float(np.arccos(np.clip(rays[..., 2].min(), -1.0, 1.0))),
        finest=float(angles.min()),
        size=(height, width),
    )


def _cones(groups: NDArray[np.floating]) -> tuple[FloatImage, FloatImage]:
    """Mean rays (3, n) and spreads (n,) of groups of rays (n, p, 3); inf where they spread by 90 degrees or more."""
    middle = groups.mean(axis=1)
    middle /= np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), 1e-9)
    cosine = np.einsum("bpc,bc->bp", groups, middle).min(axis=1)
    tangent = np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) / np.maximum(cosine, 1e-9)
    spread = np.where(cosine > 0.0, 1.001 * tangent, np.inf)
    return np.ascontiguousarray(middle.T, dtype=np.float32), spread.astype(np.float32)


def _children(height: int, width: int, side: int, finer: int) -> NDArray[np.intp]:
    """The squares of side `finer` in each square of side `side`, row by row; none for a `finer` of 0."""
    rows, columns = -(-height // side), -(-width // side)
    if finer == 0:
        return np.zeros((rows * columns, 0), dtype=np.intp)
    count, height, width = side // finer, -(-height // finer), -(-width // finer)
    number = np.full((rows * count, columns * count), -1, dtype=np.intp)
    number[:height, :width] = np.arange(height * width).reshape(height, width)
    return _squares_of(number, count)


def _squares_of(image: NDArray, side: int) -> NDArray:
    """Values (height, width, ...) as squares (n, side * side, ...); those over the edge repeat the last ones."""
    height, width, *tail = image.shape
    padding = [(0, -height % side), (0, -width % side), *((0, 0) for _ in tail)]
    padded = np.pad(image, padding, mode="edge")
    rows, columns = padded.shape[0] // side, padded.shape[1] // side
    return padded.reshape(rows, side, columns, side, *tail).swapaxes(1, 2).reshape(rows * columns, side * side, *tail)
