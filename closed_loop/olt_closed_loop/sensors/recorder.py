"""Drives recorded in invented scenes: what a real vehicle with the PhysicalAI-AV rig would have brought home."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.camera_effects import NO_EFFECTS, CameraEffects, Film
from olt_closed_loop.sensors.ray_casting import SceneRenderer
from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, planar_pose, transform, yaw_of
from olt_generator.progress import Progress, silent
from olt_generator.seeds import derive_seed
from olt_generator.trajectory import Trajectory
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.recording import Recording, StatedAccuracy
from olt_toolkit.rigs.rig import FRONT_WIDE
from olt_toolkit.rigs.rig_files import pav_rig


def record_drive(
    scene: Scene,
    width: int,
    height: int,
    frame_rate: float,
    cameras: tuple[str, ...] = (FRONT_WIDE,),
    with_distance: bool = False,
    on_progress: Progress = silent,
    window_us: Span | None = None,
    images_us: NDArray[np.int64] | None = None,
    conditions: Conditions = CLEAR_DAY,
    effects: Mapping[str, CameraEffects] | None = None,
    renderer: SceneRenderer | None = None,
) -> Recording:
    """Drive the recorded ego's way through a scene and film it.

    Args:
        scene: the scene.
        width, height: size of all images in pixels.
        frame_rate: images per second.
        cameras: which cameras of the rig film; the front-wide one always does and gives `Recording.frames`.
        with_distance: whether to keep the true distance of the front-wide pixels.
        on_progress: called with the share that is done.
        window_us: keep only the images between these times, both included; None for the whole length. The reference
            covers all of the drive in any case, so it may reach before the first image and beyond the last.
        images_us: keep only the images at these times of those that the frame rate gives.
        conditions: light and weather.
        effects: of the cameras, by name; those that are not named have none.
        renderer: of the same road, agents and conditions, where there is one already.

    Raises:
        InputError: the frame rate is not positive, the rig has no such camera, or no image lies in the window.
    """
    rig = pav_rig().fitted(width, height)
    names = tuple(dict.fromkeys((FRONT_WIDE, *cameras)))
    drive_us = frame_times(scene, frame_rate)
    T_world_rig = scene.ego.interpolate(drive_us + scene.ego.timestamps_us[0])
    first_us, last_us = window_us or (0, drive_us[-1])
    filmed = (drive_us >= first_us) & (drive_us <= last_us)
    if images_us is not None:
        filmed &= np.isin(drive_us, images_us)
    if not filmed.any():
        raise InputError(f"{scene.name}: no image lies between {first_us} and {last_us} us of the drive")
    timestamps_us = drive_us[filmed]
    renderer = renderer or SceneRenderer(scene, conditions)
    ego = Trajectory(scene.ego.timestamps_us - scene.ego.timestamps_us[0], scene.ego.T_world_rig)
    seed = derive_seed("camera effects", scene.name)
    films = {name: Film(renderer, rig[name], (effects or {}).get(name, NO_EFFECTS), seed) for name in names}

    distance = np.empty((len(timestamps_us), height, width), dtype=np.float32) if with_distance else None
    for index, time_us in enumerate(timestamps_us.tolist()):
        seen = {name: film.take(ego, time_us) for name, film in films.items()}
        if distance is not None:
            distance[index] = seen[FRONT_WIDE]
        on_progress((index + 1) / len(timestamps_us))
    images = {name: film.develop() for name, film in films.items()}

    front = rig[FRONT_WIDE]
    return Recording(
        name=scene.name,
        source="synthetic",
        frames=images.pop(FRONT_WIDE),
        timestamps_us=timestamps_us - timestamps_us[0],
        camera=front.camera,
        T_rig_camera=front.T_rig_camera,
        vehicle=scene.vehicle,
        reference=Trajectory(drive_us - timestamps_us[0], T_world_rig),
        accuracy=StatedAccuracy("the motion by which the scene was driven, without errors", acceleration=0.0),
        distance=distance,
        views=images,
        mounted={name: rig[name] for name in images},
        route=_route_from(scene, T_world_rig[filmed][0]),
    )


def _route_from(scene: Scene, T_world_rig: Array) -> Array | None:
    """The route (n, 2) seen from a pose without its roll and pitch; None where the scene has none."""
    if len(scene.route) < 2:
        return None
    T_anchor_world = invert(planar_pose(T_world_rig[0, 3], T_world_rig[1, 3], float(yaw_of(T_world_rig))))
    return transform(T_anchor_world, scene.route)[:, :2]


def frame_times(scene: Scene, frame_rate: float) -> NDArray[np.int64]:
    """Times (n,) of the images of a recorded drive, in microseconds from its start.

    Raises:
        InputError: the frame rate is not positive.
    """
    return image_times(int(scene.ego.timestamps_us[-1] - scene.ego.timestamps_us[0]), frame_rate)


def image_times(duration_us: int, frame_rate: float) -> NDArray[np.int64]:
    """Times (n,) of the images of a drive of a duration, in microseconds from its start.

    Raises:
        InputError: the frame rate is not positive.
    """
    if not frame_rate > 0.0:
        raise InputError(f"frame rate {frame_rate}: must be more than 0 images per second")
    count = int(np.floor(duration_us * 1e-6 * frame_rate + 1e-9)) + 1
    return np.round(np.arange(count) * (1e6 / frame_rate)).astype(np.int64)
