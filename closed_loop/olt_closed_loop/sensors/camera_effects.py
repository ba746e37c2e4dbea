"""What a real camera does to what it sees: its shutter, the glass before it, its imager, and its encoder."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.sensors.compression import compress
from olt_closed_loop.sensors.imager import Imager
from olt_closed_loop.sensors.ray_casting import SceneRenderer
from olt_closed_loop.sensors.shutter import INSTANT, Shutter, expose
from olt_closed_loop.sensors.textures import Image
from olt_closed_loop.sensors.windscreen import Windscreen, WindscreenGlass
from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import MountedCamera


@dataclass(frozen=True)
class CameraEffects:
    """Effects of one camera; the default has none.

    Attributes:
        shutter: how long rows are exposed, and how far apart.
        windscreen: what is on or in the glass, and the bonnet before it; None for a camera outside.
        imager: noise and the glow around lamps; None for none.
        kilobits_per_second: rate of the H.264 encoder, whose artefacts the frames then have; None leaves them as they
            are.

    Raises:
        InputError: the rate is not positive.
    """

    shutter: Shutter = INSTANT
    windscreen: Windscreen | None = None
    imager: Imager | None = None
    kilobits_per_second: float | None = None

    def __post_init__(self) -> None:
        if self.kilobits_per_second is not None and not self.kilobits_per_second > 0.0:
            raise InputError(f"encoder rate {self.kilobits_per_second} kbit/s: must be more than 0")


NO_EFFECTS = CameraEffects()


def film(
    renderer: SceneRenderer,
    mounted: MountedCamera,
    ego: Trajectory,
    times_us: NDArray[np.int64],
    effects: CameraEffects = NO_EFFECTS,
    seed: int = 0,
    on_progress: Progress = silent,
) -> Image:
    """Frames (n, H, W, 3) of a camera on a vehicle.

    Args:
        renderer: of the scene.
        mounted: lens and mounting.
        ego: motion of the vehicle, T_world_rig; before its first and after its last pose the shutter sees it stand.
        times_us: (n,) times in the recording, of the middle of each exposure of the middle row.
        effects: of the camera.
        seed: of drops, streaks and noise.
        on_progress: told the share that is done.
    """
    frames = np.empty((len(times_us), mounted.camera.height, mounted.camera.width, 3), dtype=np.uint8)
    glass: WindscreenGlass | None = None
    for index, time_us in enumerate(times_us.tolist()):
        image = expose(renderer, mounted, ego, time_us, effects.shutter)
        if effects.windscreen is not None:
            glass = glass or WindscreenGlass(effects.windscreen, image, seed)
            image = glass.look_through(image, time_us * 1e-6, index)
        frames[index] = image if effects.imager is None else effects.imager.record(image, seed, index)
        on_progress((index + 1) / len(times_us))
    if effects.kilobits_per_second is None:
        return frames
    seconds = (times_us[-1] - times_us[0]) * 1e-6
    return compress(frames, (len(times_us) - 1) / seconds if seconds > 0.0 else 1.0, effects.kilobits_per_second)
