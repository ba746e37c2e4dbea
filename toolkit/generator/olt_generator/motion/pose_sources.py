"""Where the motion of the rig comes from: one door for odometry, known poses and learned models.

A source gives poses as it found them; `smoother` takes out their jitter, with the noise that the source says it has.
"""

from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.motion.odometry import estimate_odometry
from olt_generator.motion.smoother import ODOMETRY_SETTINGS, SmootherSettings
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
    """

    trajectory: Trajectory
    T_rig_camera: Array
    scale_sigma: float | None
    noise: SmootherSettings


class PoseSource(Protocol):
    """Finds how the rig moved while a video was taken."""

    def estimate(
        self,
        frames: NDArray[np.uint8],
        timestamps_us: NDArray[np.int64],
        camera: Camera,
        T_rig_camera: Array,
        on_progress: Progress = silent,
    ) -> PoseEstimate:
        """Find the motion.

        Args:
            frames: (n, H, W, 3) uint8 RGB.
            timestamps_us: (n,) int64, strictly increasing.
            camera: model of the camera at the size of the frames.
            T_rig_camera: (4, 4) mounting of the camera.
            on_progress: told the share of the work that is done.

        Raises:
            InputError: the source cannot tell the motion of this video.
        """
        ...


@dataclass(frozen=True)
class VisualOdometry:
    """Motion from the video itself, without learned weights (`odometry`)."""

    def estimate(
        self,
        frames: NDArray[np.uint8],
        timestamps_us: NDArray[np.int64],
        camera: Camera,
        T_rig_camera: Array,
        on_progress: Progress = silent,
    ) -> PoseEstimate:
        """See `PoseSource.estimate`."""
        odometry = estimate_odometry(frames, timestamps_us, camera, T_rig_camera, on_progress)
        return PoseEstimate(odometry.trajectory, odometry.T_rig_camera, odometry.scale_sigma, ODOMETRY_SETTINGS)


@dataclass(frozen=True)
class KnownPoses:
    """Motion that was measured otherwise: GPS/IMU, or the poses of a data set.

    Attributes:
        trajectory: poses in any fixed frame, on the clock of the frames, from before the first frame to after the last.
        of: whether they are poses of the rig or of the camera (x right, y down, z forward).
        noise: how noisy they are, where that is known.
    """

    trajectory: Trajectory
    of: Literal["rig", "camera"] = "rig"
    noise: SmootherSettings = field(default_factory=SmootherSettings)

    def estimate(
        self,
        frames: NDArray[np.uint8],
        timestamps_us: NDArray[np.int64],
        camera: Camera,
        T_rig_camera: Array,
        on_progress: Progress = silent,
    ) -> PoseEstimate:
        """See `PoseSource.estimate`; poses are interpolated at the times of the frames, never extrapolated."""
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
    """The rig's motion in the frame of its first pose.

    Args:
        timestamps_us: (n,).
        T_world_sensor: (n, 4, 4) poses of something on the rig, in any fixed frame.
        T_rig_sensor: (4, 4) how it is mounted.
    """
    return Trajectory(timestamps_us, T_world_sensor @ invert(T_rig_sensor)).in_first_frame()
