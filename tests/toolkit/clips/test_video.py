"""Frames by number out of videos of many kinds: the same as decoding everything from the start."""

from fractions import Fraction

import av
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.errors import InputError
from olt_generator.video import write_video
from olt_toolkit.clips.chunk_archive import ByteRange
from olt_toolkit.clips.mp4_index import read_mp4_index
from olt_toolkit.clips.video import check_video, decode_frames, decode_images

COUNT, HEIGHT, WIDTH = 50, 96, 160
PLAIN = {"crf": "20", "preset": "ultrafast", "threads": "1", "bf": "0"}


def moving_picture():
    """Smooth texture that moves, so that frames depend on each other."""
    random = np.random.default_rng(3)
    grid = random.normal(128, 50, (14, 40, 3)).astype(np.float32)
    texture = np.clip(cv2.resize(grid, (WIDTH + 2 * COUNT, HEIGHT), interpolation=cv2.INTER_CUBIC), 0, 255)
    return np.stack([texture[:, 2 * index : 2 * index + WIDTH] for index in range(COUNT)]).astype(np.uint8)


def encode(path, codec="libx264", options=PLAIN, gop=12, rate=Fraction(30), container="mp4"):
    with av.open(str(path), "w", format=container) as file:
        stream = file.add_stream(codec, rate=rate)
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = WIDTH, HEIGHT, "yuv420p", gop
        stream.time_base, stream.options = 1 / rate, options
        for index, image in enumerate(moving_picture()):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = index, 1 / rate
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    return path


def decode_all(path):
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


KINDS = {
    "plain": {},
    "pyramid of B-frames": {"options": PLAIN | {"bf": "3", "x264-params": "b-adapt=0:b-pyramid=normal"}},
    "open groups": {"options": PLAIN | {"bf": "2", "x264-params": "open-gop=1:b-adapt=0:scenecut=0"}},
    "one key frame": {"gop": 1000},
    "key frames only": {"gop": 1},
    "broken rate": {"rate": Fraction(30000, 1001)},
    "fragmented": {"container": "ismv"},
    "another codec": {"codec": "mpeg4", "options": {}},
}
INDEXED = set(KINDS) - {"fragmented", "another codec"}


@pytest.fixture(scope="module")
def videos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("videos")
    paths = {name: encode(folder / f"{number}.mp4", **kind) for number, (name, kind) in enumerate(KINDS.items())}
    paths["grid"] = folder / "grid.mp4"
    write_video(paths["grid"], moving_picture(), 30, grid=3)
    return {name: (ByteRange(path, 0, path.stat().st_size), decode_all(path)) for name, path in paths.items()}


def index_of(video):
    data = video.path.read_bytes()
    return read_mp4_index(lambda start, size: data[start : start + size], len(data))


@pytest.mark.parametrize("name", [*KINDS, "grid"])
@settings(max_examples=20)
@given(numbers=st.lists(st.integers(0, COUNT - 1), min_size=1, max_size=6))
def test_frames_are_those_of_decoding_everything(videos, name, numbers):
    video, every = videos[name]
    indices = np.array(numbers, np.int64)
    np.testing.assert_array_equal(decode_frames(video, indices, name), every[indices])
    np.testing.assert_array_equal(decode_images(video, indices, name, None), every[indices].transpose(0, 3, 1, 2))


@pytest.mark.parametrize("name", [*KINDS, "grid"])
def test_tables_are_used_where_they_suffice(videos, name):
    assert (index_of(videos[name][0]) is not None) == (name in INDEXED | {"grid"})


def test_only_a_part_of_the_file_is_read(videos, monkeypatch):
    video, every = videos["plain"]
    middle = ByteRange(video.path, 0, video.size)
    index = index_of(video)
    end = index.offsets[24] + index.sizes[24]
    data = bytearray(video.path.read_bytes())
    data[index.offsets[25] : index.offsets[36]] = bytes(int(index.offsets[36] - index.offsets[25]))
    assert end <= index.offsets[25]
    np.testing.assert_array_equal(decode_frames(bytes(data), np.array([24]), "video"), every[[24]])
    np.testing.assert_array_equal(decode_frames(middle, np.array([24]), "video"), every[[24]])


def test_a_video_within_a_larger_file(videos, tmp_path):
    video, every = videos["pyramid of B-frames"]
    path = tmp_path / "archive"
    path.write_bytes(b"before" + video.path.read_bytes() + b"after")
    inside = ByteRange(path, len(b"before"), video.size)
    np.testing.assert_array_equal(decode_frames(inside, np.array([7, 40]), "video"), every[[7, 40]])


@pytest.mark.parametrize("size", [(40, 64), (31, 57), (HEIGHT, WIDTH)])
def test_scaled_images_are_close_to_scaling_the_full_ones(videos, size):
    video, every = videos["grid"]
    images = decode_images(video, np.array([3, 20]), "video", size).transpose(0, 2, 3, 1)
    for image, full in zip(images, every[[3, 20]], strict=True):
        expected = cv2.resize(full, size[::-1], interpolation=cv2.INTER_AREA)
        difference = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) - cv2.cvtColor(expected, cv2.COLOR_RGB2GRAY).astype(float)
        assert np.sqrt(np.mean(difference**2)) < 2.0
        assert np.sqrt(np.mean((image - expected.astype(float)) ** 2)) < 6.0  # strong colours in blobs of four pixels


def test_pairs_around_the_key_frame_of_an_open_group(videos):
    video, every = videos["open groups"]
    for first in range(COUNT - 1):
        pair = np.array([first, first + 1])
        np.testing.assert_array_equal(decode_frames(video, pair, "video"), every[pair])


def test_frames_between_those_of_the_grid_are_not_needed(videos):
    video, every = videos["grid"]
    index = index_of(video)
    data = bytearray(video.path.read_bytes())
    between = np.flatnonzero(index.shown % 3 != 0)[:-1]  # the last frame of all has none after it to be between
    for sample in between.tolist():
        start = index.offsets[sample] + 5
        data[start : index.offsets[sample] + index.sizes[sample]] = bytes(int(index.sizes[sample]) - 5)
    wanted = np.array([6, 9, 12, 15])
    np.testing.assert_array_equal(decode_frames(bytes(data), wanted, "video"), every[wanted])


@pytest.mark.parametrize("name", ["plain", "another codec"])
def test_a_frame_that_is_not_there_is_named(videos, name):
    with pytest.raises(InputError, match=f"has no frame {COUNT}, which its timestamps promise"):
        decode_frames(videos[name][0], np.array([3, COUNT]), "video")


@pytest.mark.parametrize("name", [*KINDS, "grid"])
def test_videos_are_checked_against_their_timestamps(videos, name):
    check_video(videos[name][0], COUNT, "video")
    with pytest.raises(InputError, match="video: the video has"):
        check_video(videos[name][0], COUNT + 1, "video")


def test_a_video_of_changing_rate_is_refused(tmp_path):
    path = tmp_path / "changing.mp4"
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.options = WIDTH, HEIGHT, "yuv420p", PLAIN
        stream.time_base = Fraction(1, 300)
        for index, image in enumerate(moving_picture()):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = 10 * index + (0 if index < 20 else 7 * (index - 20)), Fraction(1, 300)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    with pytest.raises(InputError, match="video: the video has no frame"):
        check_video(path.read_bytes(), COUNT, "video")


@pytest.mark.parametrize("length", [0, 3, 200, 4000])
def test_a_file_cut_off_is_refused(videos, length):
    data = videos["plain"][0].path.read_bytes()[:length]
    with pytest.raises(InputError, match="video"):
        decode_frames(data, np.array([3]), "video")


@given(st.binary(max_size=300))
def test_nothing_but_an_index_comes_of_any_bytes(data):
    assert read_mp4_index(lambda start, size: data[start : start + size], len(data)) is None


@settings(max_examples=60)
@given(position=st.integers(0, 10_000), value=st.integers(0, 255))
def test_a_changed_table_is_refused_or_gives_frames(videos, position, value):
    video, _ = videos["plain"]
    data = bytearray(video.path.read_bytes())
    tables = data.index(b"moov")
    data[tables + position % (len(data) - tables)] = value
    try:
        frames = decode_frames(bytes(data), np.array([30]), "video")
    except InputError:
        return
    assert len(frames) == 1
