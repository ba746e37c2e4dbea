"""A camera's rays, grouped in square blocks of pixels that are worked on together."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.sensors.textures import FloatImage
from olt_generator.cameras import Camera, pixel_rays

Value = TypeVar("Value", bound=np.generic)

STRIP_ROWS = 8
"""Rows that a rolling shutter takes together: at 20 m/s and 30 ms a picture the nearest road is off by 0.2 pixels."""


@dataclass(frozen=True)
class CameraRays:
    """The rays of a camera in blocks of size x size pixels, b blocks of p pixels in all.

    Attributes:
        rays: (3, b, p) unit rays in camera axes; blocks that reach over the image repeat its last pixels.
        angles: (b, p) angle between neighbouring pixels, radians.
        middle: (3, b) unit mean ray of each block.
        spread: (b,) tangent of the largest angle between the mean ray and the rays of the block.
        field: largest angle between a ray and the optical axis, radians.
        width, height: of the image in pixels.
        size: side of a block in pixels.
    """

    rays: FloatImage
    angles: FloatImage
    middle: FloatImage
    spread: FloatImage
    field: float
    width: int
    height: int
    size: int

    @cached_property
    def strips(self) -> "tuple[CameraRays, ...]":
        """The rays of each row of blocks."""
        columns = -(-self.width // self.size)
        cuts = [slice(first, first + columns) for first in range(0, len(self.spread), columns)]
        return tuple(
            replace(
                self,
                rays=np.ascontiguousarray(self.rays[:, cut]),
                angles=self.angles[cut],
                middle=np.ascontiguousarray(self.middle[:, cut]),
                spread=self.spread[cut],
                height=self.size,
            )
            for cut in cuts
        )

    def image(self, blocks: NDArray[Value]) -> NDArray[Value]:
        """Put values (b, p, ...) in the order of the image (height, width, ...)."""
        rows, columns = -(-self.height // self.size), -(-self.width // self.size)
        tail = blocks.shape[2:]
        grid = blocks.reshape(rows, columns, self.size, self.size, *tail).swapaxes(1, 2)
        image = grid.reshape(rows * self.size, columns * self.size, *tail)
        return np.ascontiguousarray(image[: self.height, : self.width])


@lru_cache(maxsize=32)
def camera_rays(camera: Camera, block_size: int | None = None) -> CameraRays:
    """The rays of a camera; cached, because it does not depend on where the camera is.

    Blocks have a side of `block_size` pixels; None for the one that is worked on fastest.
    """
    size = block_size or (16 if camera.width * camera.height > 40_000 else 8)
    rays = pixel_rays(camera)
    steps = np.linalg.norm(np.diff(rays, axis=1, append=2.0 * rays[:, -1:] - rays[:, -2:-1]), axis=-1)
    blocks = _blocks(rays, size)
    middle = blocks.mean(axis=1)
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    cosine = np.einsum("bpc,bc->bp", blocks, middle).min(axis=1)
    spread = np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) / cosine
    return CameraRays(
        rays=np.ascontiguousarray(np.moveaxis(blocks, -1, 0), dtype=np.float32),
        angles=_blocks(steps, size).astype(np.float32),
        middle=np.ascontiguousarray(middle.T, dtype=np.float32),
        spread=spread.astype(np.float32) * np.float32(1.001),
        field=float(np.arccos(np.clip(rays[..., 2].min(), -1.0, 1.0))),
        width=camera.width,
        height=camera.height,
        size=size,
    )


def strip_rows(camera: Camera) -> NDArray[np.float64]:
    """The middle row (n,) of each strip of a rolling shutter, as a pixel coordinate."""
    first = np.arange(0, camera.height, STRIP_ROWS)
    return (first + np.minimum(first + STRIP_ROWS, camera.height) - 1) / 2


def _blocks(image: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Values (height, width, ...) as blocks (b, size * size, ...)."""
    height, width, *tail = image.shape
    padding = [(0, -height % size), (0, -width % size), *((0, 0) for _ in tail)]
    padded = np.pad(image, padding, mode="edge")
    rows, columns = padded.shape[0] // size, padded.shape[1] // size
    return padded.reshape(rows, size, columns, size, *tail).swapaxes(1, 2).reshape(rows * columns, size * size, *tail)
