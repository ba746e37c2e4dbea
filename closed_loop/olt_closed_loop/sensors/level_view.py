"""What a camera sees of the ground and the sky, in axes that are level and turned as the camera looks.

In these axes the rays of a camera on a level road stay the same while the vehicle drives and turns: where they meet the
ground, how large a pixel is there and how much haze lies before it are worked out once (`LevelView`), and each picture
only moves and turns the places (`Stand`).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.sensors.camera_rays import CameraRays, Squares
from olt_closed_loop.sensors.terrain import FARTHEST, GroundHits
from olt_closed_loop.sensors.textures import NOISE_LAYERS, FloatImage, noise_spread, sample_pairs
from olt_generator.poses import Array, make_pose

COLUMNS = 512
"""Ground and sky are lists of pixels in rows of so many: `cv2.remap` takes none longer than 32766."""

# Rotations and heights that differ by less are the same, so that a view can be kept: 0.01 mm at 100 m.
_DECIMALS = 7


@dataclass(frozen=True)
class Stand:
    """Where a camera stands: its place (3,) in the world, its heading in radians, and the rest of its turn (3, 3).

    Level axes have their origin in the camera, z up, and x the way that it looks, the heading.
    """

    position: Array
    heading: float
    R_level_camera: Array

    @classmethod
    def of(cls, T_world_camera: Array) -> "Stand":
        """That of a camera at pose (4, 4)."""
        heading = float(np.arctan2(T_world_camera[1, 2], T_world_camera[0, 2]))
        turn = _about_z(-heading) @ T_world_camera[:3, :3]
        return cls(T_world_camera[:3, 3], heading, np.round(turn, _DECIMALS) + 0.0)

    @property
    def T_level_world(self) -> Array:  # noqa: N802
        """The pose (4, 4) of the world in level axes."""
        return make_pose(self.R_level_world, -self.R_level_world @ self.position)

    @cached_property
    def R_world_level(self) -> Array:  # noqa: N802
        """The turn (3, 3) of level axes in the world."""
        return _about_z(self.heading)

    @cached_property
    def R_level_world(self) -> Array:  # noqa: N802
        """The turn (3, 3) of the world in level axes."""
        return _about_z(-self.heading)

    def level(self, vectors: Array) -> Array:
        """Vectors (..., 3) of the world, or columns of a matrix (3, 3), in level axes."""
        return self.R_level_world @ vectors

    def affine(self, origin: Array, resolution: float) -> Array:
        """Matrix (2, 3) from level x and y to x and y of the world from `origin` (2,), in steps of `resolution`."""
        matrix = np.empty((2, 3))
        matrix[:, :2] = self.R_world_level[:2, :2] / resolution
        matrix[:, 2] = (self.position[:2] - origin) / resolution
        return matrix


@dataclass(frozen=True)
class GroundPixels:
    """The pixels that show ground, those of which the finest grain is seen first, in rows; all metres.

    Attributes:
        rays: (3, r, 512) unit rays in level axes.
        away: (r, 512) distance along the ray.
        place: (r, 512, 2) level x and y.
        across: (r, 512) size of the pixel square to the ray.
        sine: (r, 512) sine of the angle between ray and ground.
        clear: (r, 512) share of what is seen that comes through the haze.
        noise: for each of `textures.NOISE_LAYERS` how much of it is resolved (m, 512) in the first m rows.
    """

    rays: FloatImage
    away: FloatImage
    place: FloatImage
    across: FloatImage
    sine: FloatImage
    clear: FloatImage
    noise: tuple[FloatImage, ...]


@dataclass(frozen=True)
class LevelView:
    """The rays of a camera in level axes.

    Attributes:
        camera_rays: with the squares' mean rays in level axes.
        rays: (3, b, p) those of the finest squares.
        distance: (n,) metres from each pixel to the ground, inf for sky.
        ground: the pixels that show ground.
        sky: (s, 512, 2) directions of those that show sky, as `sky.Sky` takes them.
        order: (h, w, 2) int16, the column and row of each pixel in the rows of ground with those of sky below.
    """

    camera_rays: CameraRays
    rays: FloatImage
    distance: FloatImage
    ground: GroundPixels
    sky: FloatImage
    order: NDArray[np.int16]

    def image(self, ground: NDArray, sky: NDArray) -> NDArray:
        """The image (h, w, ...) of values (r, 512, ...) of ground and (s, 512, ...) of sky."""
        return sample_pairs(np.concatenate([ground, sky]), self.order, cv2.INTER_NEAREST)

    def upwards(self) -> "LevelView":
        """The same rays, turned upwards where they fall: those of a camera below the road that looks through it."""
        turn = np.array([1.0, 1.0, -1.0], dtype=np.float32)[:, None]
        squares = tuple(replace(level, middle=level.middle * turn) for level in self.camera_rays.squares)
        rays = np.stack([self.rays[0], self.rays[1], np.abs(self.rays[2])])
        return replace(self, camera_rays=replace(self.camera_rays, squares=squares), rays=rays)


def rotate(rotation: Array, rays: FloatImage) -> FloatImage:
    """Rotate rays (3, ...), summed in a fixed order, so that the bytes do not depend on a BLAS and its threads."""
    x, y, z = rays
    return np.stack([a * x + b * y + c * z for a, b, c in rotation.astype(np.float32)])


def lay_out(view: CameraRays, rays: FloatImage, R_level_camera: Array, hits: GroundHits, haze: float) -> LevelView:
    """Sort the rays (3, n) of a view, given in level axes, by whether and where they meet the ground.

    `haze` is the distance in which it takes all but 1/e of what is seen.
    """
    distance = hits.distance
    meets = np.isfinite(distance)
    # OpenCV takes no empty lists: where there is no ground, the first pixel stands for it, and sky covers it.
    numbers, ground = _ground_pixels(np.flatnonzero(meets) if meets.any() else np.zeros(1, int), view, rays, hits, haze)
    above = as_rows(np.flatnonzero(~meets))
    order = np.zeros((distance.size, 2), dtype=np.int16)
    for listed, first_row in ((numbers, 0), (above, len(numbers))):
        # Backwards, so that a pixel that fills up the last row too is found at its first place.
        row, column = np.divmod(np.arange(listed.size)[::-1], COLUMNS)
        order[listed.ravel()[::-1]] = np.stack([column, row + first_row], axis=-1)
    squares = tuple(
        Squares(rotate(R_level_camera, level.middle), level.spread, level.children) for level in view.squares
    )
    return LevelView(
        camera_rays=replace(view, squares=squares),
        rays=np.take(rays, view.pixels, axis=1),
        distance=distance,
        ground=ground,
        sky=sky_places(np.take(rays, above, axis=1)),
        order=order.reshape(*view.size, 2),
    )


def sky_places(rays: FloatImage) -> FloatImage:
    """Where level rays (3, ...) lead in the stereographic projection of the upper half of all directions, (..., 2)."""
    return np.stack([rays[0], rays[1]], axis=-1) / (np.float32(1.0) + np.maximum(rays[2], np.float32(0.0)))[..., None]


def _ground_pixels(
    number: NDArray[np.intp], view: CameraRays, rays: FloatImage, hits: GroundHits, haze: float
) -> tuple[NDArray[np.intp], GroundPixels]:
    """The numbers (r, 512) of the pixels, and what is known of them."""
    away = np.minimum(hits.distance[number], np.float32(FARTHEST))
    across = away * view.angles[number]
    footprint = np.sqrt(across * hits.along(number, across))
    resolved = [noise_spread(layer, footprint) for layer in range(len(NOISE_LAYERS))]
    # Each layer is seen farther than the one before.
    layers = sum((spread > 0.0).astype(np.uint8) for spread in resolved)
    sorting = np.argsort(len(NOISE_LAYERS) - layers, kind="stable")
    rows = [as_rows(spread[sorting]) for spread in resolved]
    seen = [-(-int((spread > 0.0).sum()) // COLUMNS) for spread in resolved]
    number, away, across = (as_rows(values[sorting]) for values in (number, away, across))
    ray = np.take(rays, number, axis=1)
    pixels = GroundPixels(
        rays=ray,
        away=away,
        place=np.stack([away * ray[0], away * ray[1]], axis=-1),
        across=across,
        sine=hits.sine[number],
        clear=np.exp(away * np.float32(-1.0 / haze)),
        noise=tuple(spread[:count] for spread, count in zip(rows, seen, strict=True)),
    )
    return number, pixels


def as_rows(values: NDArray) -> NDArray:
    """Values (n, ...) in rows of 512; the last row is filled up with the first values."""
    return np.resize(values, (-(-len(values) // COLUMNS), COLUMNS, *values.shape[1:]))


def _about_z(angle: float) -> Array:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
