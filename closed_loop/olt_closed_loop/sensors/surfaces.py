"""Surfaces of boxes: tiles painted once and kept in one atlas with their mip levels, shared by all scenes."""

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.sensors.textures import FloatImage, Image, sample_list
from olt_generator.seeds import make_generator

TILE = 128
TILE_LEVELS = 6
_PADDING = 1

Paint = Callable[[FloatImage, np.random.Generator], None]
"""Draws on a tile (n, n, 4): red, green, blue of its own in 0 ... 255, and the gain of the box's base colour."""

Texel = tuple[float, float, float, float]

_TIRE: Texel = (18.0, 18.0, 20.0, 0.0)
_WINDOW: Texel = (45.0, 55.0, 66.0, 0.0)
_WHITE: Texel = (230.0, 230.0, 225.0, 0.0)
_LAMP: Texel = (255.0, 250.0, 225.0, 0.0)
_LENSES: tuple[Texel, ...] = ((255.0, 30.0, 20.0, 0.0), (255.0, 185.0, 0.0, 0.0), (10.0, 255.0, 130.0, 0.0))


def _base(gain: float) -> Texel:
    return (0.0, 0.0, 0.0, gain)


def plain(tile: FloatImage, generator: np.random.Generator) -> None:
    """The base colour with its grain."""


def building(tile: FloatImage, generator: np.random.Generator) -> None:
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


def foliage(tile: FloatImage, generator: np.random.Generator) -> None:
    """Leaves, light and dark."""
    for _ in range(420):
        x, y = generator.integers(0, TILE, 2).tolist()
        cv2.circle(tile, (x, y), int(generator.integers(2, 7)), _base(generator.uniform(0.45, 1.5)), cv2.FILLED)


def stripes(tile: FloatImage, generator: np.random.Generator) -> None:
    """Red and white slanted stripes on a barrier's board, and its feet."""
    v, u = np.mgrid[0:TILE, 0:TILE]
    tile[:] = _WHITE
    tile[(u + v) // 16 % 2 == 0] = (205.0, 35.0, 30.0, 0.0)
    tile[TILE * 3 // 4 :] = _base(0.4)


def cone(tile: FloatImage, generator: np.random.Generator) -> None:
    """Two white bands."""
    tile[20:50] = _WHITE
    tile[74:104] = _WHITE


def car_side(tile: FloatImage, generator: np.random.Generator) -> None:
    """Wheels, doors and a dark sill; the body below the windows."""
    tile[104:] = _TIRE
    for u in (24, 104):
        cv2.ellipse(tile, (u, 98), (12, 30), 0, 0, 360, _TIRE, cv2.FILLED)
        cv2.ellipse(tile, (u, 98), (6, 15), 0, 0, 360, (150.0, 150.0, 155.0, 0.0), cv2.FILLED)
    for u in (44, 66, 88):
        cv2.line(tile, (u, 4), (u, 92), _base(0.5), 1)


def car_front(tile: FloatImage, generator: np.random.Generator) -> None:
    """Lamps and grille over a dark sill."""
    tile[104:] = _TIRE
    cv2.rectangle(tile, (34, 60), (94, 92), _TIRE, cv2.FILLED)
    for u in (16, 112):
        cv2.circle(tile, (u, 45), 11, _LAMP, cv2.FILLED)


def car_rear(tile: FloatImage, generator: np.random.Generator) -> None:
    """Lamps and number plate over a dark sill."""
    tile[104:] = _TIRE
    cv2.rectangle(tile, (44, 70), (84, 86), _WHITE, cv2.FILLED)
    for u in (14, 114):
        cv2.rectangle(tile, (u - 11, 30), (u + 11, 56), (200.0, 20.0, 20.0, 0.0), cv2.FILLED)


def glass(tile: FloatImage, generator: np.random.Generator) -> None:
    """Two windows with pillars between them."""
    for left in (8, 68):
        cv2.rectangle(tile, (left, 16), (left + 52, 124), _WINDOW, cv2.FILLED)
        cv2.line(tile, (left + 10, 118), (left + 34, 24), (95.0, 105.0, 118.0, 0.0), 6)


def panels(tile: FloatImage, generator: np.random.Generator) -> None:
    """Ribs of a cargo box over dark wheels."""
    tile[:, ::16] *= 0.75
    tile[100:] = (45.0, 45.0, 48.0, 0.0)
    for u in (22, 48, 108):
        cv2.ellipse(tile, (u, 112), (8, 15), 0, 0, 360, _TIRE, cv2.FILLED)
        cv2.ellipse(tile, (u, 112), (3, 6), 0, 0, 360, (120.0, 120.0, 120.0, 0.0), cv2.FILLED)


def wheel(tile: FloatImage, generator: np.random.Generator) -> None:
    """A big spoked wheel that fills the face."""
    tile[:] = _TIRE
    cv2.circle(tile, (TILE // 2, TILE // 2), 40, (225.0, 190.0, 50.0, 0.0), cv2.FILLED)
    for angle in np.arange(0.0, 2.0 * np.pi, np.pi / 8.0):
        end = (round(64 + 60 * np.cos(angle)), round(64 + 60 * np.sin(angle)))
        cv2.line(tile, (64, 64), end, (70.0, 70.0, 70.0, 0.0), 3)


def skin(tile: FloatImage, generator: np.random.Generator) -> None:
    """A face under hair."""
    tile[:] = (205.0, 160.0, 130.0, 0.0)
    tile[: TILE // 3] = (50.0, 40.0, 35.0, 0.0)


def lamp(tile: FloatImage, generator: np.random.Generator) -> None:
    """The light of a street lamp."""
    tile[:] = (255.0, 226.0, 170.0, 0.0)


def windows(tile: FloatImage, generator: np.random.Generator) -> None:
    """A row of windows, as of a bus."""
    tile[16:112] = _WINDOW
    for left in range(0, TILE, 16):
        tile[:, left : left + 3] = _base(1.0)


def tyre(tile: FloatImage, generator: np.random.Generator) -> None:
    """A tyre with a rim that fills the face."""
    tile[:] = _TIRE
    cv2.circle(tile, (TILE // 2, TILE // 2), 34, (150.0, 150.0, 155.0, 0.0), cv2.FILLED)


def spokes(tile: FloatImage, generator: np.random.Generator) -> None:
    """The wheel of a bicycle: a tyre with light between its spokes."""
    tile[:] = (150.0, 155.0, 150.0, 0.0)
    cv2.circle(tile, (TILE // 2, TILE // 2), 56, _TIRE, 14)
    for angle in np.arange(0.0, 2.0 * np.pi, np.pi / 6.0):
        end = (round(64 + 56 * np.cos(angle)), round(64 + 56 * np.sin(angle)))
        cv2.line(tile, (64, 64), end, (90.0, 90.0, 90.0, 0.0), 2)


def stop_face(tile: FloatImage, generator: np.random.Generator) -> None:
    """A red face with a white rim and bar."""
    tile[:] = (205.0, 20.0, 25.0, 0.0)
    cv2.rectangle(tile, (4, 4), (TILE - 5, TILE - 5), _WHITE, 6)
    cv2.rectangle(tile, (24, 52), (104, 76), _WHITE, cv2.FILLED)


def go_face(tile: FloatImage, generator: np.random.Generator) -> None:
    """A green face with a white rim and disc."""
    tile[:] = (20.0, 150.0, 60.0, 0.0)
    cv2.rectangle(tile, (4, 4), (TILE - 5, TILE - 5), _WHITE, 6)
    cv2.circle(tile, (TILE // 2, TILE // 2), 28, _WHITE, cv2.FILLED)


def signal_red(tile: FloatImage, generator: np.random.Generator) -> None:
    """The face of a traffic light that shows red."""
    _signal(tile, 0)


def signal_amber(tile: FloatImage, generator: np.random.Generator) -> None:
    """The face of a traffic light that shows amber."""
    _signal(tile, 1)


def signal_green(tile: FloatImage, generator: np.random.Generator) -> None:
    """The face of a traffic light that shows green."""
    _signal(tile, 2)


def signal_off(tile: FloatImage, generator: np.random.Generator) -> None:
    """The face of a traffic light that shows nothing."""
    _signal(tile, None)


def wand(tile: FloatImage, generator: np.random.Generator) -> None:
    """The red light of a wand that directs traffic."""
    tile[:] = _LENSES[0]


def _signal(tile: FloatImage, lit: int | None) -> None:
    """Three lenses on a black backplate with a white rim; `lit` counts from the top."""
    tile[:] = (16.0, 16.0, 18.0, 0.0)
    cv2.rectangle(tile, (3, 2), (TILE - 4, TILE - 3), _WHITE, 5)
    for index, color in enumerate(_LENSES):
        shade = color if index == lit else (34.0, 34.0, 36.0, 0.0)
        cv2.ellipse(tile, (TILE // 2, 30 + 34 * index), (29, 14), 0, 0, 360, shade, cv2.FILLED)


SURFACES: tuple[Paint, ...] = (
    *(plain, building, foliage, stripes, cone, car_side, car_front, car_rear, glass, panels, wheel, skin, lamp),
    *(windows, tyre, spokes, stop_face, go_face, signal_red, signal_amber, signal_green, signal_off, wand),
)
SURFACE_INDEX: dict[str, int] = {paint.__name__: index for index, paint in enumerate(SURFACES)}

SIGNAL_SURFACES: dict[str, str] = {
    "red": "signal_red",
    "amber": "signal_amber",
    "green": "signal_green",
    "off": "signal_off",
}
"""The surface that shows a state of a traffic light."""
# Of lights that are seen by day too: the channel that they fill, the one that they leave empty, and their colour.
_SIGNAL_GLOW: dict[str, tuple[int, int, tuple[float, float, float]]] = {
    "signal_red": (0, 1, (1.0, 0.12, 0.08)),
    "wand": (0, 1, (1.0, 0.12, 0.08)),
    "signal_amber": (0, 2, (1.0, 0.7, 0.0)),
    "signal_green": (1, 0, (0.04, 1.0, 0.5)),
}

_BRIGHTNESS, _DULL, _FAINT = np.float32(4.0), np.float32(40.0), np.float32(12.0)
_ROW_HEIGHT = TILE + 2 * _PADDING
_LEVEL_SIZES = np.array([TILE >> level for level in range(TILE_LEVELS)], dtype=np.float32)
_LEVEL_LEFT = (np.cumsum(_LEVEL_SIZES + 2 * _PADDING) - _LEVEL_SIZES - _PADDING - 0.5).astype(np.float32)


@lru_cache(maxsize=1)
def surface_atlas() -> Image:
    """All surfaces, one a row, their mip levels side by side: own RGB, and the gain of the base colour (128: 1)."""
    rows = []
    for paint in SURFACES:
        generator = make_generator("surface", paint.__name__)
        tile = np.tile(np.array(_base(1.0), dtype=np.float32), (TILE, TILE, 1))
        paint(tile, generator)
        tile *= (1.0 + 0.06 * generator.standard_normal((TILE, TILE, 1))).astype(np.float32)
        finest = np.clip(tile * (1.0, 1.0, 1.0, 128.0), 0.0, 255.0).astype(np.uint8)
        row = np.zeros((_ROW_HEIGHT, int(_LEVEL_SIZES.sum()) + 2 * _PADDING * TILE_LEVELS, 4), dtype=np.uint8)
        left = 0
        for size in (TILE >> level for level in range(TILE_LEVELS)):
            level = cv2.resize(finest, (size, size), interpolation=cv2.INTER_AREA)
            padded = np.pad(level, ((_PADDING, _PADDING), (_PADDING, _PADDING), (0, 0)), mode="edge")
            row[: len(padded), left : left + len(padded)] = padded
            left += len(padded)
        rows.append(row)
    return np.concatenate(rows)


def sample_surfaces(surface: NDArray[np.int32], u: FloatImage, v: FloatImage, texels: FloatImage) -> Image:
    """Texels (n, 4) of surfaces of index (n,) at places u, v (n,) in 0 ... 1, v downwards.

    `texels` (n,) is the size of a pixel on the surface in texels of the finest level.
    """
    level = np.clip(np.log2(np.maximum(texels, 1.0)) + 0.5, 0, TILE_LEVELS - 1).astype(np.int32)
    size = np.take(_LEVEL_SIZES, level)
    x = np.take(_LEVEL_LEFT, level) + u * size
    y = (surface * _ROW_HEIGHT).astype(np.float32) + v * size + np.float32(_PADDING - 0.5)
    return sample_list(surface_atlas(), x, y)


def lamp_glow(surface: NDArray[np.int32], texture: Image) -> FloatImage:
    """Colour (n, 3) of the lamps that texels (n, 4) of surfaces of index (n,) show; 0 where there is none.

    Lamps shine brighter than the picture can show, so that those far away, which fill but a part of a texel, are seen.
    """
    glow = np.zeros((len(surface), 3), dtype=np.float32)
    white = np.isin(surface, [SURFACE_INDEX["car_front"], SURFACE_INDEX["lamp"]])
    own = texture[white, :3].astype(np.float32)
    glow[white] = _BRIGHTNESS * np.maximum(own - _DULL, 0.0)
    rear = surface == SURFACE_INDEX["car_rear"]
    own = texture[rear, :3].astype(np.float32)
    # The number plate is as red as the lamps, but not only red.
    glow[rear] = _BRIGHTNESS * np.maximum(own[:, :1] - own[:, 1:2], 0.0) * np.array([1.0, 0.12, 0.08], dtype=np.float32)
    add_signal_glow(glow, surface, texture)
    return glow


def add_signal_glow(color: FloatImage, surface: NDArray[np.int32], texture: Image) -> None:
    """Let lights that are seen by day too shine from colours (n, 3), where texels (n, 4) of surfaces (n,) show them.

    As lamps do at night, they fill a pixel of which they cover a part; their colour stays what it is.
    """
    if not (surface >= SURFACE_INDEX["signal_red"]).any():
        return
    for name, (full, empty, shade) in _SIGNAL_GLOW.items():
        own = surface == SURFACE_INDEX[name]
        lit = texture[own].astype(np.float32)
        strength = np.clip(_BRIGHTNESS * (lit[:, full] - lit[:, empty] - _FAINT), 0.0, 255.0)
        color[own] = np.maximum(color[own], strength[:, None] * np.array(shade, dtype=np.float32))
