"""The light of a scene: the sun and its shadows by day, lamps by night."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from olt_closed_loop.scenes.conditions import Conditions
from olt_closed_loop.scenes.looks import Looks
from olt_closed_loop.scenes.scene import Agent, Hills, Scene
from olt_closed_loop.sensors.boxes import Boxes, Paint
from olt_closed_loop.sensors.ground import Patch, cast_shadows, empty_shadows, sunlight
from olt_closed_loop.sensors.lamps import lamp_light, light_street, own_headlights, shine_headlights
from olt_closed_loop.sensors.level_view import GroundPixels, Stand, as_rows
from olt_closed_loop.sensors.surfaces import add_signal_glow, lamp_glow
from olt_closed_loop.sensors.textures import FloatImage
from olt_generator.poses import Array

_MOTOR_VEHICLES = ("automobile", "heavy_truck", "bus", "train_or_tram_car", "other_vehicle")


class Illumination(Protocol):
    """Lights colours as they would be in plain daylight; rays and places are those of level axes, in metres.

    `face_sun` (3,) is the direction in the world of the light that shades the faces of boxes, as long as it is strong.
    `R_level_rig` (3, 3) is the turn of the vehicle that films, None for a camera on none.
    """

    face_sun: Array

    def show(self, boxes: Boxes, moving: Sequence[tuple[Agent, Array]]) -> None:
        """Take note of boxes that change, and of agents that move, with their poses (4,)."""
        ...

    def on_ground(self, pixels: GroundPixels, stand: Stand, R_level_rig: Array | None) -> list[FloatImage | None]:
        """The light (r, 512) on ground for red, green and blue; None where all of it is there."""
        ...

    def on_boxes(
        self, paint: Paint, rays: FloatImage, distance: FloatImage, stand: Stand, R_level_rig: Array | None
    ) -> FloatImage:
        """Colours (n, 3) of boxes, lit, where rays (3, n) end after distances (n,)."""
        ...


class Daylight:
    """A sun that casts shadows, weaker where clouds hide it."""

    def __init__(self, scene: Scene, looks: Looks, conditions: Conditions, fixed: Boxes) -> None:
        self._sun, self._share, self._hills = np.array(looks.sun_direction), conditions.sun_share, scene.hills
        self.face_sun = self._share * self._sun + (1.0 - self._share) * np.array([0.0, 0.0, 0.5])
        self._shadows = empty_shadows(scene)
        cast_shadows(self._shadows, self._corners(fixed), self._sun)
        self._fixed = self._shadows.image.copy()
        self._changed: list[Patch] = []

    def show(self, boxes: Boxes, moving: Sequence[tuple[Agent, Array]]) -> None:
        """See `Illumination`: the shadows of boxes."""
        for patch in self._changed:
            self._shadows.image[patch] = self._fixed[patch]
        self._changed = cast_shadows(self._shadows, self._corners(boxes), self._sun)

    def on_ground(self, pixels: GroundPixels, stand: Stand, R_level_rig: Array | None) -> list[FloatImage | None]:
        """See `Illumination`."""
        if self._share == 0.0:
            return [None, None, None]
        light = sunlight(self._shadows, pixels.place, stand)
        if self._share < 1.0:
            light = np.float32(1.0) - np.float32(self._share) * (np.float32(1.0) - light)
        return [light, light, light]

    def on_boxes(
        self, paint: Paint, rays: FloatImage, distance: FloatImage, stand: Stand, R_level_rig: Array | None
    ) -> FloatImage:
        """See `Illumination`."""
        color = paint.color * paint.light[:, None]
        add_signal_glow(color, paint.surface, paint.texture)
        return color

    def _corners(self, boxes: Boxes) -> Array:
        """Corners (n, 8, 3), their height that above the ground under the box."""
        corners = boxes.corners()
        if self._hills is not None:
            corners[..., 2] -= self._hills.height(boxes.center)[:, None]
        return corners


class LampLight:
    """A night: street lights, headlights of others on the road, and those of the vehicle that films."""

    face_sun = np.array([0.0, 0.0, 1.0])

    def __init__(self, scene: Scene, looks: Looks, conditions: Conditions) -> None:
        self._lamps = light_street(empty_shadows(scene), looks, conditions)
        self._street, self._beams = self._lamps.image.copy(), empty_shadows(scene)
        self._changed: list[Patch] = []
        # Water throws the light of one's own lamps on, away from the eye.
        self._wet = np.float32(1.0 - 0.5 * conditions.rain)

    def show(self, boxes: Boxes, moving: Sequence[tuple[Agent, Array]]) -> None:
        """See `Illumination`: the headlights of agents that move."""
        cars = [(agent.length, pose) for agent, pose in moving if agent.label in _MOTOR_VEHICLES]
        poses = np.array([pose for _, pose in cars]).reshape(-1, 4)
        for patch in self._changed:
            self._lamps.image[patch] = self._street[patch]
            self._beams.image[patch] = 0
        self._changed = shine_headlights(self._beams, poses, np.array([length for length, _ in cars]))
        for patch in self._changed:
            self._lamps.image[patch] = np.maximum(self._street[patch], self._beams.image[patch])

    def on_ground(self, pixels: GroundPixels, stand: Stand, R_level_rig: Array | None) -> list[FloatImage | None]:
        """See `Illumination`."""
        light = lamp_light(self._lamps, pixels.place, stand)
        if R_level_rig is not None:
            own = self._wet * own_headlights(R_level_rig, pixels.rays, pixels.away)
            light = [share + own for share in light]
        return list(light)

    def on_boxes(
        self, paint: Paint, rays: FloatImage, distance: FloatImage, stand: Stand, R_level_rig: Array | None
    ) -> FloatImage:
        """See `Illumination`: what the ground below has of street lights lights boxes, too."""
        places = as_rows((rays[:2] * distance).T)
        light = np.stack(lamp_light(self._lamps, places, stand), axis=-1).reshape(-1, 3)[: len(distance)]
        light *= paint.light[:, None]
        if R_level_rig is not None:
            light += own_headlights(R_level_rig, rays, distance)[:, None]
        return paint.color * light + lamp_glow(paint.surface, paint.texture)


def illuminate(scene: Scene, looks: Looks, conditions: Conditions, fixed: Boxes) -> Illumination:
    """The light of a scene whose boxes `fixed` never move."""
    if conditions.light == "night":
        return LampLight(scene, looks, conditions)
    return Daylight(scene, looks, conditions, fixed)


def sink_into_hills(boxes: Boxes, hills: Hills) -> Boxes:
    """Boxes of level ground put on hills, deep enough that none floats at its lower side."""
    radius = np.hypot(boxes.half[:, 0], boxes.half[:, 1])
    across = np.array([np.cos(hills.direction), np.sin(hills.direction)])
    ends = (hills.height(boxes.center[:, :2] + side * radius[:, None] * across) for side in (-1.0, 0.0, 1.0))
    center = boxes.center.copy()
    center[:, 2] += np.min(list(ends), axis=0)
    return replace(boxes, center=center)
