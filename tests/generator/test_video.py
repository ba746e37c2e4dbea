"""Reading and writing video files."""

from fractions import Fraction

import av
import numpy as np
import pytest

from olt_generator.errors import InputError
from olt_generator.video import read_video, write_video

from .decoding.mp4_boxes import copy_video


def moving_picture(count, height=48, width=64):
    rows, columns = np.mgrid[0:height, 0:width]
    frames = [128 + 80 * np.sin((columns + 2 * k) / 7.0) * np.cos(rows / 9.0) for k in range(count)]
    return np.repeat(np.stack(frames)[..., None], 3, axis=-1).astype(np.uint8)


def read_packets(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        packets = [packet for packet in container.demux(stream) if packet.pts is not None]
        return stream.time_base, [p.pts for p in packets], [p.pts for p in packets if p.is_keyframe]


@pytest.mark.parametrize("rate", [Fraction(30), 25, 29.97, Fraction(30000, 1001), 10, 9.66])
def test_written_times_are_regular_and_key_frames_frequent(tmp_path, rate):
    path = tmp_path / "clip.mp4"
    write_video(path, moving_picture(65), rate)
    time_base, times, keys = read_packets(path)
    period = times[1] - times[0]
    assert times == [period * k for k in range(65)]
    assert float(period * time_base) == pytest.approx(1.0 / float(rate), rel=1e-9)
    assert keys == [0, 30 * period, 60 * period]


def test_round_trip_keeps_pictures_and_times(tmp_path):
    frames = moving_picture(12)
    write_video(tmp_path / "clip.mp4", frames, 30)
    video = read_video(tmp_path / "clip.mp4")
    assert video.frames.shape == frames.shape
    assert np.abs(video.frames.astype(int) - frames).mean() < 4.0
    assert video.timestamps_us.tolist() == [round(k * 1e6 / 30) for k in range(12)]
    assert video.frame_rate == pytest.approx(30.0, rel=1e-4)


def test_same_frames_give_same_bytes(tmp_path):
    frames = moving_picture(35)
    write_video(tmp_path / "a.mp4", frames, 30)
    write_video(tmp_path / "b.mp4", frames, 30.0)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


@pytest.mark.parametrize("grid", [1, 3])
def test_same_frames_give_same_bytes_whatever_lay_in_memory_before(tmp_path, grid):
    frames = moving_picture(40, 64, 112)
    seen = set()
    for size in (10_000, 100_000, 121_000, 1_000_000):
        used = [b"\xff" * size for _ in range(6_000_000 // size)]
        used = used[::2]  # the encoder is given memory in which motion vectors of -1 seem to lie
        write_video(tmp_path / "clip.mp4", frames, 10.0, grid)
        seen.add((tmp_path / "clip.mp4").read_bytes())
    assert len(seen) == 1


def test_frames_shrink_to_the_working_width_and_never_grow(tmp_path):
    write_video(tmp_path / "clip.mp4", moving_picture(3), 30)
    assert read_video(tmp_path / "clip.mp4", width=32).frames.shape == (3, 24, 32, 3)
    assert read_video(tmp_path / "clip.mp4", width=500).frames.shape == (3, 48, 64, 3)


def test_reading_stops_at_the_wanted_duration(tmp_path):
    write_video(tmp_path / "clip.mp4", moving_picture(40), 10)
    video = read_video(tmp_path / "clip.mp4", duration=1.5)
    assert video.timestamps_us[-1] == 1_400_000


def test_rotation_metadata_is_honoured(tmp_path):
    frames = moving_picture(3)
    frames[:, :10, :10] = 255
    write_video(tmp_path / "flat.mp4", frames, 30)
    copy_video(tmp_path / "flat.mp4", tmp_path / "turned.mp4", rotation=90)
    turned = read_video(tmp_path / "turned.mp4").frames
    flat = read_video(tmp_path / "flat.mp4").frames
    assert np.array_equal(turned, np.rot90(flat, 1, axes=(1, 2)))


def test_single_frame_reads(tmp_path):
    write_video(tmp_path / "one.mp4", moving_picture(1), 30)
    video = read_video(tmp_path / "one.mp4")
    assert len(video.frames) == 1
    assert video.timestamps_us.tolist() == [0]


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "no such video file"), (b"", "empty"), (b"not a video\n" * 50, "not a readable video")],
)
def test_what_is_no_video_is_refused_in_one_line(tmp_path, content, message):
    path = tmp_path / "clip.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_video(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_truncated_file_is_refused(tmp_path):
    write_video(tmp_path / "clip.mp4", moving_picture(60), 30)
    content = (tmp_path / "clip.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="not a readable video"):
        read_video(tmp_path / "cut.mp4")


def test_file_cut_off_behind_its_index_is_refused(tmp_path):
    write_video(tmp_path / "clip.mp4", moving_picture(60), 30)
    copy_video(tmp_path / "clip.mp4", tmp_path / "index_first.mp4", movflags="faststart")
    content = (tmp_path / "index_first.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(content[: content.find(b"mdat") + len(content) // 3])
    with pytest.raises(InputError, match="cut off"):
        read_video(tmp_path / "cut.mp4")


def test_sound_alone_is_refused(tmp_path):
    path = tmp_path / "sound.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=48000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), dtype=np.float32), format="fltp", layout="mono")
        frame.sample_rate = 48000
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with pytest.raises(InputError, match="no video stream"):
        read_video(path)


@pytest.mark.parametrize(
    ("shape", "rate", "message"),
    [((2, 31, 32, 3), 30, "even width"), ((0, 32, 32, 3), 30, "no frames"), ((2, 32, 32, 3), 0, "above 0")],
)
def test_what_cannot_be_written_is_refused_and_leaves_nothing(tmp_path, shape, rate, message):
    with pytest.raises(InputError, match=message):
        write_video(tmp_path / "clip.mp4", np.zeros(shape, dtype=np.uint8), rate)
    assert list(tmp_path.iterdir()) == []
