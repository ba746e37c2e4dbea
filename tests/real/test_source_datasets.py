"""Data sets of front cameras and of trajectories, on real files."""

import shutil

import numpy as np
import pytest

from olt_datasets.sources.argoverse2 import DATASET as ARGOVERSE2
from olt_generator.poses import yaw_of
from olt_generator.video import read_video
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.recordings.drives import open_dataset

NARROW = OpenOptions(width=160)


def test_the_kitti_raw_drive(shared_real, tmp_path):
    folder = shared_real / "kitti_raw_2011_09_26_drive_0013"
    dataset = open_dataset(folder, tmp_path)
    drive = dataset.drive(".")
    assert drive.scene_id == "kitti_raw/9040faf20ffbeb965d47"
    assert len(drive.front_us) == 120
    # Not at 10 Hz: 0.1034 s apart by the drive's own time stamps.
    assert np.median(np.diff(drive.front_us)) == pytest.approx(103_400, abs=500)
    window = tuple(drive.front_us[[5, 9]].tolist())
    recording = dataset.open(".", window, NARROW)
    assert len(recording.frames) == 5
    reference = recording.reference
    assert reference.path_length == pytest.approx(139.5, abs=0.5)
    assert (reference.timestamps_us[0], reference.timestamps_us[-1]) == (-window[0], drive.front_us[-1] - window[0])
    beginning = open_recording(folder, OpenOptions(width=160, duration=1.0))
    assert np.array_equal(recording.frames, beginning.frames[5:10])
    poses = reference.in_first_frame().T_world_rig[: len(beginning.frames)]
    assert np.allclose(poses, beginning.reference.T_world_rig, atol=1e-9)


@pytest.mark.parametrize(
    "name",
    [
        "kitti_raw_2011_09_26_drive_0013",
        "kitti_odometry_06_first51_gray",
        "argoverse2_motion_scenario_0a1e6f0a",
        "argoverse2_sensor_log_7fab2350",
    ],
)
def test_a_drive_keeps_its_scene_under_another_name(shared_real, tmp_path, name):
    scene_id = open_dataset(shared_real / name).drive(".").scene_id
    copy, link = tmp_path / "day" / "01", tmp_path / "link"
    shutil.copytree(shared_real / name, copy)
    link.symlink_to(copy)
    assert open_dataset(copy).drive(".").scene_id == scene_id
    assert open_dataset(link).drive(".").scene_id == scene_id
    folder = open_dataset(tmp_path / "day")
    assert [folder.drive(key).scene_id for key in folder.keys()] == [scene_id]  # noqa: SIM118 - a data set is no dict


def test_the_kitti_odometry_sequence(shared_real, tmp_path):
    dataset = open_dataset(shared_real / "kitti_odometry_06_first51_gray", tmp_path)
    drive = dataset.drive(".")
    assert (dataset.source, len(drive.front_us)) == ("kitti_odometry", 51)
    recording = dataset.open(".", (1_000_000, 2_000_000), NARROW)
    assert recording.reference.path_length == pytest.approx(59.9, abs=0.1)
    # A level street in a world whose z is up.
    assert np.abs(recording.reference.positions[:, 2] - recording.reference.positions[0, 2]).max() < 1.0


@pytest.mark.parametrize(
    ("name", "count", "period"),
    [("highway_solid_white_right_960x540_25fps", 221, 40_000), ("urban_front_wide_1920x1080_30fps", 150, 33_333)],
)
def test_the_dashcam_videos(shared_real, tmp_path, name, count, period):
    """The second one has B-frames and a single key frame."""
    dataset = open_dataset(shared_real / "dashcam_videos", tmp_path)
    drive = dataset.drive(f"{name}.mp4")
    assert len(drive.front_us) == count
    assert np.diff(drive.front_us) == pytest.approx(period, abs=1)
    given = OpenOptions(width=160, horizontal_fov=1.2)
    recording = dataset.open(f"{name}.mp4", (1_000_000, 1_500_000), given)
    whole = read_video(shared_real / "dashcam_videos" / f"{name}.mp4", 160, 2.0)
    inside = (whole.timestamps_us >= 1_000_000) & (whole.timestamps_us <= 1_500_000)
    assert np.array_equal(recording.frames, whole.frames[inside])
    assert np.array_equal(recording.timestamps_us, whole.timestamps_us[inside] - whole.timestamps_us[inside][0])


@pytest.mark.parametrize(
    ("name", "span_us", "length"),
    [("argoverse2_motion_scenario_0a1e6f0a", 10_900_000, 56.2), ("argoverse2_sensor_log_7fab2350", 15_950_000, 75.0)],
)
def test_the_argoverse2_drives(shared_real, tmp_path, name, span_us, length):
    """They are as long as the recorded speeds of the ego say, and do not slide sideways."""
    dataset = ARGOVERSE2.open(shared_real / name, tmp_path)
    drive = dataset.drive(".")
    assert drive.front_us.size == 0
    assert drive.ego_span_us[1] == pytest.approx(span_us, abs=50_000)
    ego = dataset.ego_motion(".")
    assert ego.path_length == pytest.approx(length, rel=0.03)
    times_us = np.arange(0, ego.timestamps_us[-1], 100_000)
    poses = ego.interpolate(times_us)
    velocity = np.gradient(poses[:, :2, 3], 0.1, axis=0)
    heading = yaw_of(poses)
    sideways = -velocity[:, 0] * np.sin(heading) + velocity[:, 1] * np.cos(heading)
    assert np.sqrt(np.mean(sideways**2)) < 0.15


def test_a_folder_of_everything_is_that_of_the_asked_reader(shared_real, tmp_path):
    keys = {name: open_dataset(shared_real, tmp_path, name).keys() for name in ("kitti_raw", "argoverse2")}
    assert keys["kitti_raw"] == ["kitti_raw_2011_09_26_drive_0013"]
    assert keys["argoverse2"] == ["argoverse2_motion_scenario_0a1e6f0a", "argoverse2_sensor_log_7fab2350"]
