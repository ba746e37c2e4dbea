"""Readers of KITTI odometry sequences: one as a recording, a folder of them as a data set."""

import cv2
import numpy as np
import pytest

from olt_datasets.sources.kitti_odometry import CAMERA_POSITION
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, invert, planar_pose
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.recordings.drives import open_dataset

FRAMES, WIDTH, HEIGHT = 6, 120, 40
DRIFT = 0.05


def write_sequence(folder, times=True, names=False):
    """A drive straight ahead at 10 m/s; the camera looks a little to the left of where it goes."""
    folder.mkdir()
    (folder / "image_0").mkdir()
    for index in range(FRAMES):
        cv2.imwrite(str(folder / "image_0" / f"{index:06d}.png"), np.full((HEIGHT, WIDTH), 10 * index, np.uint8))
    first = "P0: " if names else ""
    (folder / "calib.txt").write_text(f"{first}70 0 60 0 0 70 20 0 0 0 1 0\n")
    rows = [f"1 0 0 {DRIFT * index} 0 1 0 0 0 0 1 {index}" for index in range(FRAMES)]
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    if times:
        (folder / "times.txt").write_text("\n".join(f"{100.0 + 0.1 * index:.6f}" for index in range(FRAMES)) + "\n")
    return folder


def write_poses(folder, T_world_camera):
    """A sequence of black images with these camera poses (n, 4, 4), 0.1 s apart."""
    folder.mkdir()
    (folder / "image_0").mkdir()
    black = cv2.imencode(".png", np.zeros((HEIGHT, WIDTH), np.uint8))[1].tobytes()
    for index in range(len(T_world_camera)):
        (folder / "image_0" / f"{index:06d}.png").write_bytes(black)
    (folder / "calib.txt").write_text("70 0 60 0 0 70 20 0 0 0 1 0\n")
    np.savetxt(folder / "poses.txt", (invert(T_world_camera[0]) @ T_world_camera)[:, :3].reshape(-1, 12))
    np.savetxt(folder / "times.txt", 0.1 * np.arange(len(T_world_camera)))
    return folder


def drive_ramp(degrees=98.0, metres=51.0, frames=64):
    """Poses (n, 4, 4) of the rear axle on a bend that tightens and opens again."""
    along = np.linspace(0.0, metres, 100 * (frames - 1) + 1)
    curvature = np.sin(np.pi * along / metres) ** 0.5
    yaw = np.cumsum(curvature)
    yaw *= np.radians(degrees) / yaw[-1]
    step = metres / (len(along) - 1)
    x, y = np.cumsum(step * np.cos(yaw)), np.cumsum(step * np.sin(yaw))
    return planar_pose(x[::100], y[::100], yaw[::100])


def test_sequences_are_told_by_their_images(tmp_path):
    first = write_sequence(tmp_path / "06")
    without_times = write_sequence(tmp_path / "copy", times=False)
    (without_times / "poses.txt").unlink()
    (tmp_path / "day").mkdir()
    other = write_sequence(tmp_path / "day" / "06")
    cv2.imwrite(str(other / "image_0" / f"{FRAMES // 2:06d}.png"), np.full((HEIGHT, WIDTH), 99, np.uint8))
    ids = [open_dataset(folder, tmp_path).drive(".").scene_id for folder in (first, without_times, other)]
    assert ids[0] == ids[1] != ids[2]


@pytest.mark.parametrize("names", [False, True])
def test_a_sequence_is_read_whole(tmp_path, names):
    recording = open_recording(write_sequence(tmp_path / "06", names=names))
    assert recording.source == "kitti_odometry"
    assert recording.frames.shape == (FRAMES, HEIGHT, WIDTH, 3)
    assert recording.timestamps_us.tolist() == [100_000 * index for index in range(FRAMES)]
    assert (recording.camera.fx, recording.camera.cy) == (70.0, 20.0)
    assert recording.T_rig_camera[2, 3] == 1.65
    assert recording.reference is not None


def test_the_vehicle_travels_along_rig_x(tmp_path):
    recording = open_recording(write_sequence(tmp_path / "06"), OpenOptions())
    end = recording.reference.positions[-1]
    assert end == pytest.approx([np.hypot(5.0, 5 * DRIFT), 0.0, 0.0], abs=1e-9)
    assert recording.T_rig_camera[1, 2] == pytest.approx(np.sin(np.arctan(DRIFT)), abs=1e-9)


@pytest.mark.parametrize("turn", [98.0, -98.0, 20.0])
def test_in_a_bend_it_is_the_rear_axle_that_travels_along_rig_x(tmp_path, turn):
    ramp = drive_ramp(turn)
    mounting = camera_pose_in_rig(CAMERA_POSITION, 0.0, np.radians(1.2), np.radians(-0.12))
    recording = open_recording(write_poses(tmp_path / "ramp", ramp @ mounting))
    assert recording.T_rig_camera == pytest.approx(mounting, abs=np.radians(0.05))
    assert recording.reference.path_length == pytest.approx(51.0, abs=0.02)
    missed = recording.reference.positions - (invert(ramp[0]) @ ramp)[:, :3, 3]
    assert np.abs(missed).max() < 0.03


def test_a_mounting_that_no_motion_tells_is_said_to_be_unknown(tmp_path):
    jitter = np.tile(np.eye(4), (30, 1, 1))
    jitter[:, :3, 3] = 0.01 * np.random.default_rng(0).standard_normal((30, 3))
    recording = open_recording(write_poses(tmp_path / "parked", jitter))
    assert any("where it looks is not known" in assumption for assumption in recording.assumptions)
    assert np.array_equal(recording.T_rig_camera, camera_pose_in_rig(CAMERA_POSITION, 0.0, 0.0, 0.0))


def test_without_times_the_rate_is_said_to_be_assumed(tmp_path):
    recording = open_recording(write_sequence(tmp_path / "06", times=False), OpenOptions())
    assert recording.timestamps_us[1] == pytest.approx(1e6 / 9.65, abs=1.0)
    assert any("9.65" in assumption for assumption in recording.assumptions)


def test_without_poses_there_is_no_reference(tmp_path):
    folder = write_sequence(tmp_path / "06")
    (folder / "poses.txt").unlink()
    recording = open_recording(folder, OpenOptions(duration=0.25))
    assert recording.reference is None
    assert len(recording.frames) == 3


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("poses.txt", "1 0 0 0 0 1 0 0 0 0 1\n", "poses.txt, line 1: 11 numbers instead of 12"),
        ("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "1 poses for 6 images"),
        ("times.txt", "0.0\nnow\n", "times.txt, line 2"),
        ("times.txt", "0.0\n", "1 times for 6 images"),
        ("times.txt", "0.0\n0.1\n0.1\n0.3\n0.4\n0.5\n", r"times\.txt, line 3: its time is not after"),
        ("times.txt", "0.0\nnan\n", r"times\.txt, line 2: .*not finite"),
        ("calib.txt", "", "calib.txt: is empty"),
    ],
)
def test_a_wrong_file_is_named(tmp_path, name, text, message):
    folder = write_sequence(tmp_path / "06")
    (folder / name).write_text(text)
    with pytest.raises(InputError, match=message):
        open_recording(folder, OpenOptions())


def test_a_file_that_is_no_text_is_named(tmp_path):
    folder = write_sequence(tmp_path / "06")
    (folder / "calib.txt").write_bytes(b"70 0 60 0 \xff\xfe")
    with pytest.raises(InputError, match=r"calib\.txt, line 1"):
        open_recording(folder, OpenOptions())


def test_a_damaged_image_is_named(tmp_path):
    folder = write_sequence(tmp_path / "06")
    (folder / "image_0" / "000003.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"000003\.png: cannot be decoded"):
        open_recording(folder, OpenOptions())


def test_the_tree_of_the_benchmark_is_a_data_set(tmp_path):
    sequences = tmp_path / "dataset" / "sequences"
    sequences.mkdir(parents=True)
    for name in ("06", "11"):
        (write_sequence(sequences / name) / "poses.txt").rename(tmp_path / f"{name}.txt")
    (tmp_path / "dataset" / "poses").mkdir()
    (tmp_path / "06.txt").rename(tmp_path / "dataset" / "poses" / "06.txt")
    dataset = open_dataset(tmp_path / "dataset", tmp_path / "cache")
    assert (dataset.source, dataset.keys()) == ("kitti_odometry", ["sequences/06", "sequences/11"])
    known, unknown = dataset.drive("sequences/06"), dataset.drive("sequences/11")
    assert known.ego_span_us == (0, 500_000)
    assert any("2011_09_30_drive_0020" in note for note in known.notes)
    assert unknown.ego_span_us is None
    assert dataset.open("sequences/11", (0, 200_000), OpenOptions()).reference is None
    with pytest.raises(InputError, match=r"holds 2 drives \(sequences/06, sequences/11\); give the path of one"):
        open_recording(tmp_path / "dataset")


def test_a_window_of_a_sequence_has_the_motion_of_all_of_it(tmp_path):
    dataset = open_dataset(write_sequence(tmp_path / "06"), tmp_path / "cache")
    recording = dataset.open(".", (200_000, 300_000), OpenOptions())
    assert recording.timestamps_us.tolist() == [0, 100_000]
    assert recording.frames[:, 0, 0, 0].tolist() == [20, 30]
    reference = recording.reference
    assert reference.timestamps_us.tolist() == [100_000 * index for index in range(-2, 4)]
    assert reference.path_length == pytest.approx(5.0 * np.hypot(1.0, DRIFT))
    assert np.abs(reference.T_world_rig[:, :3, :3] - np.eye(3)).max() < 1e-9
    assert np.abs(reference.positions[:, 2] - reference.positions[0, 2]).max() < 1e-9


def test_a_look_at_a_sequence(tmp_path, check_peek):
    check_peek(open_dataset(write_sequence(tmp_path / "06"), tmp_path / "cache"), ".")
