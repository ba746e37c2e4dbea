"""The sky: a gradient, clouds and a line of far hills, infinitely far away."""

import numpy as np

from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions
from olt_closed_loop.scenes.looks import Looks
from olt_closed_loop.sensors.textures import FloatImage, Image, clouds, look_up, sample
from olt_generator.seeds import make_generator

_SIZE = 768
_HILLS = (86.0, 104.0, 100.0)
_FOG_LAYER = 60.0


class Sky:
    """The upper half of all directions as one picture.

    A direction (x, y, z) with z >= 0 is found at (x, y) / (1 + z), its stereographic projection: no seam, and the
    horizon, where detail matters, gets the most pixels.
    """

    def __init__(self, looks: Looks, conditions: Conditions = CLEAR_DAY) -> None:
        axis = np.linspace(-1.0, 1.0, _SIZE, dtype=np.float32)
        u, v = np.meshgrid(axis, axis)
        squared = np.minimum(u * u + v * v, 1.0)
        x, y, z = 2.0 * u / (1.0 + squared), 2.0 * v / (1.0 + squared), (1.0 - squared) / (1.0 + squared)
        zenith, horizon = (np.array(color, dtype=np.float32) for color in (looks.zenith, looks.horizon))
        sky = _mix(horizon, zenith, np.sqrt(z))
        sky = _mix(
            sky,
            np.array([245.0, 246.0, 248.0], dtype=np.float32),
            _cloud_cover(looks, x, y, z) * np.float32(conditions.sun_share),
        )
        sky = _mix(sky, 0.55 * horizon + 0.45 * np.array(_HILLS, dtype=np.float32), _hills(looks, x, y, z))
        if conditions.light == "low_sun":
            sky += _sun_glare(looks, x, y, z)
        if conditions.fog > 0.0:
            # A layer of fog lies before the sky, the deeper the flatter one looks.
            depth = np.float32(_FOG_LAYER / conditions.haze_distance) / np.maximum(z, np.float32(1e-3))
            sky = _mix(sky, horizon, np.float32(1.0) - np.exp(-depth))
        sky *= np.array(conditions.sky_light, dtype=np.float32)
        self._image = np.clip(sky + 0.5, 0, 255).astype(np.uint8)

    def color(self, places: FloatImage, heading: float) -> Image:
        """Colours (n, m, 3) uint8 at places (n, m, 2) of `level_view.sky_places`, in axes turned by `heading`."""
        if places.size == 0:
            return np.zeros((*places.shape[:2], 3), dtype=np.uint8)
        center = (_SIZE - 1) / 2
        cos, sin = center * np.cos(heading), center * np.sin(heading)
        return look_up(self._image, places, np.array([[cos, -sin, center], [sin, cos, center]]))


def _cloud_cover(looks: Looks, x: FloatImage, y: FloatImage, z: FloatImage) -> FloatImage:
    """Opacity of clouds on a plane above, thinner towards the horizon."""
    layer = clouds()
    size = len(layer) - 1
    shift = make_generator("sky", looks.texture_seed).uniform(0, size, 2)
    scale = 80.0 / (z + 0.25)
    column, row = (
        np.remainder(axis * scale + np.float32(start), size) for axis, start in ((x, shift[0]), (y, shift[1]))
    )
    density = sample(layer, column.astype(np.float32), row.astype(np.float32))
    threshold = 1.2 - 2.0 * looks.cloudiness
    return np.clip((density - threshold) * 0.35, 0.0, 0.8) * np.clip(z * 6.0, 0.0, 1.0)


def _hills(looks: Looks, x: FloatImage, y: FloatImage, z: FloatImage) -> FloatImage:
    """Opacity of the hills: directions below an uneven line one to four degrees high."""
    azimuth = np.arctan2(y, x)
    generator = make_generator("hills", looks.texture_seed)
    ridge = np.full_like(azimuth, 0.04)
    for waves in (2, 3, 7, 16, 37):
        ridge += np.float32(0.05 / waves) * np.sin(waves * azimuth + generator.uniform(0, 2 * np.pi)).astype(np.float32)
    return np.clip((ridge - z) * 250.0 + 0.5, 0.0, 1.0)


def _sun_glare(looks: Looks, x: FloatImage, y: FloatImage, z: FloatImage) -> FloatImage:
    """Light (n, m, 3) of a low sun and of the air around it."""
    towards = sum(axis * np.float32(part) for axis, part in zip((x, y, z), looks.sun_direction, strict=True))
    angle = np.arccos(np.clip(towards, -1.0, 1.0))
    glare = 160.0 * np.exp(-angle / 0.25) + 600.0 * np.exp(-((angle / 0.02) ** 2))
    return glare[..., None].astype(np.float32) * np.array([1.0, 0.92, 0.72], dtype=np.float32)


def _mix(first: FloatImage, second: FloatImage, share: FloatImage) -> FloatImage:
    return first + (second - first) * share[..., None]
