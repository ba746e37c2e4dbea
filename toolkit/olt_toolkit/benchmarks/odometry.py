"""Visual odometry through a street that is ray-cast exactly: error of the motion against features and window."""

from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, PinholeCamera
from olt_generator.motion.odometry import OdometrySettings, estimate_odometry
from olt_generator.motion.pose_metrics import compare_trajectories
from olt_generator.poses import Array, camera_pose_in_rig, planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.bench.benchmark import Benchmark, list_settings
from olt_toolkit.benchmarks.street import render_street

FRAMES, SECONDS_APART = 21, 0.1
CAMERA: Camera = PinholeCamera.from_field_of_view(416, 240, float(np.radians(80.0)))
MOUNTING = camera_pose_in_rig([1.5, 0.0, 1.5], 0.0, float(np.radians(1.0)), 0.0)
NOISE_LEVELS = 2.0
DEFAULT = "6 rounds, window 10, 4 corners a cell"
SETTINGS = {
    "each step on its own": OdometrySettings(rounds=0),
    "2 rounds": OdometrySettings(rounds=2),
    DEFAULT: OdometrySettings(),
    "12 rounds": OdometrySettings(rounds=12),
    "window 3": OdometrySettings(window=3),
    "window 20": OdometrySettings(window=20),
    "1 corner a cell": OdometrySettings(corners_per_cell=1),
    "8 corners a cell": OdometrySettings(corners_per_cell=8),
}


@lru_cache(maxsize=1)
def make_drive() -> tuple[NDArray[np.uint8], Trajectory]:
    """Frames (n, H, W, 3) with the noise of a sensor, and the true path: 17 m at 8.5 m/s along a gentle bend."""
    seconds = SECONDS_APART * np.arange(FRAMES)
    yaw = 0.03 * seconds
    T_world_rig = planar_pose(8.5 * seconds - 8.0, 0.5 * 8.5 * 0.03 * seconds**2 - 0.4, yaw)
    frames = []
    for index, pose in enumerate(T_world_rig):
        image = render_street(CAMERA, pose @ MOUNTING)[0]
        noise = NOISE_LEVELS * np.random.default_rng(index).standard_normal(image.shape)
        frames.append(np.clip(image + noise, 0.0, 255.0).astype(np.uint8))
    timestamps_us = np.round(1e6 * seconds).astype(np.int64)
    return np.stack(frames), Trajectory(timestamps_us, T_world_rig)


def follow(settings: OdometrySettings) -> Array:
    """Estimated poses (n, 4, 4)."""
    frames, true = make_drive()
    return estimate_odometry(frames, true.timestamps_us, CAMERA, MOUNTING, settings=settings).trajectory.T_world_rig


def measure_error(poses: Array) -> float:
    """Mean error of a step of poses (n, 4, 4) in percent of its length, after Sim(3) alignment: the scale is out."""
    _, true = make_drive()
    aligned = compare_trajectories(Trajectory(true.timestamps_us, poses), true).sim3
    assert aligned is not None and aligned.step_translation_percent is not None  # the drive moves
    return aligned.step_translation_percent


BENCHMARK = Benchmark(
    title=f"Odometry over {FRAMES} frames of {CAMERA.width} x {CAMERA.height} pixels",
    error_name="error of a step after Sim(3) alignment",
    error_unit="%",
    reference="the path along which the frames were ray-cast",
    settings=lambda: list_settings(
        make_drive, {name: partial(follow, settings) for name, settings in SETTINGS.items()}, default=DEFAULT
    ),
    measure_error=measure_error,
)
