"""Plain videos: one as a recording, a folder of them as a data set."""

import numpy as np
import pytest

from olt_datasets.sources import video
from olt_generator.cameras import FthetaCamera, PinholeCamera
from olt_generator.errors import InputError
from olt_generator.video import write_video
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.recordings.drives import find_drives, open_dataset


def write(path, frames=12, rate=10):
    path.parent.mkdir(parents=True, exist_ok=True)
    levels = 15 * np.arange(frames, dtype=np.uint8)
    write_video(path, np.tile(levels[:, None, None, None], (1, 36, 64, 3)), rate)
    return path


def write_video_file(path, count=5, size=(36, 64)):
    frames = np.random.default_rng(0).integers(0, 255, (count, *size, 3), dtype=np.uint8)
    write_video(path, frames, 30)
    return path


def test_video_opens_with_every_assumption_said(tmp_path):
    path = write_video_file(tmp_path / "dash.mp4")
    recording = open_recording(path, OpenOptions())
    assert recording.frames.shape == (5, 36, 64, 3)
    assert isinstance(recording.camera, PinholeCamera)
    assert recording.camera.rays(np.array([[-0.5, 17.5]]))[0, 0] == pytest.approx(-np.sin(np.radians(35.0)))
    assert recording.T_rig_camera[2, 3] == 1.5
    said = " ".join(recording.assumptions)
    for word in ("70 degrees", "the video does not tell: only 0 windows", "1.50 m", "rear axle", "vehicle"):
        assert word in said
    assert recording.reference is None
    assert np.array_equal(open_recording(path, OpenOptions(duration=float("inf"))).frames, recording.frames)


def test_wide_video_gets_a_fisheye_and_options_are_taken(tmp_path):
    path = write_video_file(tmp_path / "dash.mp4")
    recording = open_recording(path, OpenOptions(width=32, horizontal_fov=np.radians(120.0), camera_height=2.2))
    assert isinstance(recording.camera, FthetaCamera)
    assert recording.camera.width == 32
    edge = recording.camera.rays(np.array([[31.5, 8.5]]))[0]
    assert np.degrees(np.arccos(edge[2])) == pytest.approx(60.0, abs=0.01)
    assert recording.T_rig_camera[2, 3] == 2.2
    assert any("as given" in sentence for sentence in recording.assumptions)


def test_video_of_one_frame_and_silly_field_of_view_are_refused(tmp_path):
    with pytest.raises(InputError, match="at least 2 frames"):
        open_recording(write_video_file(tmp_path / "one.mp4", count=1), OpenOptions())
    with pytest.raises(InputError, match=r"field of view 1\.0 degrees"):
        open_recording(write_video_file(tmp_path / "dash.mp4"), OpenOptions(horizontal_fov=np.radians(1.0)))


def test_a_single_video_is_the_drive_that_it_is_in_its_folder(tmp_path):
    path = write_video_file(tmp_path / "dash.mp4")
    alone, beside = open_dataset(path), open_dataset(tmp_path)
    assert (alone.keys(), beside.keys()) == (["."], ["dash.mp4"])
    assert alone.drive(".").scene_id == beside.drive("dash.mp4").scene_id
    frames = [
        dataset.open(key, (0, 100_000), OpenOptions()).frames for dataset, key in ((alone, "."), (beside, "dash.mp4"))
    ]
    assert np.array_equal(*frames)


def test_every_video_is_a_drive(tmp_path):
    root = tmp_path / "dash"
    write(root / "a.mp4")
    write(root / "trip" / "b.MP4", frames=5, rate=25)
    (root / "notes.txt").write_text("no video")
    dataset = open_dataset(root, tmp_path / "cache")
    assert dataset.source == "video"
    assert dataset.keys() == ["a.mp4", "trip/b.MP4"]
    drive = dataset.drive("trip/b.MP4")
    assert drive.front_us.tolist() == [0, 40_000, 80_000, 120_000, 160_000]
    assert drive.scene_id.startswith("video/")
    assert drive.ego_span_us is None
    assert drive.true_views == ("camera_front_wide_120fov",)
    assert drive.category == "unlabelled"


def test_a_window_of_a_video(tmp_path):
    root = tmp_path / "dash"
    write(root / "a.mp4")
    recording = open_dataset(root, tmp_path / "cache").open("a.mp4", (250_000, 500_000), OpenOptions(width=32))
    assert recording.timestamps_us.tolist() == [0, 100_000, 200_000]
    assert recording.frames.shape == (3, 18, 32, 3)
    assert recording.frames[:, 9, 16, 0] == pytest.approx([45, 60, 75], abs=3)
    assert any("70 degrees" in sentence for sentence in recording.assumptions)
    assert recording.reference is None


def test_all_windows_of_a_video_have_one_lens_which_is_looked_for_once(tmp_path, monkeypatch):
    root = tmp_path / "dash"
    write(root / "a.mp4")
    found = []
    find = video.find_field_of_view
    monkeypatch.setattr(video, "find_field_of_view", lambda *args: found.append(1) or find(*args))
    first = open_dataset(root, tmp_path / "cache").open("a.mp4", (0, 300_000), OpenOptions())
    second = open_dataset(root, tmp_path / "cache").open("a.mp4", (700_000, 900_000), OpenOptions())
    assert found == [1]
    assert first.camera == second.camera
    assert first.assumptions == second.assumptions
    given = OpenOptions(horizontal_fov=np.radians(120.0))
    wide = open_dataset(root, tmp_path / "cache").open("a.mp4", (0, 300_000), given)
    assert wide.camera != first.camera
    assert found == [1]


def test_videos_in_folders_below_are_drives_of_their_own(tmp_path):
    for number, day in enumerate(("day1", "day2")):
        write(tmp_path / "trip" / day / "front" / "0001.mp4", frames=12 + number)
    (tmp_path / "trip" / "day2" / "again").symlink_to(tmp_path / "trip")
    dataset = open_dataset(tmp_path / "trip", tmp_path / "cache")
    assert dataset.keys() == ["day1/front/0001.mp4", "day2/front/0001.mp4"]
    assert dataset.drive("day1/front/0001.mp4").scene_id != dataset.drive("day2/front/0001.mp4").scene_id
    assert [key for _, key in find_drives(tmp_path / "trip")] == dataset.keys()
    (links,) = dataset.left_out
    assert (links.what, links.count, links.total) == ("folders", 1, 5)
    write(tmp_path / "trip" / "a.mp4")
    assert [key for _, key in find_drives(tmp_path / "trip")] == ["a.mp4", *dataset.keys()]


def test_a_video_far_below_does_not_make_a_folder_one_of_videos(tmp_path):
    write(tmp_path / "1" / "2" / "3" / "4" / "5" / "a.mp4")
    with pytest.raises(InputError, match="no recording and no data set"):
        open_dataset(tmp_path)
    assert open_dataset(tmp_path / "1").keys() == ["2/3/4/5/a.mp4"]


@pytest.mark.parametrize("name", ["a\n.mp4", "a\x1f.mp4", "a\x7f.mp4"])
def test_a_name_with_control_characters_is_refused(tmp_path, name):
    write(tmp_path / "drives" / name)
    dataset = open_dataset(tmp_path / "drives", tmp_path / "cache")
    with pytest.raises(InputError, match=r"video: key .* holds control characters; rename the file"):
        dataset.drive(name)


def test_a_damaged_video_fails_alone(tmp_path):
    root = tmp_path / "dash"
    write(root / "a.mp4")
    (root / "b.mp4").write_bytes(b"\x00\x00\x00\x20ftypisom" + bytes(500))
    dataset = open_dataset(root, tmp_path / "cache")
    assert dataset.keys() == ["a.mp4", "b.mp4"]
    assert len(dataset.drive("a.mp4").front_us) == 12
    with pytest.raises(InputError, match=r"b\.mp4: "):
        dataset.drive("b.mp4")
    with pytest.raises(InputError, match=r"no video 'c\.mp4'"):
        dataset.drive("c.mp4")


def test_a_look_at_a_video(tmp_path, check_peek):
    write(tmp_path / "drives" / "a.mp4", frames=16)
    check_peek(open_dataset(tmp_path / "drives", tmp_path / "cache"), "a.mp4")


def test_key_frames_that_are_near_enough_are_taken(tmp_path):
    path = tmp_path / "long.mp4"
    levels = 20 + np.arange(100, dtype=np.uint8)
    write_video(path, np.tile(levels[:, None, None, None], (1, 36, 64, 3)), 10, grid=3)
    dataset = open_dataset(path, tmp_path / "cache")
    wanted = 100_000 * np.array([33, 33, 80, 44])
    images, times_us = dataset.peek(".", wanted, 64, np.array([300_000, 200_000, 10_000_000, 0]))
    # Every 30th frame is a key frame.
    assert times_us.tolist() == [3_000_000, 3_300_000, 9_000_000, 4_400_000]
    assert images[:, 18, 32, 0] == pytest.approx([50, 53, 110, 64], abs=1)
