"""What an edit list shows, and when; and files that are whole although they look cut off."""

import struct

import numpy as np
import pytest

from olt_generator.errors import InputError
from olt_generator.video import read_frame_times, read_video, read_video_window

from .mp4_boxes import RATE, copy_video, grey_numbers, set_edits, write_greys

COUNT = 75
LISTS = {
    "all": [(3.0, 0.0)],
    "from a key frame": [(1.0, 0.4)],
    "from between key frames": [(1.0, 0.56)],
    "to the end": [(1.4, 1.6)],
    "the beginning": [(1.0, 0.0)],
    "after a wait": [(1.0, None), (2.0, 0.2)],
    "two parts": [(1.0, 0.0), (1.0, 2.0)],
    "parts that change places": [(1.0, 2.0), (1.0, 0.0)],
    "a wait between parts": [(1.0, 0.0), (0.48, None), (1.0, 1.0)],
    "three parts": [(0.4, 0.2), (0.4, 1.04), (0.4, 2.2)],
    "a part twice": [(0.6, 0.4), (0.6, 0.4)],
}


@pytest.mark.parametrize("b_frames", [0, 2])
@pytest.mark.parametrize("edits", LISTS.values(), ids=LISTS.keys())
def test_frames_are_shown_as_the_edit_list_says(tmp_path, edits, b_frames):
    path = write_greys(tmp_path / "video.mp4", COUNT, b_frames)
    # Where frames are reordered, the first is shown two frames after the media begin.
    delay = 2 / RATE if b_frames else 0.0
    set_edits(path, [(shown, None if first is None else first + delay) for shown, first in edits])
    numbers, times, start = [], [], 0.0
    for shown, first in edits:
        if first is not None:
            inside = [k for k in range(COUNT) if first - 1e-6 <= k / RATE < first + shown - 1e-6]
            numbers += inside
            times += [start + k / RATE - first for k in inside]
        start += shown
    video = read_video(path)
    assert grey_numbers(video.frames) == numbers
    assert video.timestamps_us == pytest.approx(1e6 * (np.array(times) - times[0]), abs=1)
    assert read_frame_times(path).tolist() == video.timestamps_us.tolist()
    window = read_video_window(path, int(video.timestamps_us[5]), int(video.timestamps_us[-2]))
    assert np.array_equal(window.frames, video.frames[5:-1])


def test_parts_at_another_speed_are_refused(tmp_path):
    path = set_edits(write_greys(tmp_path / "video.mp4", COUNT), [(1.0, 0.0), (1.0, 2.0)])
    content = bytearray(path.read_bytes())
    entry = content.index(b"elst") + 12
    content[entry + 8 : entry + 12] = struct.pack(">hH", 0, 32768)
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"0\.5 times its speed"):
        read_frame_times(path)


@pytest.mark.parametrize("edits", [[(1.0, 0.4)], [(1.0, 0.0), (1.0, 1.6)]], ids=["one part", "two parts"])
def test_an_edited_file_that_was_cut_off_is_still_refused(tmp_path, edits):
    path = set_edits(write_greys(tmp_path / "video.mp4", COUNT, b_frames=0, size=(480, 640)), edits)
    content = bytearray(path.read_bytes())
    # The media before the index, so that the index is whole: what is lost is the end of the media.
    start = content.index(b"mdat") - 4
    size = struct.unpack(">I", content[start : start + 4])[0]
    moov = content[content.index(b"moov") - 4 :]
    shift = len(moov)
    table = moov.index(b"stco") + 8
    for number in range(struct.unpack(">I", moov[table : table + 4])[0]):
        place = table + 4 + 4 * number
        moov[place : place + 4] = struct.pack(">I", struct.unpack(">I", moov[place : place + 4])[0] + shift)
    front = content[:start] + moov + content[start : start + size]
    path.write_bytes(front)
    assert len(read_video(path).frames) in (25, 50)
    path.write_bytes(front[: -size // 2])
    for read in (read_frame_times, read_video):
        with pytest.raises(InputError, match=r"cut off|damaged"):
            read(path)


@pytest.mark.parametrize("rate", [1, 2])
@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
def test_a_last_frame_that_lasts_long_is_no_end_that_is_missing(tmp_path, rate, suffix):
    path = write_greys(tmp_path / f"video.{suffix}", 9, rate=rate)
    assert np.diff(read_frame_times(path)) == pytest.approx(1e6 / rate, abs=1000)
    assert len(read_video(path).frames) == 9


def test_the_times_of_a_beginning_are_those_of_the_whole(tmp_path):
    path = write_greys(tmp_path / "video.mp4", COUNT)
    whole = read_frame_times(path)
    assert read_frame_times(path, 1.0).tolist() == whole[whole < 1_000_000].tolist()


@pytest.mark.parametrize(("captured", "accepted"), [("240", False), ("1", False), ("25", True), ("29.9", True)])
def test_slow_motion_and_time_lapse_that_the_recorder_notes_are_refused(tmp_path, captured, accepted):
    path = tmp_path / "video.mp4"
    write_greys(tmp_path / "plain.mp4", 10)
    tags = {"com.android.capture.fps": captured}
    copy_video(tmp_path / "plain.mp4", path, metadata=tags, movflags="use_metadata_tags")
    if accepted:
        assert len(read_video(path).frames) == 10
        return
    for read in (read_video, read_frame_times):
        with pytest.raises(InputError, match=rf"captured at {captured} frames a second and plays at 25"):
            read(path)
