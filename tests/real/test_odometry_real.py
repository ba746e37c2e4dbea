"""Visual odometry on real drives. The bounds are generous: what is reached is printed (`pytest -s`)."""

import numpy as np
import pytest

from olt_generator.errors import InputError
from olt_generator.motion.odometry import estimate_odometry
from olt_generator.motion.pose_metrics import measure_smoothness
from olt_generator.motion.smoother import smooth_trajectory
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.clips.trajectory_errors import measure_clips, summarize_clips

pytestmark = pytest.mark.slow

KITTI_DRIVE = "kitti_raw_2011_09_26_drive_0013"


def follow(recording):
    odometry = estimate_odometry(recording.frames, recording.timestamps_us, recording.camera, recording.T_rig_camera)
    return odometry, smooth_trajectory(odometry.trajectory)


def is_right_or_marked(motion, limit=4.0):
    """Whether a motion errs by fewer than so many of its stated standard deviations, or says that it may err more."""
    numbers = motion.to_dict()
    scale_z, ate_z = numbers["scale_z"], numbers["ate_z"]
    print(
        f"scale {scale_z:+.2f} sigma, ATE {motion.errors.metric.ate_m:.2f} m = {ate_z:.2f} sigma; {numbers['doubts']}"
    )
    return bool(motion.doubts) or (abs(scale_z) < limit and ate_z < limit)


def mean_over_clips(recording, stride):
    motions = measure_clips(recording, 41, stride)
    summary = summarize_clips(motions)
    print(f"\n{summary}")
    for motion in motions:
        # Smoothing costs a centimetre or two at most.
        assert motion.errors.metric.ate_m < 1.05 * motion.measured_errors.metric.ate_m + 0.02
        assert motion.errors.sim3.ate_m < 0.2
        assert is_right_or_marked(motion)
        assert motion.doubts == ()
        assert motion.to_dict()["jerk_factor"] > 16.7
    return summary


def test_clips_of_a_kitti_raw_drive(shared_real):
    recording = open_recording(shared_real / KITTI_DRIVE, OpenOptions())
    summary = mean_over_clips(recording, 19)
    assert summary["clips"] == 5
    assert summary["mean_ate_m"] < 0.6
    assert summary["mean_step_translation_percent"] < 2.2


def test_clips_of_kitti_odometry_sequence_06(shared_real):
    recording = open_recording(shared_real / "kitti_odometry_06_first51_gray", OpenOptions())
    summary = mean_over_clips(recording, 5)
    assert summary["clips"] == 3
    assert summary["mean_ate_m"] < 0.4
    assert summary["mean_step_translation_percent"] < 1.0


def test_a_whole_kitti_raw_drive(shared_real):
    recording = open_recording(shared_real / KITTI_DRIVE, OpenOptions())
    (motion,) = measure_clips(recording, None, None)
    assert motion.errors.metric.ate_m < 1.0
    assert motion.errors.metric.drift_percent < 1.0
    assert motion.errors.metric.step_rotation_deg < 0.05
    numbers = motion.to_dict()
    assert abs(numbers["scale_z"]) < 4.0
    # Smoothing leaves as much acceleration as it leaves the truth.
    assert 0.8 < numbers["acceleration_variance_over_reference_smoothed"] < 1.2
    noise = motion.label_noise
    assert 0.7 < noise.actual.acceleration / noise.expected.acceleration < 1.3
    # Drift of heading is stated with a margin: on this drive curvature errs by half of it.
    assert 0.4 < noise.actual.curvature / noise.expected.curvature < 1.3


def test_slow_traffic_drives_forward(shared_real):
    """Between vehicles that move: 7.7 m, braking to a halt, with few points on anything that stands."""
    recording = open_recording(shared_real / "kitti_slow_traffic_lidar_poses", OpenOptions())
    (motion,) = measure_clips(recording, None, None)
    assert is_right_or_marked(motion)
    assert motion.smoothed.trajectory.positions[-1, 0] > 6.0
    assert motion.errors.metric.ate_m < 1.0


def test_a_drive_shown_backwards_in_time_is_a_camera_that_looks_back(shared_real):
    recording = open_recording(shared_real / "kitti_odometry_06_first51_gray", OpenOptions())
    backwards = estimate_odometry(
        recording.frames[::-1], recording.timestamps_us, recording.camera, recording.T_rig_camera
    )
    assert backwards.trajectory.positions[-1, 0] < -0.9 * recording.reference.path_length
    assert [doubt.what for doubt in backwards.doubts] == ["view direction"]
    assert backwards.scale_sigma > 0.5


def test_a_picture_upside_down_is_doubted_or_refused(shared_real):
    recording = open_recording(shared_real / KITTI_DRIVE, OpenOptions())
    try:
        upside = estimate_odometry(
            recording.frames[:60, ::-1, ::-1], recording.timestamps_us[:60], recording.camera, recording.T_rig_camera
        )
    except InputError:
        return
    print(upside.trajectory.positions[-1], upside.doubts)
    assert upside.doubts


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
    recording = open_recording(path, OpenOptions(horizontal_fov=np.radians(field_of_view)))
    odometry, motion = follow(recording)
    speed = np.linalg.norm(motion.velocity, axis=1)
    print(f"\n{name}: {motion.trajectory.path_length:.1f} m, {speed.min():.2f} to {speed.max():.2f} m/s")
    print(f"{measure_smoothness(odometry.trajectory)}\n{measure_smoothness(motion.trajectory)}")
    assert lowest <= speed.min() <= speed.max() <= highest
    assert np.all(np.isfinite(motion.trajectory.T_world_rig))
    assert 0.0 < odometry.scale_sigma < 0.2


def test_highway_speed_is_steady(shared_real):
    path = shared_real / "dashcam_videos" / "highway_solid_white_right_960x540_25fps.mp4"
    _, motion = follow(open_recording(path, OpenOptions(duration=4.0)))
    speed = np.linalg.norm(motion.velocity, axis=1)
    assert speed.std() < 0.05 * speed.mean()
