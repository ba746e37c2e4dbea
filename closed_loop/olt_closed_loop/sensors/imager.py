"""The imager: noise, and the glow that lamps throw around themselves."""

from dataclasses import dataclass

import cv2
import numpy as np

from olt_closed_loop.sensors.textures import Image
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator

_BRIGHT = 235.0
_SHRINK = 4
_GLOW_WIDTHS = (0.008, 0.035)


@dataclass(frozen=True)
class Imager:
    """What the imager adds.

    Attributes:
        noise: standard deviation at mid grey, grey levels; it grows with the root of the light, and some is always
            there.
        glow: how strongly bright places shine over those around them, 0 (a clean lens) ... 1 (a greasy one).

    Raises:
        InputError: a value is negative.
    """

    noise: float = 0.0
    glow: float = 0.0

    def __post_init__(self) -> None:
        if self.noise < 0.0 or self.glow < 0.0:
            raise InputError(f"imager: noise {self.noise}, glow {self.glow}; both are 0 or more")

    def record(self, image: Image, seed: int, time_us: int) -> Image:
        """The image (H, W, 3) as recorded; seed and time draw the noise."""
        level = image.astype(np.float32)
        if self.glow > 0.0:
            level += self.glow * _glow(image)
        if self.noise > 0.0:
            generator = make_generator("imager", seed, time_us)
            sigma = self.noise * np.sqrt(0.35 + level * np.float32(0.65 / 128.0))
            level += sigma * generator.standard_normal(level.shape, dtype=np.float32)
        return np.clip(level + np.float32(0.5), 0.0, 255.0).astype(np.uint8)


def _glow(image: Image) -> np.ndarray:
    """Light (H, W, 3) around what is bright."""
    height, width = image.shape[:2]
    bright = np.maximum(image.astype(np.float32) - np.float32(_BRIGHT), 0.0)
    small = cv2.resize(bright, (width // _SHRINK, height // _SHRINK), interpolation=cv2.INTER_AREA)
    halos = sum(cv2.GaussianBlur(small, (0, 0), share * width / _SHRINK) * (share / 0.008) for share in _GLOW_WIDTHS)
    return 5.0 * cv2.resize(np.asarray(halos), (width, height), interpolation=cv2.INTER_LINEAR)
