"""The light of lamps at night: street lights, the headlights of other vehicles, and those of the vehicle that films."""

import cv2
import numpy as np

from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scenes.conditions import Conditions
from olt_closed_loop.scenes.looks import Looks, SceneryBox
from olt_closed_loop.sensors.ground import Patch, Raster
from olt_closed_loop.sensors.level_view import Stand
from olt_closed_loop.sensors.textures import FloatImage, look_up
from olt_generator.poses import Array

# Light that falls on everything, and colours of lamps, as factors of a surface's colour by day.
_AMBIENT = np.array([0.030, 0.032, 0.042], dtype=np.float32)
_STREET_COLOR = np.array([1.0, 0.84, 0.62], dtype=np.float32)
_STREET_STRENGTH, _POOL_RADIUS = 0.55, 15.0
_LAMP_SIZE = (0.7, 0.3, 0.15)
# Headlights of others: metres from the nose, half width and strength, from the rim of the pool to its heart.
_POOLS = ((20.0, 3.6, 40), (15.0, 2.9, 80), (10.0, 2.1, 130))
_BEAM_STRENGTH, _BEAM_REACH, _BEAM_WIDTH = 1.15, 17.0, 0.5
# Sine of the angle below the horizon at which a dipped beam is cut off, how sharply, and what is left above.
_CUT, _CUT_WIDTH, _STRAY = 0.012, 0.012, 0.05


def hang_street_lights(looks: Looks) -> tuple[SceneryBox, ...]:
    """The lamps on the poles."""
    return tuple(
        SceneryBox("street_light", (box.center[0], box.center[1], box.size[2]), _LAMP_SIZE, box.yaw, box.color)
        for box in looks.scenery
        if box.kind == "pole"
    )


def light_street(empty: Raster, looks: Looks, conditions: Conditions) -> Raster:
    """Pools of light below the street lights, on a raster like `empty`: 255 is the heart of a pool."""
    raster = Raster(np.zeros_like(empty.image), empty.origin, empty.resolution)
    if not conditions.street_lights:
        return raster
    reach = round(_POOL_RADIUS / raster.resolution)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] / reach
    pool = np.round(255.0 * np.maximum(1.0 - np.hypot(x, y), 0.0) ** 1.5).astype(np.uint8)
    padded = np.pad(raster.image, reach)
    for box in looks.scenery:
        if box.kind == "pole":
            column, row = np.round(raster.pixels(np.array([box.center]))[0]).astype(int).tolist()
            if 0 <= row < raster.image.shape[0] and 0 <= column < raster.image.shape[1]:
                place = padded[row : row + 2 * reach + 1, column : column + 2 * reach + 1]
                cv2.max(place, pool, place)
    raster.image[:] = padded[reach:-reach, reach:-reach]
    return raster


def shine_headlights(beams: Raster, poses: Array, lengths: Array) -> list[Patch]:
    """Draw what headlights of vehicles at poses (n, 4) x, y, z, yaw, so long (n,), throw on the road; returns where."""
    patches = []
    for reach, half_width, strength in _POOLS:
        for pose, length in zip(poses, lengths, strict=True):
            ahead = pose.copy()
            ahead[:2] += (length + reach) / 2 * np.array([np.cos(pose[3]), np.sin(pose[3])])
            front_left, rear_left, rear_right, front_right = corners(
                ahead, np.array([reach, 2.0 * half_width, 0.0]) / 2
            )
            near = 0.3 * (rear_left - rear_right)
            middle = (rear_left + rear_right) / 2
            pool = np.stack([front_left, middle + near, middle - near, front_right])
            beams.fill(pool, strength)
            patches.append(beams.patch(beams.fixed_point(pool)))
    return patches


def lamp_light(lamps: Raster, places: FloatImage, stand: Stand) -> list[FloatImage]:
    """Red, green and blue light (n, m) each of ambience and lamps at level places (n, m, 2) on the ground."""
    strength = look_up(lamps.image, places, lamps.affine(stand)).astype(np.float32)
    strength *= np.float32(_STREET_STRENGTH / 255.0)
    return [ambient + strength * color for ambient, color in zip(_AMBIENT, _STREET_COLOR, strict=True)]


def own_headlights(R_level_rig: Array, rays: FloatImage, distance: FloatImage) -> FloatImage:
    """Light (...) of the own dipped beam where level rays (3, ...) end after a distance (...)."""
    turn = R_level_rig.astype(np.float32)
    x, y, z = rays
    ahead, left, up = (a * x + b * y + c * z for a, b, c in turn.T)
    aside = left / np.maximum(ahead, np.float32(1e-3)) / np.float32(_BEAM_WIDTH)
    below = np.float32(1.0) / (np.float32(1.0) + np.exp(np.clip((up + _CUT) / _CUT_WIDTH, -30.0, 30.0)))
    reach = distance * np.float32(1.0 / _BEAM_REACH)
    strength = np.exp(-aside * aside) * (_STRAY + (1.0 - _STRAY) * below) / (1.0 + reach * reach)
    return np.where(ahead > 0.0, np.float32(_BEAM_STRENGTH) * strength, np.float32(0.0)).astype(np.float32)
