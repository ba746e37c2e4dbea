"""The ground of a scene as the renderer sees it: a map of materials, grain on top, and the shadows of boxes."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.looks import Looks
from olt_closed_loop.scenes.maps.markings import crossing_bars, line_strokes, stop_strokes
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.textures import NOISE_LAYERS, FloatImage, Image, ground_noise, noise_spread, sample
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

_SHADOW_RESOLUTION = 0.2
_SHADOW_MARGIN = 30.0
_SHADOW_DEPTH = 0.5


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
        """Pixel coordinates (n, 2) of world points (n, 2 or 3); (0, 0) is the centre of the first pixel."""
        return (points[:, :2] - self.origin) / self.resolution - 0.5

    def fill(self, outline: Array, value: int) -> None:
        """Fill the inside of an outline (n, 2 or 3) in world coordinates."""
        cv2.fillPoly(self.image, [self._fixed_point(outline)], value, cv2.LINE_AA, _SUBPIXEL_BITS)

    def draw(self, line: Array, width: float, value: int) -> None:
        """Draw a line (n, 2 or 3) of `width` metres."""
        thickness = max(1, round(width / self.resolution))
        cv2.polylines(self.image, [self._fixed_point(line)], False, value, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)

    def _fixed_point(self, points: Array) -> NDArray[np.int32]:
        return np.round(self.pixels(points) * 2**_SUBPIXEL_BITS).astype(np.int32)


class Ground:
    """Samples the colour of the ground plane z = 0."""

    def __init__(self, scene: Scene, looks: Looks) -> None:
        self._raster = draw_materials(scene)
        self._mips, self._left, self._top = _mip_atlas(self._raster.image)
        values, known = np.arange(256), [GRASS, GRAVEL, ASPHALT, PAINT]
        colors = np.array([looks.grass, looks.gravel, looks.asphalt, looks.paint])
        palette = [np.interp(values, known, channel) for channel in colors.T]
        self._palette = np.stack(palette, axis=-1).astype(np.float32)
        # How strongly the noise shows on each material.
        self._contrast = np.interp(values, known, [0.16, 0.16, 0.12, 0.04]).astype(np.float32)
        generator = make_generator("ground", looks.texture_seed)
        self._noise_offsets = generator.uniform(0.0, 1000.0, size=(len(NOISE_LAYERS), 2))

    def color(self, camera: Array, dx: FloatImage, dy: FloatImage, across: FloatImage, along: FloatImage) -> FloatImage:
        """Colours (n, m, 3), 0 ... 255, without light and haze.

        Args:
            camera: world position (3,) from which the places are counted.
            dx, dy: (n, m) places on the ground relative to the camera, metres.
            across, along: (n, m) size of the pixel on the ground, square to the ray and along it, metres.
        """
        material = self._material(camera, dx, dy, across)
        gain = 1.0 + np.take(self._contrast, material) * self._noise(camera, dx, dy, np.sqrt(across * along))
        return np.take(self._palette, material, axis=0) * gain[..., None]

    def paved(self, camera: Array, dx: FloatImage, dy: FloatImage, across: FloatImage) -> FloatImage:
        """How much of a place (n, m) is road and not grass or gravel, 0 ... 1; arguments as of `color`."""
        material = self._material(camera, dx, dy, across).astype(np.float32)
        return np.clip((material - np.float32(GRAVEL)) / np.float32(ASPHALT - GRAVEL), 0.0, 1.0)

    def _material(self, camera: Array, dx: FloatImage, dy: FloatImage, footprint: FloatImage) -> Image:
        raster = self._raster
        start = (camera[:2] - raster.origin) / raster.resolution
        # Narrow marks must survive at a distance, so the level follows the short side of the footprint.
        level = np.log2(np.maximum(footprint * np.float32(1.5 / raster.resolution), 1.0))
        level = np.minimum(level + np.float32(0.5), _LEVELS - 1).astype(np.int32)
        scale = np.take(np.float32(0.5) ** np.arange(_LEVELS, dtype=np.float32), level)
        height, width = raster.image.shape
        x = _inside(dx / np.float32(raster.resolution) + np.float32(start[0]), width) * scale - np.float32(0.5)
        y = _inside(dy / np.float32(raster.resolution) + np.float32(start[1]), height) * scale - np.float32(0.5)
        return sample(self._mips, x + np.take(self._left, level), y + np.take(self._top, level))

    def _noise(self, camera: Array, dx: FloatImage, dy: FloatImage, footprint: FloatImage) -> FloatImage:
        total = np.zeros_like(dx)
        for index, ((texel, size), layer) in enumerate(zip(NOISE_LAYERS, ground_noise(), strict=True)):
            start = np.remainder((camera[:2] + self._noise_offsets[index]) / (texel * size), 1.0)
            places = []
            for delta, offset in ((dx, start[0]), (dy, start[1])):
                turns = delta * np.float32(1.0 / (texel * size)) + np.float32(offset)
                places.append((turns - np.floor(turns)) * np.float32(size))
            total += sample(layer, places[0], places[1]) * noise_spread(index, footprint)
        return total


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


def add_shadows(shadows: Raster, corners: Array, sun: Array) -> Raster:
    """The raster with the shadows of boxes given by their corners (n, 8, 3) added, for a sun in direction (3,)."""
    raster = Raster(shadows.image.copy(), shadows.origin, shadows.resolution)
    on_ground = corners[..., :2] - corners[..., 2:] * (sun[:2] / sun[2])
    for box in on_ground.astype(np.float32):
        raster.fill(cv2.convexHull(box)[:, 0].astype(np.float64), 255)
    return raster


def sunlight(shadows: Raster, camera: Array, dx: FloatImage, dy: FloatImage) -> FloatImage:
    """Share of light (n, m) that reaches places on the ground, given relative to the camera."""
    scale = np.float32(1.0 / shadows.resolution)
    start = ((camera[:2] - shadows.origin) / shadows.resolution - 0.5).astype(np.float32)
    shade = sample(shadows.image, dx * scale + start[0], dy * scale + start[1])
    return np.float32(1.0) - shade * np.float32(_SHADOW_DEPTH / 255.0)


def _mip_atlas(image: Image) -> tuple[Image, FloatImage, FloatImage]:
    """The image and its halvings in one picture, and the left and top corner (levels,) of each."""
    height, width = image.shape
    atlas = np.zeros((height, width + width // 2), dtype=np.uint8)
    left, top = 0, 0
    corners = []
    level = image
    for index in range(_LEVELS):
        corners.append((left, top))
        atlas[top : top + level.shape[0], left : left + level.shape[1]] = level
        left, top = (width, 0) if index == 0 else (left, top + level.shape[0])
        level = cv2.resize(level, (level.shape[1] // 2, level.shape[0] // 2), interpolation=cv2.INTER_AREA)
    lefts, tops = np.array(corners, dtype=np.float32).T
    return atlas, lefts, tops


def _inside(pixels: FloatImage, size: int) -> FloatImage:
    """Beyond the map lies what its outermost pixels show, which is grass."""
    return np.clip(pixels, np.float32(2**_LEVELS), np.float32(size - 2**_LEVELS))
