"""Camera images of a scene by ray casting, exact for every camera model: one ray through the centre of each pixel."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.actors import agent_poses
from olt_closed_loop.scenes.looks import Looks, generate_looks
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.sensors.boxes import FACE_ACROSS, FACE_UP, Boxes, body_boxes, scenery_boxes
from olt_closed_loop.sensors.casting import CHUNK, Hits, boxes_in_view, cast
from olt_closed_loop.sensors.ground import Ground, Raster, add_shadows, empty_shadows, sunlight
from olt_closed_loop.sensors.sky import Sky
from olt_closed_loop.sensors.textures import TILE, FloatImage, Image, sample_surfaces
from olt_closed_loop.sensors.views import View, view_of
from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import Rig

_HAZE_DISTANCE = 700.0
_AMBIENT = 0.55
_FARTHEST_GROUND = 1e5


@dataclass(frozen=True)
class Rendering:
    """An image: rgb (H, W, 3) uint8, and distance (H, W) float32 in metres along each pixel's ray, inf for sky."""

    rgb: Image
    distance: NDArray[np.float32]


@dataclass(frozen=True)
class _Moment:
    """What stands in the scene at one time, and the shadows on its ground."""

    time_us: int
    boxes: Boxes
    shadows: Raster


@dataclass(frozen=True)
class _Shot:
    """One picture in the making: where the camera is, its rays (3, b, p) in the world, and what stands around it."""

    position: Array
    rays: FloatImage
    view: View
    boxes: Boxes
    shadows: Raster


class SceneRenderer:
    """Renders one scene. Its looks are read from the scene's stage where it has one, and invented where not."""

    def __init__(self, scene: Scene) -> None:
        self.looks = _load_looks(scene)
        self._sun = np.array(self.looks.sun_direction)
        self._ground = Ground(scene, self.looks)
        self._sky = Sky(self.looks)
        self._horizon = np.array(self.looks.horizon, dtype=np.float32)
        bodies = [(agent, body_boxes(agent, self.looks.agent_colors[agent.id])) for agent in scene.agents]
        end_us = int(scene.ego.timestamps_us[-1])
        fixed = [_pose_body(agent, body, 0) for agent, body in bodies if _always_stands(agent, end_us)]
        self._changing = [(agent, body) for agent, body in bodies if not _always_stands(agent, end_us)]
        self._fixed = Boxes.concatenate([scenery_boxes(self.looks), *fixed])
        self._fixed_shadows = add_shadows(empty_shadows(scene), self._fixed.corners(), self._sun)
        self._moment: _Moment | None = None

    def render(self, camera: Camera, T_world_camera: Array, time_us: int) -> Rendering:
        """Take one picture.

        Args:
            camera: any camera model.
            T_world_camera: (4, 4) pose of the camera.
            time_us: time in the recording at which the agents are shown.
        """
        view, moment = view_of(camera), self._at(time_us)
        position, rotation = T_world_camera[:3, 3], T_world_camera[:3, :3].astype(np.float32)
        rays = _rotate(rotation, view.rays)
        boxes = boxes_in_view(moment.boxes, position, T_world_camera[:3, 2], view)
        shot = _Shot(position, rays, view, boxes, moment.shadows)

        distance = _ground_distance(position, rays[2])
        hits = _before(cast(boxes, position, rays, _rotate(rotation, view.middle), view.spread), distance)
        rgb = np.empty((*distance.shape, 3), dtype=np.uint8)
        sky = np.isinf(distance)
        self._color_sky(rgb, shot, sky)
        self._color_ground(rgb, shot, distance, ~sky)
        self._color_boxes(rgb, shot, hits)
        distance[hits.block, hits.pixel] = hits.distance
        return Rendering(view.image(rgb), view.image(distance))

    def _at(self, time_us: int) -> _Moment:
        """The moment at `time_us`; the cameras of a rig ask for the same one in a row."""
        if self._moment is None or self._moment.time_us != time_us:
            present = [_pose_body(agent, body, time_us) for agent, body in self._changing if _exists(agent, time_us)]
            boxes = Boxes.concatenate([self._fixed, *present])
            changing = boxes.corners()[len(self._fixed) :]
            self._moment = _Moment(time_us, boxes, add_shadows(self._fixed_shadows, changing, self._sun))
        return self._moment

    def _color_sky(self, rgb: Image, shot: _Shot, sky: NDArray[np.bool_]) -> None:
        blocks = np.nonzero(sky.any(axis=1))[0]
        if len(blocks):
            x, y, z = shot.rays[:, blocks]
            rgb[blocks] = self._sky.color((x, y, z))

    def _color_ground(self, rgb: Image, shot: _Shot, distance: FloatImage, ground: NDArray[np.bool_]) -> None:
        blocks = np.nonzero(ground.any(axis=1))[0]
        for start in range(0, len(blocks), CHUNK):
            self._color_ground_blocks(rgb, shot, distance, ground, blocks[start : start + CHUNK])

    def _color_ground_blocks(
        self, rgb: Image, shot: _Shot, distance: FloatImage, ground: NDArray[np.bool_], blocks: NDArray[np.intp]
    ) -> None:
        x, y, _ = shot.rays[:, blocks]
        away = np.minimum(distance[blocks], np.float32(_FARTHEST_GROUND))
        across = away * shot.view.angles[blocks]
        along = across * away / np.float32(max(shot.position[2], 0.1))
        dx, dy = away * x, away * y
        color = self._ground.color(shot.position, dx, dy, across, along)
        color *= sunlight(shot.shadows, shot.position, dx, dy)[..., None]
        seen = rgb[blocks]
        np.copyto(seen, self._hazy(color, away), where=ground[blocks][..., None])
        rgb[blocks] = seen

    def _color_boxes(self, rgb: Image, shot: _Shot, hits: Hits) -> None:
        if len(hits.box) == 0:
            return
        ray = shot.rays[:, hits.block, hits.pixel]
        pixel_size = hits.distance * shot.view.angles[hits.block, hits.pixel]
        color = _box_color(shot.boxes, hits.box, ray * hits.distance, shot.position, pixel_size, self._sun)
        rgb[hits.block, hits.pixel] = self._hazy(color, hits.distance)

    def _hazy(self, color: FloatImage, distance: FloatImage) -> Image:
        """Blend colours (n, ..., 3) into the colour of the horizon with distance; works in place."""
        color -= self._horizon
        color *= np.exp(distance * np.float32(-1.0 / _HAZE_DISTANCE))[..., None]
        color += self._horizon + np.float32(0.5)
        return np.minimum(color, np.float32(255.0), out=color).astype(np.uint8)


def render_rig(
    renderer: SceneRenderer, rig: Rig, names: tuple[str, ...], T_world_rig: Array, time_us: int
) -> dict[str, Rendering]:
    """The pictures of some cameras of a rig, by name, taken at the same time."""
    return {name: renderer.render(rig[name].camera, T_world_rig @ rig[name].T_rig_camera, time_us) for name in names}


def _load_looks(scene: Scene) -> Looks:
    if scene.looks is None:
        return generate_looks(scene)
    from olt_closed_loop.scenes.scene_file import read_looks  # USD is loaded only for scenes that come from a stage

    looks = read_looks(Path(scene.looks))
    for agent in scene.agents:
        if agent.id not in looks.agent_colors:
            raise InputError(f"{scene.looks}: the looks have no colour for agent {agent.id}; write the scene again")
    return looks


def _rotate(rotation: FloatImage, rays: FloatImage) -> FloatImage:
    """Rotate rays (3, ...), summed in a fixed order, so that the bytes do not depend on a BLAS and its threads."""
    x, y, z = rays
    return np.stack([a * x + b * y + c * z for a, b, c in rotation])


def _exists(agent: Agent, time_us: int) -> bool:
    return bool(agent.timestamps_us[0] <= time_us <= agent.timestamps_us[-1])


def _always_stands(agent: Agent, end_us: int) -> bool:
    """Whether the agent is at one place during the whole recording."""
    throughout = agent.timestamps_us[0] <= 0 and agent.timestamps_us[-1] >= end_us
    return bool(throughout and np.all(agent.poses == agent.poses[0]))


def _pose_body(agent: Agent, body: Boxes, time_us: int) -> Boxes:
    return body.moved(agent_poses(agent, np.array([time_us]))[0])


def _ground_distance(position: Array, rise: FloatImage) -> FloatImage:
    """Distance along rays to the plane z = 0, inf for those that do not go down."""
    height = np.float32(position[2])
    return np.where(rise < 0.0, height / np.maximum(-rise, np.float32(1e-9)), np.float32(np.inf))


def _before(hits: Hits, distance: FloatImage) -> Hits:
    """The hits that lie before the given distance (b, p) of each ray."""
    nearer = hits.distance < distance[hits.block, hits.pixel]
    return Hits(hits.block[nearer], hits.pixel[nearer], hits.box[nearer], hits.distance[nearer])


def _box_color(
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
    x, y, z = _place_on_box(boxes, box, offset, position)
    face, across, up = _face(x, y, z)
    entry = box * 6 + face
    table = _face_tables(boxes, sun)
    u = (across * np.float32(0.5) + np.float32(0.5)) * np.take(table.across, entry)
    v = (np.float32(0.5) - up * np.float32(0.5)) * np.take(table.up, entry)
    texels = pixel_size * np.take(table.density, entry)
    texture = sample_surfaces(np.take(boxes.surface, entry), u - np.floor(u), v - np.floor(v), texels)
    gain = texture[:, 3:] * np.float32(1.0 / 128.0)
    return (texture[:, :3] + gain * np.take(boxes.color, box, axis=0)) * np.take(table.light, entry)[:, None]


def _place_on_box(boxes: Boxes, box: NDArray[np.intp], offset: FloatImage, position: Array) -> FloatImage:
    """Places (3, n) on boxes in their own axes, where the box reaches from -1 to 1."""
    relative = (position - boxes.center).astype(np.float32)
    x, y, z = offset + np.take(relative, box, axis=0).T
    cos, sin = (np.take(values.astype(np.float32), box) for values in (np.cos(boxes.yaw), np.sin(boxes.yaw)))
    place = np.stack([cos * x + sin * y, cos * y - sin * x, z])
    return place * np.take((1.0 / boxes.half).astype(np.float32), box, axis=0).T


def _face(x: FloatImage, y: FloatImage, z: FloatImage) -> tuple[NDArray[np.intp], FloatImage, FloatImage]:
    """The face (n,) on which places in -1 ... 1 lie, and the coordinates across and up that face."""
    ax, ay, az = np.abs(x), np.abs(y), np.abs(z)
    front, top = (ax >= ay) & (ax >= az), (az > ax) & (az > ay)
    axis = np.where(front, 0, np.where(top, 2, 1))
    along = np.where(front, x, np.where(top, z, y))
    return 2 * axis + (along < 0.0), np.where(front, y, x), np.where(top, y, z)


@dataclass(frozen=True)
class _FaceTables:
    """What shading needs of every face, (6 n,) each: repeats of the surface, its texels per metre, and its light."""

    across: FloatImage
    up: FloatImage
    density: FloatImage
    light: FloatImage


def _face_tables(boxes: Boxes, sun: Array) -> _FaceTables:
    across, up = boxes.repeats[:, FACE_ACROSS], boxes.repeats[:, FACE_UP]
    area = 4.0 * boxes.half[:, FACE_ACROSS] * boxes.half[:, FACE_UP]
    density = TILE * np.sqrt(across * up / area)
    cos, sin = np.cos(boxes.yaw), np.sin(boxes.yaw)
    ahead, left = cos * sun[0] + sin * sun[1], cos * sun[1] - sin * sun[0]
    above = np.full_like(cos, sun[2])
    facing = np.stack([ahead, -ahead, left, -left, above, -above], axis=-1)
    light = _AMBIENT + (1.0 - _AMBIENT) * np.maximum(facing, 0.0) * 1.3
    return _FaceTables(*(values.astype(np.float32).ravel() for values in (across, up, density, light)))
