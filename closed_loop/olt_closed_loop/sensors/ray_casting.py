"""Camera images of a scene by ray casting, exact for every camera model: one ray through the centre of each pixel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.actors import pose_columns, poses_at
from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions, relight
from olt_closed_loop.scenes.hills import pose_on_hills, stand_up
from olt_closed_loop.scenes.looks import Looks, generate_looks
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.sensors.boxes import Boxes, body_boxes, paint_boxes, scenery_boxes
from olt_closed_loop.sensors.camera_rays import CameraRays, camera_rays
from olt_closed_loop.sensors.casting import Hits, boxes_in_view, cast
from olt_closed_loop.sensors.ground import Ground, MapPlaces
from olt_closed_loop.sensors.illumination import illuminate, sink_into_hills
from olt_closed_loop.sensors.lamps import hang_street_lights
from olt_closed_loop.sensors.level_view import LevelView, Stand, lay_out, rotate, sky_places
from olt_closed_loop.sensors.signal_heads import SignalHeads
from olt_closed_loop.sensors.sky import Sky
from olt_closed_loop.sensors.terrain import meet_ground
from olt_closed_loop.sensors.textures import FloatImage, Image
from olt_closed_loop.sensors.wet_road import mirrored_share, mix_mirrored
from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import Rig
from olt_toolkit.rigs.rig_files import pav_rig

# Views of more pixels are laid out anew for each picture, so that they take no memory.
_LARGEST_KEPT = 500_000


@dataclass(frozen=True)
class Rendering:
    """An image: rgb (H, W, 3) uint8, and distance (H, W) float32 in metres along each pixel's ray, inf for sky."""

    rgb: Image
    distance: NDArray[np.float32]


class _Layers(NamedTuple):
    """What the pixels of an image or a strip of it see: colours and distances, and on a wet road what it mirrors."""

    rgb: Image
    distance: FloatImage
    mirrored: Image | None
    share: FloatImage | None

    @classmethod
    def join(cls, strips: "Sequence[_Layers]") -> "_Layers":
        """The layers of all strips of a picture, one below the other."""
        rgb, distance = (np.concatenate([getattr(strip, name) for strip in strips]) for name in ("rgb", "distance"))
        mirrored = [strip.mirrored for strip in strips if strip.mirrored is not None]
        share = [strip.share for strip in strips if strip.share is not None]
        if not mirrored:
            return cls(rgb, distance, None, None)
        return cls(rgb, distance, np.concatenate(mirrored), np.concatenate(share))

    def develop(self) -> Rendering:
        """The picture."""
        rgb = self.rgb
        if self.mirrored is not None and self.share is not None:
            rgb = mix_mirrored(rgb, self.mirrored, self.share)
        return Rendering(rgb, self.distance)


class _Laid(NamedTuple):
    """A view laid out for a turn and a height above level ground, with its way into the map of the ground."""

    turn: Array
    height: float
    view: LevelView
    places: MapPlaces


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
        fixed = [self._pose_body(*body) for body, still in zip(bodies, stands, strict=True) if still]
        self._changing = [
            (agent, body, pose_columns(agent)) for (agent, body), still in zip(bodies, stands, strict=True) if not still
        ]
        self._heads = SignalHeads(scene)
        self._fixed = Boxes.concatenate([self._place_scenery(), self._heads.standing, *fixed])
        self._light = illuminate(scene, self.looks, conditions, self._fixed)
        # What stands in the scene at `_time_us`.
        self._time_us: int | None = None
        self._laid: dict[Camera, _Laid] = {}
        self._boxes = self._fixed

    def render(
        self, camera: Camera, T_world_camera: Array, time_us: int, T_world_rig: Array | None = None
    ) -> Rendering:
        """Take one picture from a pose (4, 4), with the agents where they are at a time in the recording.

        `T_world_rig` (4, 4) is the pose of the vehicle that films, whose headlights shine at night; None for a camera
        that is on none.
        """
        return self._see(camera_rays(camera), camera, T_world_camera, time_us, T_world_rig).develop()

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
        rigs = [None] * len(times_us) if T_world_rig is None else list(T_world_rig)
        strips = zip(camera_rays(camera).strips, T_world_camera, times_us, rigs, strict=True)
        return _Layers.join(
            [self._see(strip, None, pose, time_us, rig) for strip, pose, time_us, rig in strips]
        ).develop()

    def _see(
        self, view: CameraRays, kept_as: Camera | None, T_world_camera: Array, time_us: int, T_world_rig: Array | None
    ) -> _Layers:
        self._show(time_us)
        stand = Stand.of(T_world_camera)
        laid, places = self._lay_out(view, kept_as, stand)
        R_level_rig = None if T_world_rig is None else stand.level(T_world_rig[:3, :3])
        boxes = self._boxes_in_view(stand, stand.R_level_camera[:, 2], view)
        hits = cast(boxes, laid.camera_rays.squares, laid.rays, view.pixels, laid.distance)

        material = self._ground.materials(places, stand)
        light = self._light.on_ground(laid.ground, stand, R_level_rig)
        color = self._ground.color(material, laid.ground, stand, light)
        rgb = laid.image(self._hazy(color, laid.ground.clear), self._sky.color(laid.sky, stand.heading))
        self._draw_boxes(rgb, boxes, hits, laid, stand, R_level_rig)
        distance = laid.distance.copy()
        distance[hits.pixel] = hits.distance
        mirrored, share = self._mirror(laid, material, stand)
        if share is not None:
            share.reshape(-1)[hits.pixel] = 0.0
        return _Layers(rgb, distance.reshape(view.size), mirrored, share)

    def _lay_out(self, view: CameraRays, kept_as: Camera | None, stand: Stand) -> tuple[LevelView, MapPlaces]:
        """The view, kept for the next picture of its camera, which on level ground mostly has the same turn."""
        height = round(float(stand.position[2]), 6)
        kept = self._laid.get(kept_as) if kept_as and self._hills is None else None
        if kept and kept.height == height and np.array_equal(kept.turn, stand.R_level_camera):
            return kept.view, kept.places
        rays = rotate(stand.R_level_camera, view.rays)
        if self._hills is None:
            hits = meet_ground(None, np.array([0.0, 0.0, height]), rays)
        else:
            hits = meet_ground(self._hills, stand.position, rotate(stand.R_world_level, rays))
        laid = lay_out(view, rays, stand.R_level_camera, hits, self.conditions.haze_distance)
        places = self._ground.lay_out(laid.ground)
        if kept_as and view.angles.size <= _LARGEST_KEPT:
            self._laid[kept_as] = _Laid(stand.R_level_camera, height, laid, places)
        return laid, places

    def _boxes_in_view(self, stand: Stand, axis: Array, view: CameraRays) -> Boxes:
        """The boxes that a camera that looks along `axis` (3,), in level axes, may see; in those axes."""
        found = boxes_in_view(self._boxes, stand.position, stand.R_world_level @ axis, view.field, view.finest)
        return found.moved(stand.T_level_world)

    def _draw_boxes(
        self, rgb: Image, boxes: Boxes, hits: Hits, laid: LevelView, stand: Stand, R_level_rig: Array | None
    ) -> None:
        if len(hits.box) == 0:
            return
        these = np.take(laid.rays.reshape(3, -1), hits.ray, axis=1)
        pixel_size = hits.distance * np.take(laid.camera_rays.angles, hits.pixel)
        paint = paint_boxes(boxes, hits.box, these * hits.distance, pixel_size, stand.level(self._light.face_sun))
        color = self._light.on_boxes(paint, these, hits.distance, stand, R_level_rig)
        clear = np.exp(hits.distance * self._haze)
        hazy = self._hazy([color[:, index][None] for index in range(3)], clear[None])
        rgb.reshape(-1, 3)[hits.pixel] = hazy[0]

    def _mirror(self, laid: LevelView, material: Image, stand: Stand) -> tuple[Image | None, FloatImage | None]:
        """What a wet road mirrors (h, w, 3), and the share of it (h, w); None where the road is dry.

        The mirror image is what a camera as far below the road sees that looks upwards through it.
        """
        if self.conditions.rain == 0.0:
            return None, None
        below = stand.position.copy()
        below[2] = 2.0 * self._height(below) - below[2]
        stand, laid = replace(stand, position=below), laid.upwards()
        boxes = self._boxes_in_view(stand, stand.R_level_camera[:, 2] * [1.0, 1.0, -1.0], laid.camera_rays)
        endless = np.where(np.isfinite(laid.distance), np.float32(np.inf), np.float32(0.0))
        hits = cast(boxes, laid.camera_rays.squares, laid.rays, laid.camera_rays.pixels, endless)
        ground = laid.ground
        upwards = np.stack([ground.rays[0], ground.rays[1], np.abs(ground.rays[2])])
        above, sky = (self._sky.color(places, stand.heading) for places in (sky_places(upwards), laid.sky))
        image = laid.image(above, sky)
        self._draw_boxes(image, boxes, hits, laid, stand, None)
        share = self._ground.paved(material) * mirrored_share(ground.sine, self.conditions.rain)
        return image, laid.image(share, np.zeros(laid.sky.shape[:2], dtype=np.float32))

    def _height(self, position: Array) -> float:
        return 0.0 if self._hills is None else float(self._hills.height(position))

    def _place_scenery(self) -> Boxes:
        boxes = scenery_boxes(self.looks.scenery)
        if self.conditions.light == "night" and self.conditions.street_lights:
            boxes = Boxes.concatenate([boxes, scenery_boxes(hang_street_lights(self.looks))])
        return boxes if self._hills is None else sink_into_hills(boxes, self._hills)

    def _pose_body(self, agent: Agent, body: Boxes) -> Boxes:
        """The body of an agent that never moves."""
        return body.moved(stand_up(agent, agent.poses[0], self._hills))

    def _show(self, time_us: int) -> None:
        """Put the agents where they are at a time; the cameras of a rig ask for the same one in a row."""
        if self._time_us == time_us:
            return
        present = [
            (agent, body, poses_at(agent, columns, np.array([time_us]))[0])
            for agent, body, columns in self._changing
            if agent.timestamps_us[0] <= time_us <= agent.timestamps_us[-1]
        ]
        self._time_us = time_us
        bodies = (body.moved(stand_up(agent, pose, self._hills)) for agent, body, pose in present)
        changing = Boxes.concatenate([self._heads.at(time_us), *bodies])
        self._boxes = Boxes.concatenate([self._fixed, changing])
        self._light.show(changing, [(agent, pose) for agent, _, pose in present])

    def _hazy(self, color: Sequence[FloatImage], clear: FloatImage) -> Image:
        """Blend red, green and blue (n, m) into the colour of the horizon by the share (n, m) that is not clear."""
        veil = np.float32(1.0) - clear
        channels = (share * clear + veil * horizon for share, horizon in zip(color, self._horizon, strict=True))
        return np.asarray(cv2.merge([cv2.convertScaleAbs(channel) for channel in channels]), np.uint8)


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


def _always_stands(agent: Agent, end_us: int) -> bool:
    """Whether the agent is at one place during the whole recording."""
    throughout = agent.timestamps_us[0] <= 0 and agent.timestamps_us[-1] >= end_us
    return bool(throughout and np.all(agent.poses == agent.poses[0]))
