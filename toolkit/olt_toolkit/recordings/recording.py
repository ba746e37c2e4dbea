"""What a clip is built from: one front-camera recording."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from olt_generator.camera_spread import CameraSpread
from olt_generator.cameras import Camera
from olt_generator.doubts import Doubt
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_toolkit.recordings.truth import Holds, ObstacleTracks
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT
from olt_toolkit.rigs.rig import MountedCamera, VehicleDimensions


@dataclass(frozen=True)
class StatedAccuracy:
    """What a source says of the errors of the motion that it measured, in a sentence.

    `acceleration` is the root mean square error of its accelerations in m/s2; None where it says nothing of them.
    """

    text: str
    acceleration: float | None = None


@dataclass(frozen=True)
class Recording:
    """A front-camera recording, decoded at working resolution.

    Attributes:
        name, source: what the recording is called in results, and the reader that opened it.
        frames: (n, H, W, 3) uint8 RGB.
        timestamps_us: (n,) int64, strictly increasing, the first is 0.
        camera: model of the front camera at the size of `frames`.
        T_rig_camera: (4, 4) pose of the front camera in the rig; its height above ground fixes the metric scale.
        assumptions: one sentence for everything that was assumed instead of measured (lens, mounting, vehicle).
        reference: the measured rig trajectory over the same times or beyond them, where one is known.
        accuracy: what its source says of the errors of the reference; None where it says nothing.
        distance: (n, H, W) float32 true distance along each pixel's ray in metres (inf: sky), where it is known.
        views: true images (n, h, w, 3) by camera name, where they are known; one of the front-wide camera is put
            together from several cameras, and goes before `frames` where true views are wanted.
        mounted: lens, at the size of the images, and mounting of the cameras of `views`; a camera that is not there is
            that of the rig whose views are wanted.
        observed: pixels (h, w) that some camera saw, of those of `views` that are mosaics of several cameras.
        spread: how well height and focal length of the front camera are known.
        doubts: what the reader has reason to doubt, such as where the camera looks.
        route: (n, 2) metres, n >= 2, the line that the vehicle was meant to follow, seen from the rig at time 0 without
            its roll and pitch; None where it is not known.
        obstacles, holds: what is known of others and of the right to go on (`recordings.truth`).
        road: (k, 4) x, y of points of the route, k >= 2, as `route`, and metres of road to the right and left of each.
    """

    name: str
    source: str
    frames: NDArray[np.uint8]
    timestamps_us: NDArray[np.int64]
    camera: Camera
    T_rig_camera: Array
    vehicle: VehicleDimensions
    assumptions: tuple[str, ...] = ()
    reference: Trajectory | None = None
    accuracy: StatedAccuracy | None = None
    distance: NDArray[np.float32] | None = None
    views: dict[str, NDArray[np.uint8]] = field(default_factory=dict)
    mounted: dict[str, MountedCamera] = field(default_factory=dict)
    observed: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    spread: CameraSpread = field(default_factory=CameraSpread)
    doubts: tuple[Doubt, ...] = ()
    route: Array | None = None
    obstacles: ObstacleTracks | None = None
    holds: Holds | None = None
    road: Array | None = None


def refuse_unused(given: Mapping[str, bool], why: str) -> None:
    """Refuse (`InputError`) those options that were given although nothing takes them, by name, and why."""
    names = [name for name, is_given in given.items() if is_given]
    if names:
        raise InputError(f"{', '.join(names)}: {why}; leave out what does nothing")


@dataclass(frozen=True)
class OpenOptions:
    """How to open a recording.

    Attributes:
        width: working width of the frames in pixels; height follows the aspect ratio.
        height: of the frames in pixels, for a world that is rendered in any shape; None for its usual one, as for all
            other recordings.
        duration: at most this many seconds from the start, where no window is asked for.
        horizontal_fov: field of view in radians to assume where no calibration exists; None for the reader's default.
        camera_height: height in metres above ground to assume where no mounting is known; None for the default.
        rotate: clockwise turn in degrees, 0, 90, 180 or 270, by which pictures are brought upright, after what the file
            itself says.
        mirror: whether they are then mirrored left to right.
        views: cameras whose true images are wanted beside the front ones, where the recording has them.
        true_distance: whether the true distance of front pixels is wanted, where the recording has it.
    """

    width: int = 832
    height: int | None = None
    duration: float = 20.0
    horizontal_fov: float | None = None
    camera_height: float | None = None
    rotate: int = 0
    mirror: bool = False
    views: tuple[str, ...] = DEFAULT_CONTRACT.cameras
    true_distance: bool = False

    def refuse_camera(self, where: str) -> None:
        """Refuse (`InputError`) what is said of the camera, where a calibration says it better."""
        given = {
            "--fov": self.horizontal_fov is not None,
            "--camera-height": self.camera_height is not None,
            "--rotate": self.rotate != 0,
            "--mirror": self.mirror,
        }
        refuse_unused(given, f"{where} has a calibrated camera, which they cannot change")
