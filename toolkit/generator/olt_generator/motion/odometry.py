"""Monocular visual odometry without learned weights.

Corners are tracked over keyframes a tenth of a second apart. Epipolar geometry gives the rotation of each step and the
line along which the camera moved; whether forward or backward, and how fast, is told by the road below a camera of
known height, because most corners may belong to vehicles that move by themselves. From there all keyframes are adjusted
together to all tracks, which makes the shape of the path exact but lets its scale drift; the road gives the scale back.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.motion.features import track_from_keyframes
from olt_generator.motion.keyframe_path import KeyframeSteps, recover_path
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.motion.smoother import ODOMETRY_SETTINGS
from olt_generator.motion.static_mask import choose_moving, find_static_mask
from olt_generator.motion.steps import Step, estimate_step
from olt_generator.poses import Array, invert, make_pose
from olt_generator.progress import Progress, silent
from olt_generator.trajectory import Trajectory

KEYFRAME_SECONDS = 0.1
MAX_STEP_SECONDS = 0.5
MIN_CAMERA_HEIGHT = 0.3
# A camera shakes by less than this between keyframes, radians.
MOST_SHAKING = np.radians(0.5)


@dataclass(frozen=True)
class OdometrySettings:
    """How much work is spent on a clip.

    Attributes:
        corners_per_cell: points followed in every 32 x 32 pixels.
        window: keyframes over which a point is followed at most, and so seen together.
        rounds: Gauss-Newton rounds over all keyframes together; 0 leaves every step as it was found on its own.
    """

    corners_per_cell: int = 4
    window: int = 10
    rounds: int = 6


@dataclass(frozen=True)
class Odometry(PoseEstimate):
    """Metric ego motion from one camera; its scale is not known where the vehicle never moved.

    The mounting's pitch and yaw agree with the direction of travel; its roll and position are as given.

    Attributes:
        inliers: (n - 1,) points that support the motion of each step.
        standstill: (n - 1,) whether the vehicle stood in each step.
    """

    inliers: NDArray[np.int64]
    standstill: NDArray[np.bool_]


def estimate_odometry(
    frames: NDArray[np.uint8],
    timestamps_us: NDArray[np.int64],
    camera: Camera,
    T_rig_camera: Array,
    on_progress: Progress = silent,
    settings: OdometrySettings | None = None,
) -> Odometry:
    """Recover the metric rig trajectory from a front-camera video.

    Args:
        frames: (n, H, W, 3) uint8 RGB.
        timestamps_us: (n,) int64, strictly increasing.
        camera: model of the camera at the size of the frames.
        T_rig_camera: (4, 4) mounting. Its height above ground sets the scale; its pitch and yaw may be rough.
        on_progress: told the share of the work that is done.
        settings: how much work is spent; None for the defaults.

    Raises:
        InputError: fewer than two frames, too long a gap between frames, too few points to track, or no road in view.
    """
    _check_input(timestamps_us, T_rig_camera)
    settings = settings or OdometrySettings()
    grays = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames]
    keyframes = choose_keyframes(timestamps_us)
    hidden = find_static_mask([grays[key] for key in choose_moving(grays, keyframes)], camera, T_rig_camera)
    steps = []
    for pair in track_from_keyframes(grays, keyframes, hidden, settings.corners_per_cell, settings.window):
        steps.append(estimate_step(pair, camera, T_rig_camera[2, :3]))
        on_progress(0.8 * pair.current / (len(grays) - 1))
    key_steps = [step for step in steps if step.current in set(keyframes)]
    times = (timestamps_us - timestamps_us[0]) * 1e-6
    clip = KeyframeSteps([grays[key] for key in keyframes], times[keyframes], key_steps, camera, T_rig_camera)
    path = recover_path(clip, settings.rounds)
    mounting = path.mounting
    on_progress(1.0)
    T_start_camera = _fill_between(path.T_start_key, keyframes, times, steps)
    stood = dict(zip(keyframes, ~path.moves, strict=False))
    return Odometry(
        Trajectory(timestamps_us, mounting @ T_start_camera @ invert(mounting)),
        mounting,
        path.scale_sigma,
        ODOMETRY_SETTINGS,
        np.array([np.count_nonzero(step.motion.inliers) for step in steps]),
        np.array([stood[step.key] for step in steps]),
        covariance=_in_rig_axes(path.covariance, mounting, times[keyframes], times),
        doubts=path.doubts,
    )


def choose_keyframes(timestamps_us: NDArray[np.int64]) -> list[int]:
    """Indices of frames about a tenth of a second apart, the first and the last among them, of times (n,)."""
    times = (timestamps_us - timestamps_us[0]) * 1e-6
    steps = max(1, round(times[-1] / KEYFRAME_SECONDS))
    wanted = np.linspace(0.0, times[-1], steps + 1)
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    nearest = np.where(wanted - times[after - 1] < times[after] - wanted, after - 1, after)
    return sorted({0, len(times) - 1, *nearest.tolist()})


def _check_input(timestamps_us: NDArray[np.int64], T_rig_camera: Array) -> None:
    if len(timestamps_us) < 2:
        raise InputError(f"odometry: {len(timestamps_us)} frame given, at least 2 are needed; give a longer clip")
    gaps = np.diff(timestamps_us) * 1e-6
    if gaps.max() > MAX_STEP_SECONDS:
        index = int(np.argmax(gaps))
        raise InputError(
            f"odometry: frames {index} and {index + 1} are {gaps[index]:.2f} s apart, at most {MAX_STEP_SECONDS} s can "
            "be tracked; give a video with more frames per second or cut it at the gap"
        )
    if T_rig_camera[2, 3] < MIN_CAMERA_HEIGHT:
        raise InputError(
            f"odometry: the camera is mounted {T_rig_camera[2, 3]:.2f} m above ground, at least {MIN_CAMERA_HEIGHT} m "
            "is needed; give its true height, which fixes the metric scale"
        )


def _fill_between(T_start_key: Array, keyframes: list[int], times: Array, steps: list[Step]) -> Array:
    """Poses (n, 4, 4) of all frames: between the keyframes positions run smoothly, and rotations are measured.

    What is far from a steady turn between two keyframes was measured on something that moves by itself.
    """
    rotations = Slerp(times[keyframes], Rotation.from_matrix(T_start_key[:, :3, :3]))(times).as_matrix()
    number = {key: index for index, key in enumerate(keyframes)}
    for step in steps:
        measured = T_start_key[number[step.key], :3, :3] @ step.motion.R_b_a.T
        away = Rotation.from_matrix(measured.T @ rotations[step.current]).magnitude()
        if step.current not in number and away < MOST_SHAKING:
            rotations[step.current] = measured
    return make_pose(rotations, PchipInterpolator(times[keyframes], T_start_key[:, :3, 3])(times))


def _in_rig_axes(covariance: Array, mounting: Array, key_times: Array, times: Array) -> Array:
    """Covariance (n, 6, 6) at all times of poses that are known at some, turned from camera axes to rig axes."""
    index = np.clip(np.searchsorted(key_times, times) - 1, 0, len(key_times) - 2)
    share = ((times - key_times[index]) / (key_times[index + 1] - key_times[index]))[:, None, None]
    turn = np.kron(np.eye(2), mounting[:3, :3])
    return turn @ ((1.0 - share) * covariance[index] + share * covariance[index + 1]) @ turn.T
