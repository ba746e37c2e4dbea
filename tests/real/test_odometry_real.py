"""Visual odometry on real drives. The bounds are generous: what is reached is printed (`pytest -s`)."""

import cv2
import numpy as np
import pytest

from olt_datasets.sources.kitti_raw import SOURCE as KITTI
from olt_datasets.sources.video import SOURCE as VIDEO
from olt_generator.cameras import PinholeCamera
from olt_generator.odometry import estimate_odometry
from olt_generator.pose_metrics import compare_trajectories, measure_smoothness
from olt_generator.poses import camera_pose_in_rig
from olt_generator.smoother import smooth_trajectory
from olt_generator.trajectory import Trajectory
from olt_toolkit.recording import OpenOptions

pytestmark = pytest.mark.slow

KITTI_DRIVE = "kitti_raw_2011_09_26_drive_0013"


def follow(recording):
    odometry = estimate_odometry(recording.frames, recording.timestamps_us, recording.camera, recording.T_rig_camera)
    return odometry, smooth_trajectory(odometry.trajectory)


@pytest.mark.parametrize(("seconds", "frames", "ate", "length_error"), [(4.2, 41, 1.5, 0.05), (20.0, 120, 2.0, 0.03)])
def test_kitti_raw_drive(shared_real, seconds, frames, ate, length_error):
    recording = KITTI.open(shared_real / KITTI_DRIVE, OpenOptions(duration=seconds))
    assert len(recording.frames) == frames
    odometry, motion = follow(recording)
    raw = compare_trajectories(odometry.trajectory, recording.reference)
    smooth = compare_trajectories(motion.trajectory, recording.reference)
    print(f"\nraw      {raw.metric}\n         {raw.sim3}\nsmoothed {smooth.metric}\n         {smooth.sim3}")
    assert smooth.metric.ate_m < ate
    assert smooth.metric.ate_m < 1.02 * raw.metric.ate_m
    assert smooth.metric.smoothness.jerk_rms_m_s3 < raw.metric.smoothness.jerk_rms_m_s3 / 10.0
    assert smooth.metric.step_rotation_deg < 0.1
    assert smooth.sim3.ate_m < 0.6
    assert abs(motion.trajectory.path_length / recording.reference.path_length - 1.0) < length_error


def test_kitti_odometry_sequence_06(shared_real):
    folder = shared_real / "kitti_odometry_06_first51_gray"
    grays = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted((folder / "image_0").iterdir())]
    full = PinholeCamera(1226, 370, 707.0912, 707.0912, 601.8873, 183.1104)
    small = [cv2.resize(gray, (832, 251), interpolation=cv2.INTER_AREA) for gray in grays]
    frames = np.repeat(np.stack(small)[..., None], 3, axis=-1)
    timestamps_us = np.arange(len(frames), dtype=np.int64) * 103_600
    mounting = camera_pose_in_rig([1.08, 0.32, 1.65], 0.0, 0.0, 0.0)
    odometry = estimate_odometry(frames, timestamps_us, full.resized(832, 251), mounting)
    camera_poses = odometry.trajectory.T_world_rig @ odometry.T_rig_camera
    rows = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    true = np.concatenate([rows, np.tile([[[0.0, 0.0, 0.0, 1.0]]], (len(rows), 1, 1))], axis=1)
    errors = compare_trajectories(Trajectory(timestamps_us, camera_poses), Trajectory(timestamps_us, true))
    print(f"\n{errors.metric}\n{errors.sim3}")
    assert errors.metric.ate_m < 1.0
    assert errors.sim3.ate_m < 0.4
    assert errors.sim3.scale == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(
    ("name", "field_of_view", "lowest", "highest"),
    [
        ("highway_solid_white_right_960x540_25fps.mp4", 70.0, 20.0, 35.0),
        ("urban_front_wide_1920x1080_30fps.mp4", 120.0, 0.0, 15.0),
        ("urban_front_wide_1920x1080_30fps.mp4", 70.0, 0.0, 20.0),
    ],
)
def test_dashcam_videos_give_a_metric_trajectory(shared_real, name, field_of_view, lowest, highest):
    path = shared_real / "dashcam_videos" / name
    recording = VIDEO.open(path, OpenOptions(horizontal_fov=np.radians(field_of_view)))
    odometry, motion = follow(recording)
    speed = np.linalg.norm(motion.velocity, axis=1)
    print(f"\n{name}: {motion.trajectory.path_length:.1f} m, {speed.min():.2f} to {speed.max():.2f} m/s")
    print(f"{measure_smoothness(odometry.trajectory)}\n{measure_smoothness(motion.trajectory)}")
    assert lowest <= speed.min() <= speed.max() <= highest
    assert np.all(np.isfinite(motion.trajectory.T_world_rig))
    assert 0.0 < odometry.scale_sigma < 0.2


def test_highway_speed_is_steady(shared_real):
    path = shared_real / "dashcam_videos" / "highway_solid_white_right_960x540_25fps.mp4"
    _, motion = follow(VIDEO.open(path, OpenOptions(duration=4.0)))
    speed = np.linalg.norm(motion.velocity, axis=1)
    assert speed.std() < 0.05 * speed.mean()
