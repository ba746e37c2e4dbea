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


class Film:
    """Pictures of one camera on a vehicle, taken one after the other and developed together.

    `seed` is that of drops, streaks and noise.
    """

    def __init__(self, renderer: SceneRenderer, mounted: MountedCamera, effects: CameraEffects, seed: int) -> None:
        self._renderer, self._mounted, self._effects, self._seed = renderer, mounted, effects, seed
        size, light = (mounted.camera.height, mounted.camera.width), renderer.conditions.brightness
        glass = effects.windscreen
        self._glass = None if glass is None else WindscreenGlass(glass, size, light, seed)
        self._taken: list[Image] = []
        self._times_us: list[int] = []

    def take(self, ego: Trajectory, time_us: int) -> NDArray[np.float32]:
        """Take the next picture; returns its distances (H, W), as of `Rendering`, without what is on the glass.

        Args:
            ego: motion of the vehicle, T_world_rig; before its first and after its last pose the shutter sees it stand.
            time_us: time in the recording, of the middle of the exposure of the middle row.
        """
        imager = self._effects.imager
        picture = expose(self._renderer, self._mounted, ego, time_us, self._effects.shutter)
        image = picture.rgb if self._glass is None else self._glass.look_through(picture.rgb, time_us)
        self._taken.append(image if imager is None else imager.record(image, self._seed, time_us))
        self._times_us.append(time_us)
        return picture.distance

    def develop(self) -> Image:
        """All pictures (n, H, W, 3)."""
        frames, rate = np.stack(self._taken), self._effects.kilobits_per_second
        if rate is None:
            return frames
        seconds = (self._times_us[-1] - self._times_us[0]) * 1e-6
        return compress(frames, (len(frames) - 1) / seconds if seconds > 0.0 else 1.0, rate)
