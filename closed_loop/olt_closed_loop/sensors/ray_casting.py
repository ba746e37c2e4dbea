"""Camera images of a scene by ray casting, exact for every camera model: one ray through the centre of each pixel."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.actors import agent_poses
from olt_closed_loop.scenes.looks import Looks, generate_looks
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.sensors.boxes import Boxes, body_boxes, color_boxes, scenery_boxes
from olt_closed_loop.sensors.camera_rays import camera_rays
from olt_closed_loop.sensors.casting import CHUNK, boxes_in_view, cast
from olt_closed_loop.sensors.ground import Ground, add_shadows, empty_shadows, sunlight
from olt_closed_loop.sensors.sky import Sky
from olt_closed_loop.sensors.textures import FloatImage, Image
from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import Rig
from olt_toolkit.rigs.rig_files import pav_rig

_HAZE_DISTANCE = 700.0
_FARTHEST_GROUND = 1e5


@dataclass(frozen=True)
class Rendering:
    """An image: rgb (H, W, 3) uint8, and distance (H, W) float32 in metres along each pixel's ray, inf for sky."""

    rgb: Image
    distance: NDArray[np.float32]


class SceneRenderer:
    """Renders one scene. Its looks are read from the scene's file where it has one, and invented where not."""

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
        # What stands in the scene at `_time_us`, and the shadows on its ground.
        self._time_us: int | None = None
        self._boxes, self._shadows = self._fixed, self._fixed_shadows

    def render(self, camera: Camera, T_world_camera: Array, time_us: int) -> Rendering:
        """Take one picture from a pose (4, 4), with the agents where they are at a time in the recording."""
        self._show(time_us)
        view, position, rotation = camera_rays(camera), T_world_camera[:3, 3], T_world_camera[:3, :3].astype(np.float32)
        rays = _rotate(rotation, view.rays)
        # Distance along each ray to the ground z = 0, inf for those that do not go down.
        fall = np.maximum(-rays[2], np.float32(1e-9))
        distance = np.where(rays[2] < 0.0, np.float32(position[2]) / fall, np.float32(np.inf))
        boxes = boxes_in_view(self._boxes, position, T_world_camera[:3, 2], view)
        hits = cast(boxes, position, rays, _rotate(rotation, view.middle), view.spread, distance)

        rgb, sky = np.empty((*distance.shape, 3), dtype=np.uint8), np.isinf(distance)
        blocks = np.nonzero(sky.any(axis=1))[0]
        if len(blocks):
            rgb[blocks] = self._sky.color(rays[:, blocks])
        blocks = np.nonzero(~sky.all(axis=1))[0]
        for start in range(0, len(blocks), CHUNK):
            some = blocks[start : start + CHUNK]
            (x, y, _), away = rays[:, some], np.minimum(distance[some], np.float32(_FARTHEST_GROUND))
            across, dx, dy = away * view.angles[some], away * x, away * y
            along = across * away / np.float32(max(position[2], 0.1))
            color = self._ground.color(position, dx, dy, across, along)
            color *= sunlight(self._shadows, position, dx, dy)[..., None]
            seen = rgb[some]
            np.copyto(seen, self._hazy(color, away), where=~sky[some][..., None])
            rgb[some] = seen
        if len(hits.box):
            places = rays[:, hits.block, hits.pixel] * hits.distance
            pixel_size = hits.distance * view.angles[hits.block, hits.pixel]
            color = color_boxes(boxes, hits.box, places, position, pixel_size, self._sun)
            rgb[hits.block, hits.pixel] = self._hazy(color, hits.distance)
        distance[hits.block, hits.pixel] = hits.distance
        return Rendering(view.image(rgb), view.image(distance))

    def _show(self, time_us: int) -> None:
        """Put the agents where they are at a time; the cameras of a rig ask for the same one in a row."""
        if self._time_us == time_us:
            return
        present = [
            _pose_body(agent, body, time_us)
            for agent, body in self._changing
            if agent.timestamps_us[0] <= time_us <= agent.timestamps_us[-1]
        ]
        self._time_us, self._boxes = time_us, Boxes.concatenate([self._fixed, *present])
        changing = self._boxes.corners()[len(self._fixed) :]
        self._shadows = add_shadows(self._fixed_shadows, changing, self._sun)

    def _hazy(self, color: FloatImage, distance: FloatImage) -> Image:
        """Blend colours (n, ..., 3) into the colour of the horizon with distance; works in place."""
        color -= self._horizon
        color *= np.exp(distance * np.float32(-1.0 / _HAZE_DISTANCE))[..., None]
        color += self._horizon + np.float32(0.5)
        return np.minimum(color, np.float32(255.0), out=color).astype(np.uint8)


def render_rig(
    renderer: SceneRenderer, rig: Rig, names: tuple[str, ...], T_world_rig: Array, time_us: int
) -> dict[str, Rendering]:
    """The pictures of some cameras of a rig at pose (4, 4), by name, taken at the same time."""
    return {name: renderer.render(rig[name].camera, T_world_rig @ rig[name].T_rig_camera, time_us) for name in names}


def rig_sensors(scene: Scene) -> Callable[[tuple[str, ...], tuple[int, int], Array, int], Image]:
    """What takes pictures with the nominal PhysicalAI-AV rig (`simulation.running_rollout.Sensors`).

    Every camera is the rig's own, the tele camera too: a vehicle in a scene has a real one. (In clips built from one
    front video the tele view is the 30-degree crop of the front view.)
    """
    renderer = SceneRenderer(scene)
    fitted_rig = lru_cache(maxsize=1)(lambda size: pav_rig().fitted(size[1], size[0]))

    def take_pictures(cameras: tuple[str, ...], size: tuple[int, int], T_world_rig: Array, time_us: int) -> Image:
        pictures = render_rig(renderer, fitted_rig(size), cameras, T_world_rig, time_us)
        return np.ascontiguousarray(np.stack([pictures[name].rgb for name in cameras]).transpose(0, 3, 1, 2))

    return take_pictures


def _load_looks(scene: Scene) -> Looks:
    if scene.looks is None:
        return generate_looks(scene)
    from olt_closed_loop.scenes.scene_file import read_looks  # USD is loaded only for scenes from files

    looks = read_looks(Path(scene.looks))
    for agent in scene.agents:
        if agent.id not in looks.agent_colors:
            raise InputError(f"{scene.looks}: the looks have no colour for agent {agent.id}; write the scene again")
    return looks


def _rotate(rotation: FloatImage, rays: FloatImage) -> FloatImage:
    """Rotate rays (3, ...), summed in a fixed order, so that the bytes do not depend on a BLAS and its threads."""
    x, y, z = rays
    return np.stack([a * x + b * y + c * z for a, b, c in rotation])


def _always_stands(agent: Agent, end_us: int) -> bool:
    """Whether the agent is at one place during the whole recording."""
    throughout = agent.timestamps_us[0] <= 0 and agent.timestamps_us[-1] >= end_us
    return bool(throughout and np.all(agent.poses == agent.poses[0]))


def _pose_body(agent: Agent, body: Boxes, time_us: int) -> Boxes:
    return body.moved(agent_poses(agent, np.array([time_us]))[0])
