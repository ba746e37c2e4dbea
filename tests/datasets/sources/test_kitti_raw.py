"""KITTI raw drives: one as a recording, a folder of them as a data set."""

import shutil

import cv2
import numpy as np
import pytest

from olt_generator.cameras import PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import invert, transform
from olt_generator.video import write_video
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.recordings.drives import DatasetPlace, find_drives, find_reader, open_dataset

WIDTH, HEIGHT, FRAMES = 120, 40, 6
# A camera 0.6 m to the right of the velodyne and 0.1 m below it, looking forward; the IMU 0.8 m behind the velodyne.
CALIBRATION = {
    "calib_cam_to_cam.txt": (
        "calib_time: 09-Jan-2012 13:57:47\n"
        f"S_rect_02: {WIDTH}.0 {HEIGHT}.0\n"
        "R_rect_00: 1 0 0 0 1 0 0 0 1\n"
        "P_rect_02: 70 0 60 7.0 0 70 20 0 0 0 1 0\n"
    ),
    "calib_velo_to_cam.txt": "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.1 -0.3\n",
    "calib_imu_to_velo.txt": "R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n",
}


def write_video_file(path, count=5, size=(36, 64)):
    frames = np.random.default_rng(0).integers(0, 255, (count, *size, 3), dtype=np.uint8)
    write_video(path, frames, 30)
    return path


def stamp(tenths, offset_ns=0):
    return f"2011-09-26 13:10:5{tenths // 10}.{(tenths % 10) * 100_000_000 + offset_ns:09d}"


def write_drive(folder, official=False):
    """A drive north at 10 m/s; the IMU's nose is 1 degree below the direction of travel."""
    drive = folder / "2011_09_26" / "2011_09_26_drive_0001_sync" if official else folder / "drive"
    images, oxts = (drive / "image_02/data", drive / "oxts/data") if official else (drive / "image_02", drive / "oxts")
    times = drive / ("image_02/timestamps.txt" if official else "image_02_timestamps.txt")
    oxts_times = drive / ("oxts/timestamps.txt" if official else "oxts_timestamps.txt")
    for made in (images, oxts):
        made.mkdir(parents=True)
    for name, text in CALIBRATION.items():
        ((drive.parent if official else drive) / name).write_text(text)
    for index in range(FRAMES):
        picture = np.full((HEIGHT, WIDTH, 3), (10, 20, 200), dtype=np.uint8)
        cv2.imwrite(str(images / f"{index:010d}.png"), picture)
        latitude = 49.0 + np.degrees(1.0 * index / 6378137.0)
        values = [latitude, 8.0, 100.0, 0.0, np.radians(1.0), np.pi / 2] + [0.0] * 24
        (oxts / f"{index:010d}.txt").write_text(" ".join(repr(float(v)) for v in values))
    times.write_text("\n".join(stamp(k, offset_ns=1_499) for k in range(FRAMES)) + "\n")
    oxts_times.write_text("\n".join(stamp(k, offset_ns=10_000_000) for k in range(FRAMES)) + "\n")
    return drive


def test_readers_know_their_own(tmp_path):
    drive = write_drive(tmp_path)
    assert find_reader(drive).name == "kitti_raw"
    assert find_reader(write_video_file(tmp_path / "dash.mp4")).name == "video"
    (tmp_path / "notes.txt").write_text("no video")
    assert find_reader(tmp_path / "notes.txt") is None


@pytest.mark.parametrize("official", [False, True])
def test_kitti_drive(tmp_path, official):
    drive = write_drive(tmp_path, official)
    recording = open_recording(drive, OpenOptions(width=60))
    assert recording.frames.shape == (FRAMES, 20, 60, 3)
    assert recording.frames[0, 0, 0].tolist() == [200, 20, 10]
    assert recording.timestamps_us.tolist() == [100_000 * k for k in range(FRAMES)]
    assert recording.camera == PinholeCamera(WIDTH, HEIGHT, 70, 70, 60, 20).resized(60, 20)


def test_kitti_mounting_follows_the_calibration_and_the_direction_of_travel(tmp_path):
    recording = open_recording(write_drive(tmp_path), OpenOptions())
    # By hand: camera 2 lies 0.1 m left of camera 0 (P[0, 3] = 7 = f * 0.1), which lies 0.3 m ahead of the velodyne.
    in_imu = np.array([0.8 + 0.3, -0.3 + 0.1, 0.8 - 0.1])
    pitch = np.radians(1.0)
    expected = [in_imu[0] * np.cos(pitch) + in_imu[2] * np.sin(pitch), in_imu[1]]
    assert recording.T_rig_camera[:2, 3] == pytest.approx(expected, abs=1e-3)
    height = 0.93 + in_imu[2] * np.cos(pitch) - in_imu[0] * np.sin(pitch)
    assert recording.T_rig_camera[2, 3] == pytest.approx(height, abs=1e-3)
    assert recording.T_rig_camera[:3, 2] == pytest.approx([np.cos(pitch), 0.0, -np.sin(pitch)], abs=1e-3)


def test_kitti_reference_is_metric_and_reaches_every_image(tmp_path):
    recording = open_recording(write_drive(tmp_path), OpenOptions())
    assert np.array_equal(recording.reference.timestamps_us, recording.timestamps_us)
    assert recording.reference.positions[:, 0] == pytest.approx(np.arange(FRAMES) * 1.0, abs=2e-3)
    assert np.abs(recording.reference.positions[:, 1:]).max() < 2e-3


def test_kitti_projection_chain(tmp_path):
    recording = open_recording(write_drive(tmp_path), OpenOptions())
    T_imu_rig = invert(recording.T_rig_camera)
    point_camera = np.array([[1.0, 0.5, 10.0]])
    back = transform(T_imu_rig, transform(recording.T_rig_camera, point_camera))
    assert back == pytest.approx(point_camera)
    pixels, seen = recording.camera.project(point_camera)
    assert pixels[0] == pytest.approx([67.0, 23.5])
    assert seen[0]


def test_duration_limits_the_drive(tmp_path):
    recording = open_recording(write_drive(tmp_path), OpenOptions(duration=0.25))
    assert len(recording.frames) == len(recording.reference) == 3


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("calib_cam_to_cam.txt", "P_rect_02", "P_rect_99", "calib_cam_to_cam.txt: field P_rect_02 is missing"),
        ("calib_cam_to_cam.txt", "70 0 60", "70 60", "field P_rect_02: has 11 numbers, 12"),
        ("calib_velo_to_cam.txt", "-0.3", "minus", "calib_velo_to_cam.txt: field T: .*minus"),
        ("calib_imu_to_velo.txt", "0.3", "nan", "calib_imu_to_velo.txt: field T: .*finite"),
        ("calib_cam_to_cam.txt", "120.0 40.0", "130.0 40.0", "is 120 x 40 pixels, S_rect_02"),
        ("image_02_timestamps.txt", "13:10:50.2", "13:70:50.2", "line 3: .*no time of the form"),
        ("image_02_timestamps.txt", "13:10:50.2", "13:10:50.0", "line 3: its time is not after the one before it"),
        ("oxts/0000000002.txt", "100.0", "", "0000000002.txt: has 29 numbers, 30"),
    ],
)
def test_a_wrong_file_is_named_with_its_field(tmp_path, name, old, new, message):
    drive = write_drive(tmp_path)
    text = (drive / name).read_text()
    assert old in text
    (drive / name).write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as caught:
        open_recording(drive, OpenOptions())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["calib_velo_to_cam.txt", "oxts_timestamps.txt", "oxts/0000000003.txt"])
def test_a_missing_file_is_refused(tmp_path, name):
    drive = write_drive(tmp_path)
    (drive / name).unlink()
    with pytest.raises(InputError, match=r"missing|5 GPS/IMU files for 6 timestamps"):
        open_recording(drive, OpenOptions())


def test_a_damaged_image_is_named(tmp_path):
    drive = write_drive(tmp_path)
    shutil.copy(drive / "image_02_timestamps.txt", drive / "image_02/0000000004.png")
    with pytest.raises(InputError, match=r"0000000004.png: cannot be decoded"):
        open_recording(drive, OpenOptions())


def test_kitti_drives_of_a_folder(tmp_path):
    write_drive(tmp_path / "raw", official=True)
    dataset = open_dataset(tmp_path / "raw", tmp_path / "cache")
    key = "2011_09_26/2011_09_26_drive_0001_sync"
    assert (dataset.source, dataset.keys()) == ("kitti_raw", [key])
    drive = dataset.drive(key)
    assert drive.scene_id.startswith("kitti_raw/")
    assert drive.front_us.tolist() == [100_000 * k for k in range(FRAMES)]
    assert drive.ego_span_us == (0, 500_000)
    assert drive.country == "DE"


def test_drives_are_told_by_their_times_and_their_first_image(tmp_path):
    drive, official = write_drive(tmp_path / "a"), write_drive(tmp_path / "b", official=True)
    scene_id = open_dataset(drive).drive(".").scene_id
    assert open_dataset(official).drive(".").scene_id == scene_id
    moved = drive.rename(tmp_path / "2011_10_03_drive_0042")
    assert open_dataset(moved).drive(".").scene_id == scene_id
    times, image = moved / "image_02_timestamps.txt", moved / "image_02" / "0000000000.png"
    written = times.read_text()
    times.write_text(written.replace("13:10:5", "13:20:5"))
    assert open_dataset(moved).drive(".").scene_id != scene_id
    times.write_text(written)
    cv2.imwrite(str(image), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    assert open_dataset(moved).drive(".").scene_id != scene_id


def test_the_drives_of_a_folder_are_its_recordings_or_those_of_the_data_set(tmp_path):
    (tmp_path / "mixed").mkdir()
    drive = write_drive(tmp_path / "mixed")
    write_video_file(tmp_path / "mixed" / "dash.mp4")
    assert find_drives(drive) == [(DatasetPlace(drive), ".")]
    assert [place.drive_name(key) for place, key in find_drives(tmp_path / "mixed")] == ["dash", "drive"]
    write_drive(tmp_path / "raw", official=True)
    key = "2011_09_26/2011_09_26_drive_0001_sync"
    assert find_drives(tmp_path / "raw") == [(DatasetPlace(tmp_path / "raw"), key)]
    assert DatasetPlace(tmp_path / "raw").drive_name(key) == "2011_09_26_drive_0001_sync"


def test_a_window_of_a_kitti_drive_has_the_motion_of_all_of_it(tmp_path):
    dataset = open_dataset(write_drive(tmp_path), tmp_path / "cache")
    assert dataset.keys() == ["."]
    recording = dataset.open(".", (150_000, 400_000), OpenOptions(width=60))
    assert recording.timestamps_us.tolist() == [0, 100_000, 200_000]
    assert recording.frames.shape == (3, 20, 60, 3)
    assert recording.reference.timestamps_us.tolist() == [-200_000, -100_000, 0, 100_000, 200_000, 300_000]
    whole = open_recording(tmp_path / "drive", OpenOptions())
    assert np.allclose(recording.reference.in_first_frame().T_world_rig, whole.reference.T_world_rig, atol=1e-9)
    assert np.array_equal(recording.T_rig_camera, whole.T_rig_camera)


def test_describing_a_kitti_drive_notices_what_is_missing(tmp_path):
    drive = write_drive(tmp_path)
    dataset = open_dataset(drive, tmp_path / "cache")
    (drive / "image_02" / "0000000002.png").unlink()
    with pytest.raises(InputError, match="5 images for 6 timestamps"):
        dataset.drive(".")
    with pytest.raises(InputError, match="no KITTI drive 'other'"):
        dataset.drive("other")


def test_a_drive_that_stands_does_not_tell_how_the_imu_is_turned(tmp_path):
    drive = write_drive(tmp_path)
    assert not any("not known" in assumption for assumption in open_recording(drive).assumptions)
    parked = (drive / "oxts" / f"{0:010d}.txt").read_text()
    for file in (drive / "oxts").iterdir():
        file.write_text(parked)
    recording = open_recording(drive)
    assert any("how the IMU is turned against it is not known" in assumption for assumption in recording.assumptions)
    assert np.abs(recording.reference.positions).max() < 1e-9


def test_velocities_take_the_wander_out_of_positions(tmp_path):
    drive = write_drive(tmp_path)
    random = np.random.default_rng(0)
    for index in range(FRAMES):
        north = 1.0 * index + 0.2 * random.standard_normal()
        values = [49.0 + np.degrees(north / 6378137.0), 8.0, 100.0, 0.0, np.radians(1.0), np.pi / 2] + [0.0] * 24
        values[6], values[23], values[24] = 10.0, 0.2, 0.02
        (drive / "oxts" / f"{index:010d}.txt").write_text(" ".join(repr(float(v)) for v in values))
    recording = open_recording(drive)
    assert np.diff(recording.reference.positions[:, 0]) == pytest.approx(np.full(FRAMES - 1, 1.0), abs=0.01)
    assert not any("positions alone" in assumption for assumption in recording.assumptions)


def test_positions_of_unknown_accuracy_are_taken_alone_and_said_to_be(tmp_path):
    recording = open_recording(write_drive(tmp_path))
    assert any("positions alone are the reference" in assumption for assumption in recording.assumptions)


def test_a_look_at_a_kitti_drive(tmp_path, check_peek):
    dataset = open_dataset(write_drive(tmp_path), tmp_path / "cache")
    check_peek(dataset, ".")
    (tmp_path / "drive" / "image_02" / "0000000001.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"0000000001\.png: cannot be decoded"):
        check_peek(dataset, ".")
