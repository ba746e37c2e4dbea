"""Drives recorded in invented scenes: what a real vehicle with the PhysicalAI-AV rig would have brought home."""

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scene import Scene
from olt_closed_loop.sensors import SceneRenderer, render_rig
from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_generator.trajectory import Trajectory
from olt_toolkit.recording import Recording
from olt_toolkit.rig import FRONT_WIDE, pav_rig


def record_drive(
    scene: Scene,
    width: int,
    height: int,
    frame_rate: float,
    cameras: tuple[str, ...] = (FRONT_WIDE,),
    with_distance: bool = False,
    on_progress: Progress = silent,
) -> Recording:
    """Drive the recorded ego's way through a scene and film it for the whole length of the recording.

    Args:
        scene: the scene.
        width, height: size of all images in pixels.
        frame_rate: images per second.
        cameras: which cameras of the rig film; the front-wide one always does and gives `Recording.frames`.
        with_distance: whether to keep the true distance of the front-wide pixels.
        on_progress: called with the share that is done.

    Raises:
        InputError: the frame rate is not positive, or the rig has no such camera.
    """
    if not frame_rate > 0.0:
        raise InputError(f"frame rate {frame_rate}: must be more than 0 images per second")
    rig = pav_rig().fitted(width, height)
    names = tuple(dict.fromkeys((FRONT_WIDE, *cameras)))
    timestamps_us = _frame_times(scene.ego, frame_rate)
    T_world_rig = scene.ego.interpolate(timestamps_us + scene.ego.timestamps_us[0])
    renderer = SceneRenderer(scene)

    images = {name: np.empty((len(timestamps_us), height, width, 3), dtype=np.uint8) for name in names}
    distance = np.empty((len(timestamps_us), height, width), dtype=np.float32) if with_distance else None
    for index, (time_us, pose) in enumerate(zip(timestamps_us.tolist(), T_world_rig, strict=True)):
        pictures = render_rig(renderer, rig, names, pose, time_us)
        for name, picture in pictures.items():
            images[name][index] = picture.rgb
        if distance is not None:
            distance[index] = pictures[FRONT_WIDE].distance
        on_progress((index + 1) / len(timestamps_us))

    front = rig[FRONT_WIDE]
    return Recording(
        name=scene.name,
        source="synthetic",
        frames=images.pop(FRONT_WIDE),
        timestamps_us=timestamps_us,
        camera=front.camera,
        T_rig_camera=front.T_rig_camera,
        vehicle=scene.vehicle,
        reference=Trajectory(timestamps_us, T_world_rig),
        distance=distance,
        views=images,
    )


def _frame_times(ego: Trajectory, frame_rate: float) -> NDArray[np.int64]:
    """Times (n,) int64 of the frames, in microseconds from the start of the recording."""
    duration_us = int(ego.timestamps_us[-1] - ego.timestamps_us[0])
    count = int(np.floor(duration_us * 1e-6 * frame_rate + 1e-9)) + 1
    return np.round(np.arange(count) * (1e6 / frame_rate)).astype(np.int64)
