"""Which files of a folder are front videos."""

import os

import numpy as np
import pytest

from olt_datasets.sources.video_files import find_video_files, looks_elsewhere
from olt_generator.errors import InputError
from olt_generator.omissions import word_omission
from olt_generator.video import write_video
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.recordings.drives import find_drives, list_left_out, open_dataset


def write(path, frames=5):
    path.parent.mkdir(parents=True, exist_ok=True)
    levels = 15 * np.arange(frames, dtype=np.uint8)
    write_video(path, np.tile(levels[:, None, None, None], (1, 36, 64, 3)), 10)
    return path


ELSEWHERE = {
    "2023-05-01_12-30-10-back": "back",
    "2023-05-01_12-30-10-left_repeater": "back on the left",
    "2023-05-01_12-30-10-right_pillar": "to the right",
    "20230501_123010_NR": "back",
    "20230501_123010_EI": "into the cabin",
    "2023_0501_123010_0042R": "back",
    "2023_0501_123010_000042PI": "into the cabin",
    "20230501123010_000042R": "back",
    "230501_123010_001_RH": "back",
    "20230501_123010_0042_N_C": "back",
    "NO20230501-123010-000042B": "back",
    "REC_2023_05_01_12_30_10_R": "back",
    "rear": "back",
    "trip-1_rear": "back",
    "rear_camera_2": "back",
    "back": "back",
    "trip backcam": "back",
    "cabin": "into the cabin",
}
AHEAD = [
    "2023-05-01_12-30-10-front",
    "20230501_123010_NF",
    "2023_0501_123010_0042F",
    "2023_0501_123010_000042PT",
    "230501_123010_001_FH",
    "20230501_123010_0042_N_A",
    "NO20230501-123010-000042F",
    "REC_2023_05_01_12_30_10_F",
    "GRMN0042",
    "DSC0001",
    "the way back",
    "turn_right",
    "solidWhiteRight",
    "rearranged",
    "front",
    "IMG_0042_R",
]


@pytest.mark.parametrize(("name", "looks"), ELSEWHERE.items())
def test_names_of_dash_cameras_tell_that_a_camera_looks_elsewhere(tmp_path, name, looks):
    found = looks_elsewhere(tmp_path / f"{name}.mp4")
    assert found is not None
    assert found.looks == looks


@pytest.mark.parametrize("name", AHEAD)
def test_front_videos_and_other_names_say_nothing(tmp_path, name):
    assert looks_elsewhere(tmp_path / f"{name}.mp4") is None


def test_short_marks_count_beside_the_front_video_of_the_same_moment(tmp_path):
    names = ["IMG_0042_F.mp4", "IMG_0043_R.mp4", "IMG_0042_R.mp4", "trip_left.mp4", "trip_front.mp4"]
    beside = [tmp_path / name for name in names]
    found = [looks_elsewhere(path, beside) for path in beside]
    assert [each.looks if each else None for each in found] == [None, None, "back", "to the left", None]


def test_a_rear_video_alone_is_refused_with_the_rule(tmp_path):
    path = write(tmp_path / "20230501_123010_NR.mp4")
    with pytest.raises(InputError, match=r"the camera looks back, by its file name \(BlackVue\)"):
        open_recording(path)
    dataset = open_dataset(tmp_path)
    assert dataset.keys() == [path.name]
    for use in (dataset.drive, lambda key: dataset.open(key, (0, 10**6), OpenOptions())):
        with pytest.raises(InputError, match="looks back"):
            use(path.name)


def test_rear_videos_beside_front_ones_are_passed_over_and_counted(tmp_path):
    for number in (42, 44):
        write(tmp_path / "dash" / f"2023_0501_1230{number}_00{number}F.mp4")
        write(tmp_path / "dash" / f"2023_0501_1230{number}_00{number + 1}R.mp4")
    root = tmp_path / "dash"
    assert open_dataset(root).keys() == ["2023_0501_123042_0042F.mp4", "2023_0501_123044_0044F.mp4"]
    assert [place.path.name for place, _ in find_drives(root)] == open_dataset(root).keys()
    (omission,) = list_left_out(root)
    assert word_omission(omission) == ("2 of 4 files called videos: the camera looks back, by its file name (Viofo)")


def test_what_is_no_video_is_passed_over_and_counted(tmp_path):
    root = tmp_path / "dash"
    write(root / "DSC0001.MP4")
    (root / "._DSC0001.MP4").write_bytes(b"\x00\x05\x16\x07" + bytes(4000))
    (root / "copy.mp4").write_bytes(b"\x00\x05\x16\x07" + bytes(4000))
    (root / "empty.mp4").write_bytes(b"")
    (root / "notes.mov").write_text("shot on the way to work\n" * 40)
    (root / "thumbnail.mp4").write_bytes(b"\xff\xd8\xff\xe0" + bytes(100))
    write(root / "__MACOSX" / "DSC0001.MP4")
    write(root / ".Trash" / "old.mp4")
    dataset = open_dataset(root)
    assert dataset.keys() == ["DSC0001.MP4"]
    counts = {omission.why: omission.count for omission in dataset.left_out}
    assert counts == {
        "AppleDouble files (metadata of macOS)": 1,
        "empty files": 1,
        "files in folders of the system": 2,
        "hidden files": 1,
        "pictures": 1,
        "texts": 1,
    }
    assert {omission.total for omission in dataset.left_out} == {8}
    assert [place.path.name for place, _ in find_drives(root)] == ["DSC0001.MP4"]
    with pytest.raises(InputError, match="the file is empty"):
        open_recording(root / "empty.mp4")


def test_a_folder_of_hidden_files_is_no_data_set(tmp_path):
    (tmp_path / "._DSC0001.MP4").write_bytes(b"\x00\x05\x16\x07" + bytes(4000))
    with pytest.raises(InputError, match="no recording and no data set"):
        open_dataset(tmp_path)


def test_loops_pipes_and_devices_are_no_videos(tmp_path):
    (tmp_path / "day").mkdir()
    (tmp_path / "day" / "a.mp4").write_bytes(b"\0\1")
    (tmp_path / "day" / "again").symlink_to(tmp_path)
    (tmp_path / "self.mp4").symlink_to("self.mp4")
    (tmp_path / "zero.mp4").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe.mp4")
    assert find_video_files(tmp_path) == ([tmp_path / "day" / "a.mp4"], {})


def test_a_folder_that_cannot_be_listed_is_told(tmp_path, monkeypatch):
    (tmp_path / "closed").mkdir()
    scandir = os.scandir

    def refuse(path):
        if str(path).endswith("closed"):
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    with pytest.raises(InputError, match=r"closed: cannot be listed \(Permission denied\)"):
        find_video_files(tmp_path)
