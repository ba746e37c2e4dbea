"""Procedural textures, shared by all scenes: ground noise, clouds, and one atlas of surfaces for boxes.

Noise is periodic, has mean 0 and unit spread, and each layer holds one band of sizes, so that a layer can be faded out
where a pixel covers more than its texels. Surfaces are stored with their mip levels for the same reason.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_generator.seeds import make_generator

FloatImage = NDArray[np.floating[Any]]
"""Single precision in all pixel work."""

Image = NDArray[np.uint8]

# Ground noise: metres per texel and texels per side, from fine grain to broad stains.
NOISE_LAYERS: tuple[tuple[float, int], ...] = ((0.02, 1024), (0.09, 1024), (0.7, 512))

TILE = 128
TILE_LEVELS = 6
_PADDING = 1


def sample(image: NDArray[Any], x: FloatImage, y: FloatImage) -> NDArray[Any]:
    """Values (n, m, ...) of an image at columns x and rows y, each (n, m), blended between the four pixels around."""
    return cv2.remap(image, x, y, cv2.INTER_LINEAR)


@lru_cache(maxsize=1)
def ground_noise() -> tuple[FloatImage, ...]:
    """One square layer (n + 1, n + 1) for each of `NOISE_LAYERS`; last row and column repeat the first."""
    generator = make_generator("ground noise")
    grain, wear, stains = (_band_noise(generator, size, 1.5, 7.0) for _, size in NOISE_LAYERS)
    wear = wear + _patches_and_cracks(generator, NOISE_LAYERS[1][1])
    return _periodic(grain), _periodic(wear), _periodic(stains)


@lru_cache(maxsize=1)
def clouds() -> FloatImage:
    """Cloud density (n + 1, n + 1), mean 0 and unit spread; last row and column repeat the first."""
    return _periodic(_band_noise(make_generator("clouds"), 1024, 12.0, 160.0))


def _band_noise(generator: np.random.Generator, size: int, finest: float, coarsest: float) -> FloatImage:
    """Periodic noise (size, size) whose power falls with frequency between two wavelengths in texels."""
    white = generator.standard_normal((size, size), dtype=np.float32)
    fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.rfftfreq(size), indexing="ij")
    frequency = np.hypot(fx, fy)
    band = np.exp(-((frequency * finest) ** 2)) * (1.0 - np.exp(-((frequency * coarsest) ** 2)))
    spectrum = np.fft.rfft2(white) * band / np.maximum(frequency, 1.0 / size)
    return np.fft.irfft2(spectrum, s=(size, size)).astype(np.float32)


def _periodic(layer: FloatImage) -> FloatImage:
    """The layer with mean 0 and unit spread, and its first row and column again at the end."""
    standard = ((layer - layer.mean()) / layer.std()).astype(np.float32)
    return np.pad(standard, ((0, 1), (0, 1)), mode="wrap")


def _patches_and_cracks(generator: np.random.Generator, size: int) -> FloatImage:
    """Repaired rectangles and dark wandering cracks, periodic like the noise below them."""
    canvas = np.zeros((size, size), dtype=np.float32)
    for _ in range(60):
        x, y = generator.integers(0, size, 2).tolist()
        width, height = generator.integers(8, 40, 2).tolist()
        cv2.rectangle(canvas, (x, y), (x + width, y + height), float(generator.uniform(-0.02, 0.015)), cv2.FILLED)
    for _ in range(160):
        steps = generator.normal(0.0, 4.0, (25, 2)) + generator.normal(0.0, 3.0, 2)
        points = generator.uniform(0, size, 2) + np.cumsum(steps, axis=0)
        for shift in (-size, 0, size):
            shifted = np.round(points + np.array([shift, 0])).astype(np.int32)
            cv2.polylines(canvas, [shifted], False, -0.06, 1, cv2.LINE_AA)
    return canvas


Paint = Callable[[FloatImage, np.random.Generator], None]
"""Draws on a tile (n, n, 4): red, green, blue of its own in 0 ... 255, and the gain of the box's base colour."""

Texel = tuple[float, float, float, float]

_TIRE: Texel = (18.0, 18.0, 20.0, 0.0)
_WINDOW: Texel = (45.0, 55.0, 66.0, 0.0)
_WHITE: Texel = (230.0, 230.0, 225.0, 0.0)
_LAMP: Texel = (255.0, 250.0, 225.0, 0.0)


def _base(gain: float) -> Texel:
    return (0.0, 0.0, 0.0, gain)


def _paint_plain(tile: FloatImage, generator: np.random.Generator) -> None:
    """The base colour with its grain."""


def _paint_building(tile: FloatImage, generator: np.random.Generator) -> None:
    """Two storeys of three windows in a brick wall."""
    for course, top in enumerate(range(0, TILE, 8)):
        tile[top] *= 0.84
        tile[top : top + 8, course % 2 * 8 :: 16] *= 0.88
    for top in (18, 82):
        for left in (10, 52, 94):
            cv2.rectangle(tile, (left - 3, top - 3), (left + 27, top + 33), _base(1.15), cv2.FILLED)
            dark, light = (40.0 + generator.uniform(0.0, 40.0) for _ in range(2))
            cv2.rectangle(tile, (left, top), (left + 11, top + 30), (dark, dark + 8, dark + 16, 0.0), cv2.FILLED)
            cv2.rectangle(
                tile, (left + 14, top), (left + 24, top + 30), (light, light + 8, light + 16, 0.0), cv2.FILLED
            )


def _paint_foliage(tile: FloatImage, generator: np.random.Generator) -> None:
    for _ in range(420):
        x, y = generator.integers(0, TILE, 2).tolist()
        cv2.circle(tile, (x, y), int(generator.integers(2, 7)), _base(generator.uniform(0.45, 1.5)), cv2.FILLED)


def _paint_stripes(tile: FloatImage, generator: np.random.Generator) -> None:
    """Red and white slanted stripes on a barrier's board, and its feet."""
    v, u = np.mgrid[0:TILE, 0:TILE]
    tile[:] = _WHITE
    tile[(u + v) // 16 % 2 == 0] = (205.0, 35.0, 30.0, 0.0)
    tile[TILE * 3 // 4 :] = _base(0.4)


def _paint_cone(tile: FloatImage, generator: np.random.Generator) -> None:
    tile[20:50] = _WHITE
    tile[74:104] = _WHITE


def _paint_car_side(tile: FloatImage, generator: np.random.Generator) -> None:
    """Wheels, doors and a dark sill; the body below the windows."""
    tile[104:] = _TIRE
    for u in (24, 104):
        cv2.ellipse(tile, (u, 98), (12, 30), 0, 0, 360, _TIRE, cv2.FILLED)
        cv2.ellipse(tile, (u, 98), (6, 15), 0, 0, 360, (150.0, 150.0, 155.0, 0.0), cv2.FILLED)
    for u in (44, 66, 88):
        cv2.line(tile, (u, 4), (u, 92), _base(0.5), 1)


def _paint_car_front(tile: FloatImage, generator: np.random.Generator) -> None:
    tile[104:] = _TIRE
    cv2.rectangle(tile, (34, 60), (94, 92), _TIRE, cv2.FILLED)
    for u in (16, 112):
        cv2.circle(tile, (u, 45), 11, _LAMP, cv2.FILLED)


def _paint_car_rear(tile: FloatImage, generator: np.random.Generator) -> None:
    tile[104:] = _TIRE
    cv2.rectangle(tile, (44, 70), (84, 86), _WHITE, cv2.FILLED)
    for u in (14, 114):
        cv2.rectangle(tile, (u - 11, 30), (u + 11, 56), (200.0, 20.0, 20.0, 0.0), cv2.FILLED)


def _paint_glass(tile: FloatImage, generator: np.random.Generator) -> None:
    """Two windows with pillars between them."""
    for left in (8, 68):
        cv2.rectangle(tile, (left, 16), (left + 52, 124), _WINDOW, cv2.FILLED)
        cv2.line(tile, (left + 10, 118), (left + 34, 24), (95.0, 105.0, 118.0, 0.0), 6)


def _paint_panels(tile: FloatImage, generator: np.random.Generator) -> None:
    """Ribs of a cargo box over dark wheels."""
    tile[:, ::16] *= 0.75
    tile[100:] = (45.0, 45.0, 48.0, 0.0)
    for u in (22, 48, 108):
        cv2.ellipse(tile, (u, 112), (8, 15), 0, 0, 360, _TIRE, cv2.FILLED)
        cv2.ellipse(tile, (u, 112), (3, 6), 0, 0, 360, (120.0, 120.0, 120.0, 0.0), cv2.FILLED)


def _paint_wheel(tile: FloatImage, generator: np.random.Generator) -> None:
    """A big spoked wheel that fills the face."""
    tile[:] = _TIRE
    cv2.circle(tile, (TILE // 2, TILE // 2), 40, (225.0, 190.0, 50.0, 0.0), cv2.FILLED)
    for angle in np.arange(0.0, 2.0 * np.pi, np.pi / 8.0):
        end = (round(64 + 60 * np.cos(angle)), round(64 + 60 * np.sin(angle)))
        cv2.line(tile, (64, 64), end, (70.0, 70.0, 70.0, 0.0), 3)


def _paint_skin(tile: FloatImage, generator: np.random.Generator) -> None:
    tile[:] = (205.0, 160.0, 130.0, 0.0)
    tile[: TILE // 3] = (50.0, 40.0, 35.0, 0.0)


_SURFACES: dict[str, Paint] = {
    "plain": _paint_plain,
    "building": _paint_building,
    "foliage": _paint_foliage,
    "stripes": _paint_stripes,
    "cone": _paint_cone,
    "car_side": _paint_car_side,
    "car_front": _paint_car_front,
    "car_rear": _paint_car_rear,
    "glass": _paint_glass,
    "panels": _paint_panels,
    "wheel": _paint_wheel,
    "skin": _paint_skin,
}
SURFACE_INDEX: dict[str, int] = {name: index for index, name in enumerate(_SURFACES)}

_ROW_HEIGHT = TILE + 2 * _PADDING
_LEVEL_SIZES = np.array([TILE >> level for level in range(TILE_LEVELS)], dtype=np.float32)
_LEVEL_LEFT = (np.cumsum(_LEVEL_SIZES + 2 * _PADDING) - _LEVEL_SIZES - _PADDING - 0.5).astype(np.float32)


@lru_cache(maxsize=1)
def surface_atlas() -> Image:
    """All surfaces, one a row, their mip levels side by side: own RGB, and the gain of the base colour (128: 1)."""
    rows = []
    for name, paint in _SURFACES.items():
        generator = make_generator("surface", name)
        tile = np.tile(np.array(_base(1.0), dtype=np.float32), (TILE, TILE, 1))
        paint(tile, generator)
        tile *= (1.0 + 0.06 * generator.standard_normal((TILE, TILE, 1))).astype(np.float32)
        rows.append(_mip_row(np.clip(tile * (1.0, 1.0, 1.0, 128.0), 0.0, 255.0).astype(np.uint8)))
    return np.concatenate(rows)


def _mip_row(tile: Image) -> Image:
    levels = [cv2.resize(tile, (TILE >> i, TILE >> i), interpolation=cv2.INTER_AREA) for i in range(TILE_LEVELS)]
    padded = [
        cv2.copyMakeBorder(level, _PADDING, _PADDING, _PADDING, _PADDING, cv2.BORDER_REPLICATE) for level in levels
    ]
    row = np.zeros((_ROW_HEIGHT, sum(level.shape[1] for level in padded), 4), dtype=np.uint8)
    left = 0
    for level in padded:
        row[: len(level), left : left + len(level)] = level
        left += len(level)
    return row


def sample_surfaces(surface: NDArray[np.int32], u: FloatImage, v: FloatImage, texels: FloatImage) -> Image:
    """Texels (n, 4) of the atlas.

    Args:
        surface: (n,) index of the surface.
        u, v: (n,) place on it in 0 ... 1, v downwards.
        texels: (n,) size of a pixel on the surface in texels of the finest level.
    """
    level = np.clip(np.log2(np.maximum(texels, 1.0)) + 0.5, 0, TILE_LEVELS - 1).astype(np.int32)
    size = np.take(_LEVEL_SIZES, level)
    x = np.take(_LEVEL_LEFT, level) + u * size
    y = (surface * _ROW_HEIGHT).astype(np.float32) + v * size + np.float32(_PADDING - 0.5)
    return sample(surface_atlas(), _as_picture(x), _as_picture(y)).reshape(-1, 4)[: len(u)]


def _as_picture(values: FloatImage) -> FloatImage:
    """Values (n,) as rows of 512, the last one filled up: `cv2.remap` takes no rows longer than 32766."""
    return np.resize(values, (max(1, -(-len(values) // 512)), 512))


def noise_spread(layer: int, footprint: Array | FloatImage) -> FloatImage:
    """How much of a noise layer a pixel of the given size (metres) still resolves: 1 fine, 0 averaged away."""
    return np.clip(1.6 - footprint / (2.5 * NOISE_LAYERS[layer][0]), 0.0, 1.0).astype(np.float32)
