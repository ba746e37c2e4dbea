"""How well a camera is known: how far its height and its focal length may be off, and where they come from."""

from dataclasses import dataclass
from typing import Literal

Origin = Literal["calibrated", "given", "estimated", "assumed"]
"""Where a value comes from: a calibration file, the user, the video itself, or a default for want of all these."""


@dataclass(frozen=True)
class Spread:
    """Relative standard deviation of a value, and where the value comes from."""

    relative: float
    origin: Origin


@dataclass(frozen=True)
class CameraSpread:
    """Spread of what turns a motion in pixels into metres; both stretch the motion by as much as they are off.

    Attributes:
        height: of the camera above the road; a load moves even a surveyed one by a centimetre or two.
        focal_length: of the lens.
    """

    height: Spread = Spread(0.01, "calibrated")
    focal_length: Spread = Spread(0.003, "calibrated")
