"""The colours of boxes where rays meet them: surface, base colour, and the light of the sun on each face."""

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.sensors.boxes import FACE_ACROSS, FACE_UP, Boxes
from olt_closed_loop.sensors.surfaces import TILE, sample_surfaces
from olt_closed_loop.sensors.textures import FloatImage
from olt_generator.poses import Array

_AMBIENT = 0.55


def color_boxes(
    boxes: Boxes, box: NDArray[np.intp], offset: FloatImage, position: Array, pixel_size: FloatImage, sun: Array
) -> FloatImage:
    """Colours (n, 3) where rays meet boxes, lit by the sun.

    Args:
        boxes: all boxes.
        box: (n,) index of the box met.
        offset: (3, n) where, relative to the camera.
        position: (3,) of the camera.
        pixel_size: (n,) metres that a pixel covers there.
        sun: (3,) direction towards the sun.
    """
    relative = (position - boxes.center).astype(np.float32)
    ahead, left, height = offset + np.take(relative, box, axis=0).T
    cos, sin = (np.take(values.astype(np.float32), box) for values in (np.cos(boxes.yaw), np.sin(boxes.yaw)))
    place = np.stack([cos * ahead + sin * left, cos * left - sin * ahead, height])
    # In the box's own axes, where it reaches from -1 to 1: the face, and the coordinates across and up that face.
    x, y, z = place * np.take((1.0 / boxes.half).astype(np.float32), box, axis=0).T
    ax, ay, az = np.abs(x), np.abs(y), np.abs(z)
    front, top = (ax >= ay) & (ax >= az), (az > ax) & (az > ay)
    behind = np.where(front, x, np.where(top, z, y)) < 0.0
    across, up = np.where(front, y, x), np.where(top, y, z)
    entry = box * 6 + 2 * np.where(front, 0, np.where(top, 2, 1)) + behind
    repeats_across, repeats_up, density, light = _face_tables(boxes, sun)
    u = (across * np.float32(0.5) + np.float32(0.5)) * np.take(repeats_across, entry)
    v = (np.float32(0.5) - up * np.float32(0.5)) * np.take(repeats_up, entry)
    texels = pixel_size * np.take(density, entry)
    texture = sample_surfaces(np.take(boxes.surface, entry), u - np.floor(u), v - np.floor(v), texels)
    gain = texture[:, 3:] * np.float32(1.0 / 128.0)
    return (texture[:, :3] + gain * np.take(boxes.color, box, axis=0)) * np.take(light, entry)[:, None]


def _face_tables(boxes: Boxes, sun: Array) -> list[FloatImage]:
    """Of every face (6 n,) each: repeats of its surface across and up, texels of that per metre, and light."""
    across, up = boxes.repeats[:, FACE_ACROSS], boxes.repeats[:, FACE_UP]
    area = 4.0 * boxes.half[:, FACE_ACROSS] * boxes.half[:, FACE_UP]
    density = TILE * np.sqrt(across * up / area)
    cos, sin = np.cos(boxes.yaw), np.sin(boxes.yaw)
    ahead, left = cos * sun[0] + sin * sun[1], cos * sun[1] - sin * sun[0]
    above = np.full_like(cos, sun[2])
    facing = np.stack([ahead, -ahead, left, -left, above, -above], axis=-1)
    light = _AMBIENT + (1.0 - _AMBIENT) * np.maximum(facing, 0.0) * 1.3
    return [values.astype(np.float32).ravel() for values in (across, up, density, light)]
