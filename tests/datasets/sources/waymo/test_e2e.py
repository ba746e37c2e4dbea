"""The Waymo E2E data set: shuffled shards to drives."""

import struct

import numpy as np
import pytest

from olt_datasets.sources.waymo import index
from olt_generator.errors import InputError
from olt_generator.poses import invert, yaw_of
from olt_toolkit.recordings.drives import open_dataset
from olt_toolkit.recordings.recording import OpenOptions
from olt_toolkit.rigs.rig import CAMERA_INDEX, CROSS_LEFT, FRONT_TELE, FRONT_WIDE, POLICY_CAMERAS

WHOLE = (-10_000_000, 60_000_000)
FRONT_ONLY = OpenOptions(views=())


def true_poses(drive, times_us, start=0.0):
    """Positions (n, 2) and yaws (n,) relative to the pose at `start` seconds."""
    origin, yaw = drive.pose(start)
    back = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    poses = [drive.pose(start + time_us * 1e-6) for time_us in times_us]
    return np.array([back @ (position - origin) for position, _ in poses]), np.array([turn - yaw for _, turn in poses])


def test_drives_are_put_together_from_all_shards(open_shards, make_records, make_drive):
    dataset = open_shards([*make_records("b", 12), *make_records("a", 7, make_drive(standing=True), first=3)])
    assert dataset.source == "waymo_e2e"
    assert dataset.keys() == ["a", "b"]
    drive = dataset.drive("b")
    assert drive.front_us.tolist() == [100_000 * k for k in range(12)]
    assert drive.scene_id == "waymo_e2e/b"
    assert drive.split == "train"
    assert drive.ego_span_us == (-3_750_000, 1_100_000 + 5_000_000)
    assert drive.cameras[0] == "FRONT"
    assert len(drive.cameras) == 8
    assert drive.category == "unlabelled"
    assert dataset.drive("a").front_us.tolist() == [100_000 * k for k in range(7)]


def test_the_trajectory_is_that_of_the_drive(open_shards, make_records, make_drive):
    """100 chained frames: nowhere more than a centimetre and a twentieth of a degree off."""
    drive = make_drive()
    recording = open_shards(make_records("a", 100, cameras=(1,))).open("a", (0, 200_000), FRONT_ONLY)
    times_us = recording.reference.timestamps_us
    positions, yaws = true_poses(drive, times_us)
    assert (times_us[0], times_us[-1]) == (-3_750_000, 14_900_000)
    in_frames = (times_us >= 0) & (times_us <= 9_900_000)
    errors = np.linalg.norm(recording.reference.positions[:, :2] - positions, axis=1)
    turns = np.abs(yaw_of(recording.reference.T_world_rig) - yaws)
    assert errors[in_frames].max() < 0.01
    assert np.degrees(turns[in_frames].max()) < 0.05
    assert errors.max() < 0.02
    assert np.degrees(turns.max()) < 0.6


def test_a_standing_car_does_not_turn(open_shards, make_records, make_drive):
    reference = open_shards(make_records("a", 5, make_drive(standing=True))).open("a", WHOLE, FRONT_ONLY).reference
    assert np.abs(reference.positions).max() < 1e-6
    assert np.abs(yaw_of(reference.T_world_rig)).max() == 0.0


def test_a_car_that_backs_up_keeps_its_heading(open_shards, make_frame):
    """The only frame: forwards until now, backwards from then on."""
    past = np.stack([np.linspace(-6.0, 0.0, 16), np.zeros(16)], -1)
    future = np.stack([-np.linspace(0.2, 4.0, 20), np.zeros(20)], -1)
    reference = open_shards([make_frame("a-000", past, future)]).open("a", WHOLE, FRONT_ONLY).reference
    assert np.abs(yaw_of(reference.T_world_rig)).max() < 1e-6


def test_a_window_begins_at_its_first_image(open_shards, make_records, make_drive):
    recording = open_shards(make_records("a", 12)).open("a", (250_000, 700_000), OpenOptions(width=24, views=()))
    assert recording.timestamps_us.tolist() == [0, 100_000, 200_000, 300_000, 400_000]
    assert recording.frames.shape == (5, 32, 24, 3)
    assert recording.frames[:, 0, 0, 0] == pytest.approx([13, 14, 15, 16, 17], abs=2)
    positions, yaws = true_poses(make_drive(), recording.reference.timestamps_us, start=0.3)
    T_start_rig = invert(recording.reference.interpolate(np.array([0]))) @ recording.reference.T_world_rig
    assert np.allclose(T_start_rig[:, :2, 3], positions, atol=0.02)
    assert np.allclose(yaw_of(T_start_rig), yaws, atol=0.01)


def test_the_front_camera_is_found_by_name_and_looks_ahead(open_shards, make_records):
    recording = open_shards(make_records("a", 2)).open("a", WHOLE, FRONT_ONLY)
    assert recording.camera.fx == 40.0
    # The middle of Waymo's image is at width / 2, counted from the left edge of the first pixel.
    ray = recording.camera.rays(np.array([[23.5, 31.5]]))[0]
    assert recording.T_rig_camera[:3, :3] @ ray == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)
    assert recording.T_rig_camera[:3, 3] == pytest.approx([1.5, 0.1, 2.0])
    assert recording.T_rig_camera[:3, :3] @ [1.0, 0.0, 0.0] == pytest.approx([0.0, -1.0, 0.0])


def test_views_of_the_target_rig_are_mosaics_of_all_cameras(open_shards, make_records):
    """Each camera of the test's frames is of one grey, 100 and ten times its number at frame 100."""
    dataset = open_shards(make_records("a", 2, first=100))
    assert set(dataset.drive("a").true_views) == set(CAMERA_INDEX)
    recording = dataset.open("a", WHOLE, OpenOptions(width=32))
    assert list(recording.views) == list(POLICY_CAMERAS)
    left = recording.views[CROSS_LEFT]
    assert left.shape == (2, 18, 32, 3)
    # It looks 66 degrees to the left: right of its middle FRONT_LEFT is nearer, left of it SIDE_LEFT.
    assert left[0, 8, 22] == pytest.approx([120] * 3, abs=3)
    assert left[0, 8, 8] == pytest.approx([140] * 3, abs=3)
    assert recording.views[FRONT_TELE][0, 8, 15] == pytest.approx([110] * 3, abs=3)
    assert recording.mounted[CROSS_LEFT].camera.width == 32
    unseen = ~recording.observed[CROSS_LEFT]
    assert 0 < unseen.mean() < 0.2
    assert not left[:, unseen].any()


def test_without_side_cameras_only_the_front_is_true(open_shards, make_records):
    drive = open_shards(make_records("a", 2, cameras=(1,))).drive("a")
    assert drive.cameras == ("FRONT",)
    assert drive.true_views == (FRONT_WIDE, FRONT_TELE)


def test_frames_without_a_future_end_the_motion(open_shards, make_records):
    drive = open_shards(make_records("a", 12, future=np.zeros(0)), split="test").drive("a")
    assert drive.split == "test"
    assert drive.ego_span_us == (-3_750_000, 1_100_000)


def test_rated_frames_are_the_moments_to_learn_from(open_shards, make_records):
    drive = open_shards(make_records("a", 6, rated=(4,)), split="val").drive("a")
    assert drive.split == "val"
    assert drive.event_t0s_us == (400_000,)


def test_missing_frames_are_said_and_bridged(open_shards, make_records, make_drive):
    dataset = open_shards(make_records("a", 5) + make_records("a", 5, first=25))
    drive = dataset.drive("a")
    assert drive.front_us.tolist() == [100_000 * k for k in (0, 1, 2, 3, 4, 25, 26, 27, 28, 29)]
    assert any("20 frames" in note for note in drive.notes)
    reference = dataset.open("a", WHOLE, FRONT_ONLY).reference
    positions, _ = true_poses(make_drive(), reference.timestamps_us)
    assert np.allclose(reference.positions[:, :2], positions, atol=0.02)


def test_too_large_a_gap_is_refused(open_shards, make_records):
    dataset = open_shards(make_records("a", 2) + make_records("a", 2, first=90))
    with pytest.raises(InputError, match=r"drive a: frames at 0\.1 s and 9\.0 s have no paths that meet"):
        dataset.drive("a")


def test_frames_of_two_drives_under_one_name_are_refused(open_shards, make_records, make_drive):
    dataset = open_shards(make_records("a", 2) + make_records("a", 2, make_drive(standing=True), first=2))
    with pytest.raises(InputError, match="they are not of one drive"):
        dataset.drive("a")


def test_a_frame_that_is_there_twice_is_refused(open_shards, make_records):
    dataset = open_shards(make_records("a", 4) + make_records("a", 1))
    with pytest.raises(InputError, match=r"frame 0 is there more than once \(.*tfrecord"):
        dataset.drive("a")


def test_only_changed_shards_are_indexed_again(open_shards, make_records, tmp_path, monkeypatch):
    open_shards(make_records("a", 6))
    indexed = []
    index_shard = index.index_shard
    monkeypatch.setattr(index, "index_shard", lambda task: (indexed.append(task.name), index_shard(task)))
    open_dataset(tmp_path / "shards", tmp_path / "cache")
    assert indexed == []
    dataset = open_shards(make_records("b", 2), split="val", shards=1)
    assert indexed == ["val_202504031202.tfrecord-00000-of-00001"]
    assert dataset.keys() == ["a", "b"]


def test_the_index_reads_no_image_and_opening_checks_it(open_shards, make_records, tmp_path):
    dataset = open_shards(make_records("a", 3), shards=1)
    (shard,) = (tmp_path / "shards").iterdir()
    content = bytearray(shard.read_bytes())
    content[content.index(b"JFIF")] ^= 1
    shard.write_bytes(content)
    again = open_dataset(tmp_path / "shards", tmp_path / "other_cache")
    assert again.drive("a").front_us.tolist() == dataset.drive("a").front_us.tolist()
    with pytest.raises(InputError, match="its checksum differs"):
        again.open("a", WHOLE, FRONT_ONLY)


@pytest.mark.slow
def test_an_index_built_by_workers_is_the_same(open_shards, make_records, tmp_path, monkeypatch):
    dataset = open_shards(make_records("a", 6))
    monkeypatch.setattr(index, "_WORTH_WORKERS", 0)
    again = open_dataset(tmp_path / "shards", tmp_path / "other_cache")
    first, second = (sorted((tmp_path / name).rglob("*.parquet")) for name in ("cache", "other_cache"))
    assert [path.name for path in first] == [path.name for path in second]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    assert again.keys() == dataset.keys()


@pytest.mark.parametrize(
    ("name", "positions", "complaint"),
    [
        ("noindex", np.zeros((16, 2)), "is not SEQUENCE-INDEX"),
        ("a-000", np.zeros((17, 2)), "up to 16 of each"),
        ("a-000", np.zeros((1, 2)), "fewer than 2"),
        ("a-000", np.full((16, 2), 9.0), "do not end at the origin"),
        ("a-000", np.full((16, 2), np.nan), "not finite"),
    ],
)
def test_a_wrong_record_is_named(open_shards, make_frame, name, positions, complaint):
    with pytest.raises(InputError, match=rf"tfrecord-00000-of-00001: record at byte 12: .*{complaint}"):
        open_shards([make_frame(name, positions, np.zeros((0, 2)))], shards=1)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (struct.pack("<d", 40.0), struct.pack("<d", np.nan), "intrinsic of FRONT"),
        (struct.pack("<d", -0.01), struct.pack("<d", 1e300), "intrinsic of FRONT"),
        (struct.pack("<d", 2.0), struct.pack("<d", np.inf), "extrinsic of FRONT is no rigid motion"),
        (struct.pack("<d", 1.0), struct.pack("<d", -1.0), "extrinsic of FRONT is no rigid motion"),
        (b"\x20\x30\x28\x40", b"\x20\x30\x28\x00", "FRONT is 48 x 0 pixels"),
        (b"\x20\x30\x28\x40", b"\x20\x31\x28\x40", "FRONT: is 48 x 64 pixels; its camera has 49 x 64"),
    ],
)
def test_a_damaged_calibration_is_named(open_shards, make_records, old, new, complaint):
    (record,) = make_records("a", 1, cameras=(1,))
    assert old in record
    dataset = open_shards([record.replace(old, new)])
    with pytest.raises(InputError, match=rf"record at byte 12: .*{complaint}"):
        dataset.open("a", WHOLE, FRONT_ONLY)


def test_unknown_drives_windows_and_folders_are_refused(open_shards, make_records, tmp_path):
    dataset = open_shards(make_records("a", 2))
    with pytest.raises(InputError, match="no Waymo E2E drive 'z'"):
        dataset.drive("z")
    with pytest.raises(InputError, match="no front image lies between"):
        dataset.open("a", (5_000_000, 6_000_000), FRONT_ONLY)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no file"):
        open_dataset(tmp_path / "empty", tmp_path / "cache", "waymo_e2e")


def test_a_look_at_a_drive(open_shards, make_records, check_peek):
    check_peek(open_shards(make_records("a", 4)), "a")
