"""Camera images of a scene by ray casting, exact for every camera model: one ray through the centre of each pixel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.actors import agent_poses
from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions, relight
from olt_closed_loop.scenes.hills import pose_on_hills
from olt_closed_loop.scenes.looks import Looks, generate_looks
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.sensors.boxes import Boxes, body_boxes, paint_boxes, scenery_boxes
from olt_closed_loop.sensors.camera_rays import STRIP_ROWS, CameraRays, camera_rays
from olt_closed_loop.sensors.casting import CHUNK, Hits, boxes_in_view, cast
from olt_closed_loop.sensors.ground import Ground
from olt_closed_loop.sensors.illumination import illuminate, sink_into_hills
from olt_closed_loop.sensors.lamps import hang_street_lights
from olt_closed_loop.sensors.sky import Sky
from olt_closed_loop.sensors.terrain import FARTHEST, GroundHits, meet_ground
from olt_closed_loop.sensors.textures import FloatImage, Image
from olt_closed_loop.sensors.wet_road import mirrored_share, mix_mirrored
from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import Rig
from olt_toolkit.rigs.rig_files import pav_rig


@dataclass(frozen=True)
class Rendering:
    """An image: rgb (H, W, 3) uint8, and distance (H, W) float32 in metres along each pixel's ray, inf for sky."""

    rgb: Image
    distance: NDArray[np.float32]


class _Layers(NamedTuple):
    """What rays in blocks (b, p) see: colours and distances, and on a wet road the mirror image and its share."""

    rgb: Image
    distance: FloatImage
    mirrored: Image | None
    share: FloatImage | None

    @classmethod
    def join(cls, strips: "Sequence[_Layers]") -> "_Layers":
        """The layers of all strips of a picture."""
        rgb, distance = (np.concatenate([getattr(strip, name) for strip in strips]) for name in ("rgb", "distance"))
        mirrored = [strip.mirrored for strip in strips if strip.mirrored is not None]
        share = [strip.share for strip in strips if strip.share is not None]
        if not mirrored:
            return cls(rgb, distance, None, None)
        return cls(rgb, distance, np.concatenate(mirrored), np.concatenate(share))


class SceneRenderer:
    """Renders one scene in the light and weather of `conditions`.

    Its looks are read from the scene's file where it has one, and invented where not.
    """

    def __init__(self, scene: Scene, conditions: Conditions = CLEAR_DAY) -> None:
        self.conditions, self._hills = conditions, scene.hills
        self.looks = relight(_load_looks(scene), conditions)
        self._ground = Ground(scene, self.looks)
        self._sky = Sky(self.looks, conditions)
        self._horizon = np.array(self.looks.horizon, np.float32) * np.array(conditions.sky_light, np.float32)
        self._haze = np.float32(-1.0 / conditions.haze_distance)
        end_us = int(scene.ego.timestamps_us[-1])
        stands = [_always_stands(agent, end_us) for agent in scene.agents]
        bodies = [
            (agent, body_boxes(agent, self.looks.agent_colors[agent.id], lit=not still))
            for agent, still in zip(scene.agents, stands, strict=True)
        ]
        fixed = [_pose_body(*body, 0) for body, still in zip(bodies, stands, strict=True) if still]
        self._changing = [body for body, still in zip(bodies, stands, strict=True) if not still]
        self._fixed = Boxes.concatenate([self._place_scenery(), *fixed])
        self._light = illuminate(scene, self.looks, conditions, self._fixed)
        # What stands in the scene at `_time_us`.
        self._time_us: int | None = None
        self._boxes = self._fixed

    def render(
        self, camera: Camera, T_world_camera: Array, time_us: int, T_world_rig: Array | None = None
    ) -> Rendering:
        """Take one picture from a pose (4, 4), with the agents where they are at a time in the recording.

        `T_world_rig` (4, 4) is the pose of the vehicle that films, whose headlights shine at night; None for a camera
        that is on none.
        """
        view = camera_rays(camera)
        return self._develop(view, self._see(view, T_world_camera, time_us, T_world_rig))

    def render_strips(
        self, camera: Camera, T_world_camera: Array, times_us: Sequence[int], T_world_rig: Array | None = None
    ) -> Rendering:
        """Take one picture strip by strip, as a rolling shutter takes rows.

        Args:
            camera: the camera.
            T_world_camera: (n, 4, 4) its pose for each of the strips that `camera_rays.strip_rows` tells.
            times_us: (n,) times in the recording.
            T_world_rig: (n, 4, 4) or None, as in `render`.
        """
        view = camera_rays(camera, STRIP_ROWS)
        rigs = [None] * len(times_us) if T_world_rig is None else list(T_world_rig)
        strips = [
            self._see(strip, pose, time_us, rig)
            for strip, pose, time_us, rig in zip(view.strips, T_world_camera, times_us, rigs, strict=True)
        ]
        return self._develop(view, _Layers.join(strips))

    def _develop(self, view: CameraRays, layers: _Layers) -> Rendering:
        rgb = view.image(layers.rgb)
        if layers.mirrored is not None and layers.share is not None:
            rgb = mix_mirrored(rgb, view.image(layers.mirrored), view.image(layers.share))
        return Rendering(rgb, view.image(layers.distance))

    def _see(self, view: CameraRays, T_world_camera: Array, time_us: int, T_world_rig: Array | None) -> _Layers:
        self._show(time_us)
        position, rotation = T_world_camera[:3, 3], T_world_camera[:3, :3].astype(np.float32)
        rays, middle = _rotate(rotation, view.rays), _rotate(rotation, view.middle)
        ground = meet_ground(self._hills, position, rays)
        boxes = boxes_in_view(self._boxes, position, T_world_camera[:3, 2], view)
        hits = cast(boxes, position, rays, middle, view.spread, ground.distance)

        distance = ground.distance
        rgb, sky = np.empty((*distance.shape, 3), dtype=np.uint8), np.isinf(distance)
        blocks = np.nonzero(sky.any(axis=1))[0]
        if len(blocks):
            rgb[blocks] = self._sky.color(rays[:, blocks])
        blocks = np.nonzero(~sky.all(axis=1))[0]
        for start in range(0, len(blocks), CHUNK):
            some = blocks[start : start + CHUNK]
            these, away = rays[:, some], np.minimum(distance[some], np.float32(FARTHEST))
            across = away * view.angles[some]
            color = self._ground.color(position, away * these[0], away * these[1], across, ground.along(some, across))
            self._light.on_ground(color, position, these, away, T_world_rig)
            seen = rgb[some]
            np.copyto(seen, self._hazy(color, away), where=~sky[some][..., None])
            rgb[some] = seen
        mirrored, share = self._mirror(view, position, T_world_camera, rays, middle, ground)
        self._draw_boxes(rgb, boxes, hits, rays, view, position, T_world_rig)
        distance[hits.block, hits.pixel] = hits.distance
        if share is not None:
            share[hits.block, hits.pixel] = 0.0
        return _Layers(rgb, distance, mirrored, share)

    def _draw_boxes(
        self,
        rgb: Image,
        boxes: Boxes,
        hits: Hits,
        rays: FloatImage,
        view: CameraRays,
        position: Array,
        T_world_rig: Array | None,
    ) -> None:
        if len(hits.box) == 0:
            return
        these = rays[:, hits.block, hits.pixel]
        pixel_size = hits.distance * view.angles[hits.block, hits.pixel]
        paint = paint_boxes(boxes, hits.box, these * hits.distance, position, pixel_size, self._light.face_sun)
        color = self._light.on_boxes(paint, position, these, hits.distance, T_world_rig)
        rgb[hits.block, hits.pixel] = self._hazy(color, hits.distance)

    def _mirror(
        self,
        view: CameraRays,
        position: Array,
        T_world_camera: Array,
        rays: FloatImage,
        middle: FloatImage,
        ground: GroundHits,
    ) -> tuple[Image | None, FloatImage | None]:
        """What a wet road mirrors (b, p, 3), and the share of it (b, p); None where the road is dry.

        The mirror image is what a camera as far below the road sees that looks upwards through it.
        """
        if self.conditions.rain == 0.0:
            return None, None
        below = position.copy()
        below[2] = 2.0 * self._height(position) - position[2]
        turn = np.array([1.0, 1.0, -1.0], dtype=np.float32)[:, None]
        upwards, axis = np.abs(rays[2]), T_world_camera[:3, 2] * [1.0, 1.0, -1.0]
        mirrored_rays = np.stack([rays[0], rays[1], upwards])
        boxes = boxes_in_view(self._boxes, below, axis, view)
        endless = np.where(rays[2] < 0.0, np.float32(np.inf), np.float32(0.0))
        hits = cast(boxes, below, mirrored_rays, middle * turn, view.spread, endless)
        image = self._sky.color(mirrored_rays)
        self._draw_boxes(image, boxes, hits, mirrored_rays, view, below, None)
        away = np.minimum(ground.distance, np.float32(FARTHEST))
        paved = self._ground.paved(position, away * rays[0], away * rays[1], away * view.angles)
        share = paved * mirrored_share(ground.sine, self.conditions.rain)
        return image, np.where(np.isinf(ground.distance), np.float32(0.0), share)

    def _height(self, position: Array) -> float:
        return 0.0 if self._hills is None else float(self._hills.height(position))

    def _place_scenery(self) -> Boxes:
        boxes = scenery_boxes(self.looks.scenery)
        if self.conditions.light == "night" and self.conditions.street_lights:
            boxes = Boxes.concatenate([boxes, scenery_boxes(hang_street_lights(self.looks))])
        return boxes if self._hills is None else sink_into_hills(boxes, self._hills)

    def _show(self, time_us: int) -> None:
        """Put the agents where they are at a time; the cameras of a rig ask for the same one in a row."""
        if self._time_us == time_us:
            return
        present = [
            (agent, body, agent_poses(agent, np.array([time_us]))[0])
            for agent, body in self._changing
            if agent.timestamps_us[0] <= time_us <= agent.timestamps_us[-1]
        ]
        self._time_us = time_us
        self._boxes = Boxes.concatenate([self._fixed, *(body.moved(pose) for _, body, pose in present)])
        changing = self._boxes.select(np.arange(len(self._boxes)) >= len(self._fixed))
        self._light.show(changing, [(agent, pose) for agent, _, pose in present])

    def _hazy(self, color: FloatImage, distance: FloatImage) -> Image:
        """Blend colours (n, ..., 3) into the colour of the horizon with distance; works in place."""
        color -= self._horizon
        color *= np.exp(distance * self._haze)[..., None]
        color += self._horizon + np.float32(0.5)
        return np.minimum(color, np.float32(255.0), out=color).astype(np.uint8)


def render_rig(
    renderer: SceneRenderer, rig: Rig, names: tuple[str, ...], T_world_rig: Array, time_us: int
) -> dict[str, Rendering]:
    """The pictures of some cameras of a rig at pose (4, 4), by name, taken at the same time."""
    return {
        name: renderer.render(rig[name].camera, T_world_rig @ rig[name].T_rig_camera, time_us, T_world_rig)
        for name in names
    }


def rig_sensors(
    scene: Scene, conditions: Conditions = CLEAR_DAY
) -> Callable[[tuple[str, ...], tuple[int, int], Array, int], Image]:
    """What takes pictures with the nominal PhysicalAI-AV rig (`simulation.running_rollout.Sensors`).

    The simulation moves in the plane; where a scene has hills, the vehicle is put on them to take pictures.

    Every camera is the rig's own, the tele camera too: a vehicle in a scene has a real one. (In clips built from one
    front video the tele view is the 30-degree crop of the front view.)
    """
    renderer = SceneRenderer(scene, conditions)
    fitted_rig = lru_cache(maxsize=1)(lambda size: pav_rig().fitted(size[1], size[0]))

    def take_pictures(cameras: tuple[str, ...], size: tuple[int, int], T_world_rig: Array, time_us: int) -> Image:
        pose = T_world_rig if scene.hills is None else pose_on_hills(scene.hills, T_world_rig, scene.vehicle)
        pictures = render_rig(renderer, fitted_rig(size), cameras, pose, time_us)
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
