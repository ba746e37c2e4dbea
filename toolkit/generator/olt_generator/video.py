"""Reading and writing video files."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
import cv2
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.video.stream import VideoStream
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.files import write_whole

KEY_FRAME_EVERY = 30
QUALITY = "18"
MAX_RATE_DENOMINATOR = 1001
# How many frames a container may announce and not hold: some writers count one that is never shown.
MISSING_FRAMES_ALLOWED = 1
MISSING_SECONDS_ALLOWED = 0.5


@dataclass(frozen=True)
class Video:
    """A decoded video.

    Attributes:
        frames: (n, H, W, 3) uint8 RGB.
        timestamps_us: (n,) int64 presentation times in microseconds, strictly increasing, the first is 0.
        frame_rate: mean frames per second over what was decoded; as declared for a single frame, 0 if unknown.
    """

    frames: NDArray[np.uint8]
    timestamps_us: NDArray[np.int64]
    frame_rate: float


def read_video(path: Path, width: int = 832, duration: float = 20.0) -> Video:
    """Decode the beginning of a video at working resolution.

    Args:
        path: a file that FFmpeg can decode.
        width: width of the frames in pixels; smaller videos keep theirs. The height follows the aspect ratio.
        duration: at most this many seconds from the first frame.

    Raises:
        InputError: the file is missing, empty, no video, damaged or cut off, or its times run backwards.
    """
    with _opened(path) as (container, stream):
        return _as_video(stream, *_decode(path, container, stream, width, duration))


def read_frame_times(path: Path) -> NDArray[np.int64]:
    """Times (n,) of all frames in microseconds since the first, as `read_video` gives them, without decoding any.

    Raises:
        InputError: the file is missing, empty, no video or cut off, or two frames are shown at the same time.
    """
    with _opened(path) as (container, stream):
        return _microseconds([packet.pts * packet.time_base for packet in _coded_frames(path, container, stream)])


def read_video_window(path: Path, first_us: int, last_us: int, width: int = 832) -> Video:
    """Decode the frames that are shown between two times, from the last key frame before them on.

    Args:
        path: a file that FFmpeg can decode.
        first_us, last_us: times in microseconds since the first frame of the video, both included.
        width: see `read_video`.

    Returns:
        The frames; their times are still those since the first frame of the video.

    Raises:
        InputError: as `read_frame_times`; no frame is shown at these times, or one of them is damaged.
    """
    with _opened(path) as (container, stream):
        coded = _coded_frames(path, container, stream)
        timestamps_us = _microseconds([packet.pts * packet.time_base for packet in coded])
        inside = np.flatnonzero((timestamps_us >= first_us) & (timestamps_us <= last_us))
        if len(inside) == 0:
            raise InputError(f"{path}: no frame is shown between {first_us} and {last_us} us; give times of the video")
        frames = _decode_some(path, container, stream, coded[: inside[-1] + 1], len(inside), width)
        return _as_video(stream, frames, timestamps_us[inside])


def write_video(path: Path, frames: NDArray[np.uint8], frame_rate: float | Fraction, grid: int = 1) -> None:
    """Write an H.264 mp4 that frame-accurate readers decode exactly.

    The rate is constant, times start at 0, one frame period is a whole number of ticks, and every 30th frame is a
    key frame (docs/formats/physicalai_av.md). The same frames give the same bytes.

    Args:
        path: where the file appears once it is whole.
        frames: (n, H, W, 3) uint8 RGB; height and width are even.
        frame_rate: frames per second.
        grid: every frame whose number is a multiple of this can be decoded without the frames between, and decoding
            is quick at the price of a larger file; 1 where all frames are wanted alike.

    Raises:
        InputError: no frames, odd sizes, or a rate that is not positive.
    """
    if len(frames) == 0:
        raise InputError(f"{path}: there are no frames to write")
    height, width = frames.shape[1:3]
    if height % 2 or width % 2:
        raise InputError(f"{path}: frames are {width} x {height}; H.264 needs an even width and height, crop one pixel")
    if not frame_rate > 0:
        raise InputError(f"{path}: frame rate {frame_rate}; it must be above 0")
    rate = Fraction(frame_rate).limit_denominator(MAX_RATE_DENOMINATOR)
    with write_whole(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = 1 / rate
        stream.thread_count = 1
        stream.gop_size = KEY_FRAME_EVERY
        # No macroblock tree: where a frame's width in blocks of 16 is no multiple of 8, x264 with AVX-512 weighs the
        # last blocks by memory behind its tables, and equal frames give unequal bytes.
        coding = ["mbtree=0"]
        if grid > 1:
            # Always as many B-frames, which no other frame refers to, between two frames of the grid; and variable
            # length codes, which take a fifth more room than arithmetic ones and are decoded 1.7 times as fast.
            coding += ["b-adapt=0", "b-pyramid=none", "scenecut=0", "cabac=0"]
        stream.options = {"crf": QUALITY, "preset": "fast", "threads": "1", "bf": str(grid - 1)}
        stream.options |= {"x264-params": ":".join(coding)}
        for index, image in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts, frame.time_base = index, 1 / rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def shrink(image: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """The image (H, W, 3) scaled down to `width` by area averaging; smaller images are returned as they are."""
    if image.shape[1] <= width:
        return image
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


@dataclass(frozen=True)
class _CodedFrame:
    """When a frame is shown and decoded, in units of `time_base` seconds, and whether it is a key frame."""

    pts: int
    dts: int
    time_base: Fraction
    is_key: bool


@contextmanager
def _opened(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    """The container and first video stream of a file; FFmpeg's errors inside become `InputError`."""
    if not path.is_file():
        raise InputError(f"{path}: no such video file")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; copy or download it again")
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            if not container.streams.video:
                raise InputError(f"{path}: the file has no video stream; give a video file")
            yield container, container.streams.video[0]
    except FFmpegError as error:
        raise InputError(f"{path}: not a readable video ({error.strerror}); copy or convert it again") from error


def _as_video(stream: VideoStream, frames: NDArray[np.uint8], timestamps_us: NDArray[np.int64]) -> Video:
    if len(frames) == 1:
        return Video(frames, timestamps_us, float(stream.average_rate or 0.0))
    return Video(frames, timestamps_us, 1e6 * (len(frames) - 1) / float(timestamps_us[-1] - timestamps_us[0]))


def _coded_frames(path: Path, container: InputContainer, stream: VideoStream) -> list[_CodedFrame]:
    """All frames that are shown, in the order in which they are; B-frames lie in another order in the file."""
    coded = []
    for packet in container.demux(stream):
        if packet.size == 0 or packet.is_discard:
            continue  # the end of the stream, or what an edit list hides
        if packet.pts is None:
            raise InputError(f"{path}: frame {len(coded)} has no presentation time; convert the video to mp4")
        dts = packet.pts if packet.dts is None else packet.dts
        coded.append(_CodedFrame(packet.pts, dts, Fraction(packet.time_base), packet.is_keyframe))
    if not coded:
        raise InputError(f"{path}: holds no frame; copy or convert the video again")
    coded.sort(key=lambda frame: frame.pts)
    twice = [number for number, (before, after) in enumerate(pairwise(coded), 1) if before.pts == after.pts]
    if twice:
        raise InputError(f"{path}: frame {twice[0]} is not later than the one before it; convert it to mp4")
    _check_complete(path, stream, [frame.pts * frame.time_base for frame in coded])
    return coded


def _decode_some(
    path: Path, container: InputContainer, stream: VideoStream, coded: list[_CodedFrame], count: int, width: int
) -> NDArray[np.uint8]:
    """Decode the last `count` of some frames, which are known by their times and not by where a seek lands."""
    stream.thread_type = "AUTO"
    wanted = [frame.pts for frame in coded[-count:]]
    key_frames = [frame for frame in coded if frame.is_key and frame.pts <= wanted[0]]
    container.seek(key_frames[-1].dts if key_frames else coded[0].dts, stream=stream)
    found: dict[int, NDArray[np.uint8]] = {}
    for frame in container.decode(stream):
        if frame.pts in wanted:
            if frame.is_corrupt:
                raise InputError(f"{path}: frame {len(coded) - count + len(found)} is damaged; copy the video again")
            found[frame.pts] = shrink(_upright(frame), width)
        if frame.pts is not None and frame.pts >= wanted[-1]:
            break
    if len(found) < count:
        number = len(coded) - count + next(index for index, pts in enumerate(wanted) if pts not in found)
        raise InputError(f"{path}: frame {number} cannot be decoded; copy or convert the video again")
    return np.stack([found[pts] for pts in wanted])


def _decode(
    path: Path, container: InputContainer, stream: VideoStream, width: int, duration: float
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    stream.thread_type = "AUTO"
    frames: list[NDArray[np.uint8]] = []
    times: list[Fraction] = []
    try:
        for frame in container.decode(stream):
            where = f"{path}: frame {len(frames)}"
            if frame.is_corrupt:
                raise InputError(f"{where} is damaged; copy the video again or cut it before this frame")
            if frame.pts is None or frame.time_base is None:
                raise InputError(f"{where} has no presentation time; convert the video to mp4")
            time = frame.pts * frame.time_base
            if times and time <= times[-1]:
                raise InputError(f"{where} is not later than the one before it; convert it to mp4")
            if times and time - times[0] >= duration:
                return np.stack(frames), _microseconds(times)
            times.append(time)
            frames.append(shrink(_upright(frame), width))
    except FFmpegError as error:
        raise InputError(
            f"{path}: decoding fails after frame {len(frames) - 1} ({error.strerror}); copy the video again"
        ) from error
    if not frames:
        raise InputError(f"{path}: no frame could be decoded; copy or convert the video again")
    _check_complete(path, stream, times)
    return np.stack(frames), _microseconds(times)


def _check_complete(path: Path, stream: VideoStream, times: list[Fraction]) -> None:
    """A file that was cut off can decode without any error: hold what came out against what the container declares."""
    if stream.frames and len(times) < stream.frames - MISSING_FRAMES_ALLOWED:
        raise InputError(f"{path}: holds {len(times)} of {stream.frames} frames; the file was cut off, copy it again")
    if stream.duration and stream.time_base and len(times) > 1:
        declared, found = float(stream.duration * stream.time_base), float(times[-1] - times[0])
        if found < declared - MISSING_SECONDS_ALLOWED:
            raise InputError(f"{path}: ends after {found:.1f} of {declared:.1f} s; the file was cut off, copy it again")


def _upright(frame: av.VideoFrame) -> NDArray[np.uint8]:
    image = np.asarray(frame.to_ndarray(format="rgb24"), dtype=np.uint8)
    quarter_turns, rest = divmod(frame.rotation, 90)
    return np.ascontiguousarray(np.rot90(image, quarter_turns)) if rest == 0 else image


def _microseconds(times: list[Fraction]) -> NDArray[np.int64]:
    return np.array([round((time - times[0]) * 1_000_000) for time in times], dtype=np.int64)
