"""The ground of a scene as the renderer sees it: a map of materials, grain on top, and the shadows of boxes."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.looks import Looks
from olt_closed_loop.scenes.maps.markings import crossing_bars, line_strokes, stop_strokes
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.level_view import GroundPixels, Stand
from olt_closed_loop.sensors.textures import NOISE_LAYERS, FloatImage, Image, ground_noise, look_up, sample_pairs
from olt_generator.poses import Array
from olt_generator.seeds import make_generator

# Values of the material map. What lies between two of them is a blend of both, which is what a borderline looks like.
GRASS, GRAVEL, ASPHALT, PAINT = 0, 64, 128, 255
SIDEWALK, KERB = 165, 205
"""Slabs and kerb stones, paler than asphalt and darker than paint."""

_RESOLUTION = 0.05
_LARGEST_MAP = 12_000
_MARGIN = 6.0
_LEVELS = 6
_KERB_WIDTH = 0.5
_SUBPIXEL_BITS = 4
# By how many pixels the smoothed edge of what is drawn reaches over it.
_BLUR = 2

# Of a place in the map, its level's first row is added to the row, and half a pixel taken off both.
_TOP_AND_HALF = np.array([[0.0, -0.5], [1.0, -0.5]])

_SHADOW_RESOLUTION = 0.2
_SHADOW_MARGIN = 30.0
_SHADOW_DEPTH = 0.5


Patch = tuple[slice, slice]
"""Rows and columns of a part of an image."""


@dataclass(frozen=True)
class Raster:
    """A picture of the ground seen from above, row by y and column by x.

    Attributes:
        image: (H, W) uint8.
        origin: world (x, y) of the image's lower left corner.
        resolution: metres per pixel.
    """

    image: Image
    origin: Array
    resolution: float

    @classmethod
    def covering(cls, points: Array, margin: float, resolution: float) -> "Raster":
        """An empty raster around points (n, 2 or 3); coarser than asked for where the area is very large."""
        low, high = points[:, :2].min(axis=0) - margin, points[:, :2].max(axis=0) + margin
        resolution = max(resolution, float((high - low).max()) / _LARGEST_MAP)
        blocks = np.ceil((high - low) / resolution / 2**_LEVELS).astype(int)
        width, height = (blocks * 2**_LEVELS).tolist()
        return cls(np.zeros((height, width), dtype=np.uint8), low, resolution)

    def pixels(self, points: Array) -> Array:
        """Pixel coordinates (..., 2) of world points (..., 2 or 3); (0, 0) is the centre of the first pixel."""
        return (points[..., :2] - self.origin) / self.resolution - 0.5

    def affine(self, stand: Stand) -> Array:
        """Matrix (2, 3) from level places, metres, to pixel coordinates."""
        matrix = stand.affine(self.origin, self.resolution)
        matrix[:, 2] -= 0.5
        return matrix

    def fill(self, outline: Array, value: int) -> None:
        """Fill the inside of an outline (n, 2 or 3) in world coordinates."""
        cv2.fillPoly(self.image, [self.fixed_point(outline)], value, cv2.LINE_AA, _SUBPIXEL_BITS)

    def draw(self, line: Array, width: float, value: int) -> None:
        """Draw a line (n, 2 or 3) of `width` metres."""
        thickness = max(1, round(width / self.resolution))
        cv2.polylines(self.image, [self.fixed_point(line)], False, value, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)

    def patch(self, outline: NDArray[np.int32]) -> Patch:
        """The part of the image that a filled outline (..., 2) of `fixed_point` changes, at least."""
        low, high = (outline.reshape(-1, 2).min(axis=0), outline.reshape(-1, 2).max(axis=0))
        (left, top), (right, bottom) = (low >> _SUBPIXEL_BITS).tolist(), (high >> _SUBPIXEL_BITS).tolist()
        rows, columns = (
            (max(first - _BLUR, 0), max(last + _BLUR + 1, 0)) for first, last in ((top, bottom), (left, right))
        )
        return slice(*rows), slice(*columns)

    def fixed_point(self, points: Array) -> NDArray[np.int32]:
        """Pixel coordinates (..., 2) of world points (..., 2 or 3) as OpenCV takes them, in sixteenths."""
        return np.round(self.pixels(points) * 2**_SUBPIXEL_BITS).astype(np.int32)


class Ground:
    """Samples the colour of the ground."""

    def __init__(self, scene: Scene, looks: Looks) -> None:
        self._raster = draw_materials(scene)
        self._mips, self._top = _mip_atlas(self._raster.image)
        values, known = np.arange(256), [GRASS, GRAVEL, ASPHALT, PAINT]
        colors = np.array([looks.grass, looks.gravel, looks.asphalt, looks.paint])
        self._palette = [np.interp(values, known, channel).astype(np.float32) for channel in colors.T]
        # How strongly the noise shows on each material.
        self._contrast = np.interp(values, known, [0.16, 0.16, 0.12, 0.04]).astype(np.float32)
        self._paved = np.interp(values, [GRAVEL, ASPHALT], [0.0, 1.0]).astype(np.float32)
        generator = make_generator("ground", looks.texture_seed)
        self._noise_offsets = generator.uniform(0.0, 1000.0, size=(len(NOISE_LAYERS), 2))

    def lay_out(self, pixels: GroundPixels) -> "MapPlaces":
        """The part of the way into the map that does not depend on where the camera stands."""
        # Narrow marks must survive at a distance, so the level follows the short side of the footprint.
        level = np.log2(np.maximum(pixels.across * np.float32(1.5 / self._raster.resolution), 1.0))
        level = np.minimum(level + np.float32(0.5), _LEVELS - 1).astype(np.int32)
        scale, top = np.take(np.float32(0.5) ** np.arange(_LEVELS, dtype=np.float32), level), np.take(self._top, level)
        height = self._raster.image.shape[0]
        scaled = np.stack([pixels.place[..., 0] * scale, pixels.place[..., 1] * scale, scale, top], axis=-1)
        # Grass surrounds the map; beyond it rows would be those of another level.
        edge = np.float32(2 ** (_LEVELS - 1))
        return MapPlaces(scaled, top + edge * scale, top + (height - edge) * scale)

    def materials(self, places: "MapPlaces", stand: Stand) -> Image:
        """Values (r, 512) of the material map."""
        turn = stand.affine(self._raster.origin, self._raster.resolution)
        found = cv2.transform(places.scaled, np.hstack([turn, _TOP_AND_HALF]))
        rows = found[..., 1]
        np.maximum(rows, places.first, out=rows)
        np.minimum(rows, places.last, out=rows)
        return sample_pairs(self._mips, found)

    def color(
        self, material: Image, pixels: GroundPixels, stand: Stand, light: Sequence[FloatImage | None]
    ) -> list[FloatImage]:
        """Red, green and blue (r, 512) each, 0 ... 255 and above, under `light` of the three; None for full light."""
        gain = cv2.LUT(material, self._contrast) * self._noise(pixels, stand)
        gain += np.float32(1.0)
        gains = [gain if share is None else gain * share for share in light]
        return [cv2.LUT(material, palette) * gain for palette, gain in zip(self._palette, gains, strict=True)]

    def paved(self, material: Image) -> FloatImage:
        """How much of a place (r, 512) of the material map is road and not grass or gravel, 0 ... 1."""
        return np.asarray(cv2.LUT(material, self._paved), np.float32)

    def _noise(self, pixels: GroundPixels, stand: Stand) -> FloatImage:
        total = np.zeros(pixels.away.shape, dtype=np.float32)
        for index, ((texel, size), layer) in enumerate(zip(NOISE_LAYERS, ground_noise(), strict=True)):
            resolved = pixels.noise[index]
            if not len(resolved):
                continue
            turn = stand.affine(-self._noise_offsets[index], texel * size)
            turn[:, 2] = np.remainder(turn[:, 2], 1.0)
            turns = cv2.transform(pixels.place[: len(resolved)], turn)
            turns -= np.floor(turns)
            turns *= np.float32(size)
            total[: len(resolved)] += sample_pairs(layer, turns) * resolved
        return total


@dataclass(frozen=True)
class MapPlaces:
    """Places in the material map: level x and y by the scale of their level, that scale, and the level's first row.

    Attributes:
        scaled: (r, 512, 4).
        first, last: (r, 512) rows between which the level's map lies.
    """

    scaled: FloatImage
    first: FloatImage
    last: FloatImage


def draw_materials(scene: Scene) -> Raster:
    """The material map: pavement inside the drivable outlines (or the lanes, where there are none) and the markings."""
    surfaces = scene.drivable or tuple(np.concatenate([lane.left, lane.right[::-1]]) for lane in scene.lanes)
    raster = Raster.covering(np.concatenate([*surfaces, scene.ego.positions]), _MARGIN, _RESOLUTION)
    for outline in surfaces:
        closed = np.concatenate([outline, outline[:1]])
        raster.draw(closed, 2.0 * _KERB_WIDTH, GRAVEL)
    for outline in surfaces:
        raster.fill(outline, ASPHALT)
    _paint(raster, scene)
    return raster


def _paint(raster: Raster, scene: Scene) -> None:
    """Sidewalks, and what is painted on the road; seams between outlines are filled where lanes are known to be."""
    for lane in scene.lanes:
        if lane.type is not None:
            outline = np.concatenate([lane.left, lane.right[::-1]])
            raster.fill(outline, SIDEWALK if lane.type == "sidewalk" else ASPHALT)
    for bar in crossing_bars(scene.crossings):
        raster.fill(bar, PAINT)
    for stroke in (*line_strokes(scene.lanes), *stop_strokes(scene.stop_lines)):
        value = KERB if stroke.kerb else round(PAINT - stroke.wear * (PAINT - ASPHALT))
        raster.draw(stroke.line, stroke.width, value)


def empty_shadows(scene: Scene) -> Raster:
    """A raster of the scene without shadows: 0 is sunlit, 255 is shaded."""
    surfaces = [*scene.drivable, *(lane.center for lane in scene.lanes), scene.ego.positions]
    return Raster.covering(np.concatenate(surfaces), _SHADOW_MARGIN, _SHADOW_RESOLUTION)


def cast_shadows(shadows: Raster, corners: Array, sun: Array) -> list[Patch]:
    """Draw the shadows of boxes given by their corners (n, 8, 3), for a sun in direction (3,); returns where."""
    on_ground = corners[..., :2] - corners[..., 2:] * (sun[:2] / sun[2])
    hulls = [cv2.convexHull(box) for box in shadows.fixed_point(on_ground)]
    for hull in hulls:
        cv2.fillConvexPoly(shadows.image, hull, 255, cv2.LINE_AA, _SUBPIXEL_BITS)
    return [shadows.patch(hull) for hull in hulls]


def sunlight(shadows: Raster, places: FloatImage, stand: Stand) -> FloatImage:
    """Share of light (n, m) that reaches level places (n, m, 2) on the ground."""
    shade = look_up(shadows.image, places, shadows.affine(stand)).astype(np.float32)
    shade *= np.float32(-_SHADOW_DEPTH / 255.0)
    shade += np.float32(1.0)
    return shade


def _mip_atlas(image: Image) -> tuple[Image, FloatImage]:
    """The image and its halvings, one below the other, and the first row (levels,) of each."""
    levels = [image]
    for _ in range(1, _LEVELS):
        height, width = levels[-1].shape
        half = cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(half, np.uint8))
    tops = np.cumsum([0, *(len(level) for level in levels[:-1])])
    atlas = np.zeros((sum(len(level) for level in levels), image.shape[1]), dtype=np.uint8)
    for top, level in zip(tops.tolist(), levels, strict=True):
        atlas[top : top + len(level), : level.shape[1]] = level
    return atlas, tops.astype(np.float32)
