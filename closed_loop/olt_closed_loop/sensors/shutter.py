"""The shutter: rows that are exposed for a while, and one after the other."""

from dataclasses import dataclass

import numpy as np

from olt_closed_loop.sensors.camera_rays import strip_rows
from olt_closed_loop.sensors.ray_casting import Rendering, SceneRenderer
from olt_generator.errors import InputError
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import MountedCamera


@dataclass(frozen=True)
class Shutter:
    """Times of the exposure; the default is a global shutter that is open for an instant.

    Attributes:
        exposure_s: seconds for which a row is exposed.
        readout_s: seconds from the exposure of the first row to that of the last; 0 is a global shutter.
        samples: instants of the exposure whose pictures are averaged.

    Raises:
        InputError: a time is negative, or there are no samples.
    """

    exposure_s: float = 0.0
    readout_s: float = 0.0
    samples: int = 4

    def __post_init__(self) -> None:
        if self.exposure_s < 0.0 or self.readout_s < 0.0 or self.samples < 1:
            raise InputError(
                f"shutter: exposure {self.exposure_s} s, readout {self.readout_s} s, {self.samples} samples; times are "
                "0 or more, samples 1 or more"
            )


INSTANT = Shutter()


def expose(
    renderer: SceneRenderer, mounted: MountedCamera, ego: Trajectory, time_us: int, shutter: Shutter
) -> Rendering:
    """One picture of a camera on a vehicle that moves as `ego`; `time_us` is the middle of it.

    A rolling shutter takes strips of rows (`camera_rays.strip_rows`), each at the time of its middle row. What lies
    outside the times of `ego` is taken at its nearest time. Distances are those of one instant in the middle.
    """
    count = shutter.samples if shutter.exposure_s > 0.0 else 1
    shares = (np.arange(count) + 0.5) / count - 0.5
    pictures = [
        _take(renderer, mounted, ego, time_us + 1e6 * share * shutter.exposure_s, shutter.readout_s) for share in shares
    ]
    if count == 1:
        return pictures[0]
    # Light adds up, and grey levels grow about as its square root.
    energy = sum(np.square(picture.rgb, dtype=np.float32) for picture in pictures) / np.float32(count)
    rgb = (np.sqrt(energy) + np.float32(0.5)).astype(np.uint8)
    return Rendering(rgb, pictures[count // 2].distance)


def _take(
    renderer: SceneRenderer, mounted: MountedCamera, ego: Trajectory, middle_us: float, readout_s: float
) -> Rendering:
    camera = mounted.camera
    rolling = readout_s > 0.0
    rows = strip_rows(camera) if rolling else np.array([(camera.height - 1) / 2])
    times_us = middle_us + 1e6 * readout_s * (rows - (camera.height - 1) / 2) / max(camera.height - 1, 1)
    times_us = np.clip(np.round(times_us), ego.timestamps_us[0], ego.timestamps_us[-1]).astype(np.int64)
    T_world_rig = ego.interpolate(times_us)
    T_world_camera = T_world_rig @ mounted.T_rig_camera
    if rolling:
        return renderer.render_strips(camera, T_world_camera, times_us.tolist(), T_world_rig)
    return renderer.render(camera, T_world_camera[0], int(times_us[0]), T_world_rig[0])
