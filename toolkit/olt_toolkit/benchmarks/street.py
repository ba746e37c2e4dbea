"""A made-up street that can be ray-cast exactly: what warps and distance estimates are measured on.

World frame: x along the street, y to the left, z up, the road is z = 0. All lengths are metres.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.poses import Array
from olt_generator.seeds import make_generator


@dataclass(frozen=True)
class Box:
    """An upright block from corner `low` (3) to corner `high` (3), painted in one base colour (3)."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    colour: tuple[int, int, int]


# Two rows of houses, parked cars on both sides and a truck ahead.
BOXES = (
    Box((-30.0, 11.0, 0.0), (28.0, 30.0, 12.0), (150, 110, 90)),
    Box((34.0, 10.0, 0.0), (120.0, 30.0, 9.0), (120, 125, 140)),
    Box((-30.0, -32.0, 0.0), (14.0, -12.0, 10.0), (135, 130, 100)),
    Box((20.0, -32.0, 0.0), (120.0, -10.0, 15.0), (110, 90, 95)),
    Box((7.0, 4.2, 0.0), (11.4, 6.0, 1.5), (60, 70, 130)),
    Box((15.0, 4.1, 0.0), (19.6, 5.9, 1.6), (150, 50, 50)),
    Box((9.0, -6.4, 0.0), (13.5, -4.6, 1.5), (70, 120, 70)),
    Box((24.0, -6.8, 0.0), (31.0, -4.4, 3.2), (170, 170, 160)),
    Box((45.0, 1.0, 0.0), (53.0, 3.4, 3.4), (160, 140, 60)),
)
ROAD_COLOUR = (105, 105, 108)
SKY_COLOUR = (150, 185, 225)


def render_street(
    camera: Camera, T_world_camera: Array, boxes: tuple[Box, ...] = BOXES
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Image (H, W, 3) and distance (H, W) along each pixel's ray in metres, inf for the sky; exact at pixel centres."""
    directions = pixel_rays(camera) @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
    down = -directions[..., 2]
    distance = np.where(down > 1e-6, origin[2] / np.maximum(down, 1e-6), np.inf)
    colour = np.broadcast_to(np.array(ROAD_COLOUR, np.float64), directions.shape).copy()
    for box in boxes:
        hit = _distance_to_box(origin, directions, box)
        colour[hit < distance] = box.colour
        distance = np.minimum(distance, hit)
    sky = ~np.isfinite(distance)
    points = origin + directions * np.where(sky, 0.0, distance)[..., None]
    # A pattern finer than two pixels would alias: it is faded out with the width of a pixel on the surface.
    neighbours = np.array([[0.5 * camera.width, 0.5 * camera.height], [0.5 * camera.width + 1.0, 0.5 * camera.height]])
    pixel_width = np.where(sky, 0.0, distance) * float(np.linalg.norm(np.diff(camera.rays(neighbours), axis=0)))
    image = colour + 30.0 * _pattern(points, pixel_width)[..., None]
    image[sky] = SKY_COLOUR
    return np.clip(image, 0.0, 255.0).astype(np.uint8), distance.astype(np.float32)


def _distance_to_box(origin: Array, directions: Array, box: Box) -> Array:
    """Distance to the near face, inf where the ray misses (slab method)."""
    safe = np.where(np.abs(directions) < 1e-12, 1e-12, directions)
    to_low, to_high = (np.array(box.low) - origin) / safe, (np.array(box.high) - origin) / safe
    enter = np.minimum(to_low, to_high).max(axis=-1)
    leave = np.maximum(to_low, to_high).min(axis=-1)
    return np.where((enter <= leave) & (enter > 0.0), enter, np.inf)


def _pattern(points: Array, pixel_width: Array) -> Array:
    """Sum (...) of plane waves at points (..., 3), 0.1 to 6 m long, their amplitude rising with length, rms 1."""
    random = make_generator("street pattern")
    total = np.zeros(points.shape[:-1])
    for wavelength in np.geomspace(0.1, 6.0, 14):
        direction = random.normal(size=3)
        wave_vector = 2.0 * np.pi / wavelength * direction / np.linalg.norm(direction)
        fading = np.exp(-((2.0 * pixel_width / wavelength) ** 2))
        amplitude = 0.5 * np.sqrt(wavelength)
        total += amplitude * fading * np.sin(points @ wave_vector + random.uniform(0.0, 2.0 * np.pi))
    return total
