"""From a specification to a recording with its exact motion."""

import numpy as np

from olt_closed_loop.hard_clips.specification import ClipSpecification, FilmingCamera
from olt_closed_loop.hard_clips.staging import LEAD_IN_SECONDS, stage_scene
from olt_closed_loop.sensors.camera_effects import film
from olt_closed_loop.sensors.ray_casting import SceneRenderer
from olt_generator.cameras import Camera, FthetaCamera, PinholeCamera
from olt_generator.poses import Array, camera_pose_in_rig
from olt_generator.trajectory import Trajectory
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import MountedCamera

_FORWARD, _LATERAL = 1.6, 0.0


def make_clip(specification: ClipSpecification) -> Recording:
    """Film a hard clip: the recording states the camera as the specification does, and is taken by the true one."""
    scene, camera = stage_scene(specification), specification.camera
    elapsed_us = np.round(np.arange(specification.frames) * (1e6 / specification.frame_rate)).astype(np.int64)
    times_us = elapsed_us + round(LEAD_IN_SECONDS * 1e6)
    mounted = MountedCamera(_lens(camera, camera.focal_off), _mount(camera, true=True))
    renderer = SceneRenderer(scene, specification.conditions)
    frames = film(renderer, mounted, scene.ego, times_us, specification.effects, specification.seed)
    return Recording(
        name=specification.name,
        source="synthetic",
        frames=frames,
        timestamps_us=elapsed_us,
        camera=_lens(camera, 0.0),
        T_rig_camera=_mount(camera, true=False),
        vehicle=scene.vehicle,
        reference=Trajectory(elapsed_us, scene.ego.interpolate(times_us)),
        spread=camera.spread,
    )


def _lens(camera: FilmingCamera, focal_off: float) -> Camera:
    """The lens, its focal length longer than stated by a factor exp(`focal_off`)."""
    width, height, half = camera.width, camera.height, 0.5 * camera.horizontal_fov
    if camera.fisheye:
        pixels_per_radian = float(0.5 * width / half * np.exp(focal_off))
        return FthetaCamera.equidistant(width, height, 0.5 * (width - 1), 0.5 * (height - 1), pixels_per_radian)
    fov = 2.0 * np.arctan(np.tan(half) * np.exp(-focal_off))
    return PinholeCamera.from_field_of_view(width, height, float(fov))


def _mount(camera: FilmingCamera, true: bool) -> Array:
    height = camera.mounting_height * (np.exp(camera.height_off) if true else 1.0)
    pitch, yaw = (camera.pitch, camera.yaw) if true else (camera.stated_pitch, camera.stated_yaw)
    return camera_pose_in_rig([_FORWARD, _LATERAL, height], camera.roll, pitch, yaw)
