"""Where the motion of the rig comes from: one door for odometry, known poses and learned models.

A source gives poses as it found them; `smoother` takes out their jitter, with the noise that the source says it has.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.doubts import Doubt
from olt_generator.errors import InputError
from olt_generator.motion.smoother import SmootherSettings
from olt_generator.poses import Array, invert
from olt_generator.progress import Progress, silent
from olt_generator.trajectory import Trajectory


@dataclass(frozen=True)
class PoseEstimate:
    """Metric motion of the rig, as a source found it.

    Attributes:
        trajectory: T_world_rig at every frame; the first pose is the identity.
        T_rig_camera: (4, 4) mounting of the camera: as given, or corrected where the source can see it.
        scale_sigma: relative standard deviation of the metric scale; None where it is not known.
        noise: how noisy the poses are, for the smoother.
        covariance: (n, 6, 6) of the errors of position (x, y, z in metres) and rotation (rotation vector in radians),
            both in the axes of the first pose, against which they are meant. It is that of the path at the scale as it
            was found: what `scale_sigma` says is not in it. None where it is not known.
        doubts: why the motion may be another one.
    """

    trajectory: Trajectory
    T_rig_camera: Array
    scale_sigma: float | None
    noise: SmootherSettings
    covariance: Array | None = field(default=None, kw_only=True)
    doubts: tuple[Doubt, ...] = field(default=(), kw_only=True)


PoseSource = Callable[[NDArray[np.uint8], NDArray[np.int64], Camera, Array, Progress], PoseEstimate]
"""Finds how the rig moved while a video was taken; arguments as of `odometry.estimate_odometry`, which is one.

An `InputError` says that the source cannot tell the motion of this video.
"""


@dataclass(frozen=True)
class KnownPoses:
    """A `PoseSource` of motion that was measured otherwise: GPS/IMU, or the poses of a data set.

    Attributes:
        trajectory: poses in any fixed frame, on the clock of the frames, from before the first frame to after the last.
        of: whether they are poses of the rig or of the camera (x right, y down, z forward).
        noise: how noisy they are, where that is known.
    """

    trajectory: Trajectory
    of: Literal["rig", "camera"] = "rig"
    noise: SmootherSettings = field(default_factory=SmootherSettings)

    def __call__(
        self,
        frames: NDArray[np.uint8],
        timestamps_us: NDArray[np.int64],
        camera: Camera,
        T_rig_camera: Array,
        on_progress: Progress = silent,
    ) -> PoseEstimate:
        """The poses, interpolated at the times of the frames, never extrapolated."""
        times = self.trajectory.timestamps_us
        if timestamps_us[0] < times[0] or timestamps_us[-1] > times[-1]:
            raise InputError(
                f"known poses: they cover {times[0]} to {times[-1]} us, the frames {timestamps_us[0]} to "
                f"{timestamps_us[-1]} us; give poses on the clock of the frames for all of them, or cut the video"
            )
        poses = self.trajectory.interpolate(timestamps_us)
        mounting = T_rig_camera if self.of == "camera" else np.eye(4)
        on_progress(1.0)
        return PoseEstimate(rig_trajectory(timestamps_us, poses, mounting), T_rig_camera, None, self.noise)


def rig_trajectory(timestamps_us: NDArray[np.int64], T_world_sensor: Array, T_rig_sensor: Array) -> Trajectory:
    """The rig's motion in the frame of its first pose, from poses (n, 4, 4) of something mounted at `T_rig_sensor`."""
    return Trajectory(timestamps_us, T_world_sensor @ invert(T_rig_sensor)).in_first_frame()
