"""Parts of a video by the times of their frames: with B-frames, at a variable rate, and against reading it whole."""

from fractions import Fraction

import av
import numpy as np
import pytest

from olt_generator.errors import InputError
from olt_generator.video import read_frame_times, read_video, read_video_window

RATE_TICKS = 90_000


def write(path, times, b_frames=2, key_every=8):
    """A video whose frame k, shown at times[k] (in 1/90000 s), is a grey that grows with k."""
    with av.open(str(path), "w", options={"movflags": "faststart"} if path.suffix == ".mp4" else {}) as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.time_base = Fraction(1, RATE_TICKS)
        stream.codec_context.time_base = Fraction(1, RATE_TICKS)
        stream.gop_size, stream.thread_count = key_every, 1
        stream.options = {"bf": str(b_frames), "crf": "10", "sc_threshold": "0"}
        for number, time in enumerate(times):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 + 5 * number, np.uint8), format="rgb24")
            frame.pts, frame.time_base = int(time), Fraction(1, RATE_TICKS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


REGULAR = 3000 * np.arange(40)
UNEVEN = np.cumsum(np.random.default_rng(3).integers(900, 9000, 40))


@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
@pytest.mark.parametrize("times", [REGULAR, UNEVEN], ids=["regular", "uneven"])
@pytest.mark.parametrize("b_frames", [0, 3])
def test_times_and_windows_are_those_of_the_whole_video(tmp_path, times, b_frames, suffix):
    path = write(tmp_path / f"video.{suffix}", times, b_frames)
    whole = read_video(path)
    known = read_frame_times(path)
    assert known.tolist() == whole.timestamps_us.tolist()
    assert known == pytest.approx((times - times[0]) * 1e6 / RATE_TICKS, abs=1000 if suffix == "mkv" else 1)
    for first, last in [(0, 0), (0, 7), (5, 12), (9, 9), (17, 39), (39, 39)]:
        window = read_video_window(path, int(known[first]), int(known[last]))
        assert window.timestamps_us.tolist() == known[first : last + 1].tolist()
        assert np.array_equal(window.frames, whole.frames[first : last + 1])


def test_a_window_takes_in_its_ends_and_nothing_beyond(tmp_path):
    path = write(tmp_path / "video.mp4", REGULAR)
    window = read_video_window(path, 100_001, 199_999, width=32)
    assert window.timestamps_us.tolist() == [133_333, 166_667]
    assert window.frames.shape == (2, 24, 32, 3)
    assert window.frame_rate == pytest.approx(30.0, rel=1e-4)


def test_metadata_that_is_no_utf8_does_not_matter(tmp_path):
    """As many dashcams write it."""
    path = write(tmp_path / "video.mp4", REGULAR)
    content = path.read_bytes()
    assert b"VideoHandler" in content
    path.write_bytes(content.replace(b"VideoHandler", b"Vid\xe9oHandler"))
    assert len(read_frame_times(path)) == len(read_video(path).frames) == 40


def test_a_window_without_frames_is_refused(tmp_path):
    path = write(tmp_path / "video.mp4", REGULAR)
    with pytest.raises(InputError, match="no frame is shown between 5000000 and 6000000 us"):
        read_video_window(path, 5_000_000, 6_000_000)


@pytest.mark.parametrize("content", [b"", b"no video at all" * 100])
def test_what_is_no_video_is_refused(tmp_path, content):
    path = tmp_path / "video.mp4"
    path.write_bytes(content)
    for read in (read_frame_times, lambda path: read_video_window(path, 0, 1)):
        with pytest.raises(InputError, match=r"video\.mp4"):
            read(path)


def test_a_file_cut_off_or_overwritten_is_refused(tmp_path):
    whole = write(tmp_path / "whole.mp4", REGULAR).read_bytes()
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(whole[:-1000])
    with pytest.raises(InputError, match="cut off"):
        read_frame_times(cut)
    damaged = bytearray(whole)
    start = damaged.index(b"mdat")
    damaged[start + 4 :] = bytes(len(damaged) - start - 4)
    (tmp_path / "damaged.mp4").write_bytes(damaged)
    with pytest.raises(InputError, match=r"damaged\.mp4"):
        read_video_window(tmp_path / "damaged.mp4", 0, 400_000)
