"""Reading and writing video files."""

import hashlib
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from av.error import FFmpegError
from av.video.reformatter import Colorspace
from av.video.stream import VideoStream
from numpy.typing import NDArray

from olt_generator.decoding.coded_frames import (
    MISSING_FRAMES_ALLOWED,
    CodedFrame,
    OpenVideo,
    check_complete,
    check_packet,
    open_video,
    read_coded_frames,
)
from olt_generator.decoding.orientation import AS_STORED, Orientation
from olt_generator.decoding.pictures import PictureReader
from olt_generator.errors import InputError
from olt_generator.files import write_whole

KEY_FRAME_EVERY = 30
QUALITY = "18"
MAX_RATE_DENOMINATOR = 1001


@dataclass(frozen=True)
class Video:
    """A decoded video.

    Attributes:
        frames: (n, H, W, 3) uint8 RGB, as players show them.
        timestamps_us: (n,) int64 presentation times in microseconds, strictly increasing, the first is 0.
        frame_rate: mean frames per second over what was decoded; as declared for a single frame, 0 if unknown.
        notes: a sentence for every way in which the file was read where another one was possible.
    """

    frames: NDArray[np.uint8]
    timestamps_us: NDArray[np.int64]
    frame_rate: float
    notes: tuple[str, ...] = ()


def read_video(path: Path, width: int = 832, duration: float = 20.0, turned: Orientation = AS_STORED) -> Video:
    """Decode the beginning of a video at working resolution, each frame as players show it (docs/formats/video.md).

    Args:
        path: a file that FFmpeg can decode.
        width: width of the frames in pixels; smaller videos keep theirs. The height follows the aspect ratio.
        duration: at most this many seconds from the first frame that is shown.
        turned: how pictures are turned and mirrored beyond what the file itself says.

    Raises:
        InputError: the file is missing, empty, no video, damaged or cut off, its times run backwards, or its pictures
            cannot be shown as they are meant.
    """
    with open_video(path) as video:
        pictures = PictureReader(path, video.stream, width, turned)
        video.stream.thread_type = "AUTO"
        if video.edits:
            coded = read_coded_frames(video)
            shown = _shown(coded)
            inside = [number for number, frame in enumerate(shown) if frame.time - shown[0].time < duration]
            frames, times = _decode_some(video, coded, inside, pictures), [shown[number].time for number in inside]
        else:
            frames, times = _decode(video, pictures, duration)
        return _as_video(video.stream, frames, _microseconds(times), pictures)


def read_frame_times(path: Path, duration: float | None = None) -> NDArray[np.int64]:
    """Times (n,) of all frames in microseconds since the first, as `read_video` gives them, without decoding any.

    With a duration in seconds only those of the beginning, and only that is read.

    Raises:
        InputError: the file is missing, empty, no video or cut off, or two frames are shown at the same time.
    """
    with open_video(path) as video:
        times = [frame.time for frame in _shown(read_coded_frames(video, duration))]
    return _microseconds([time for time in times if duration is None or time - times[0] < duration])


def read_frame_times_and_digest(path: Path) -> tuple[NDArray[np.int64], str]:
    """The times (n,) of `read_frame_times`, and 20 hexadecimal digits that tell this recording from any other.

    The digits are BLAKE2b of the times and of all coded pictures: neither the file's name and place nor what else is in
    it (sound, titles, where its index lies) changes them. Nothing is decoded.

    Raises:
        InputError: see `read_frame_times`.
    """
    digest = hashlib.blake2b(digest_size=10)
    with open_video(path) as video:
        times = [frame.time for frame in _shown(read_coded_frames(video, on_packet=digest.update))]
    times_us = _microseconds(times)
    digest.update(times_us.astype("<i8").tobytes())
    return times_us, digest.hexdigest()


def read_video_window(
    path: Path, first_us: int, last_us: int, width: int = 832, turned: Orientation = AS_STORED
) -> Video:
    """Decode the frames that are shown between two times, from the last key frame before them on.

    Args:
        path: a file that FFmpeg can decode.
        first_us, last_us: times in microseconds since the first frame of the video, both included.
        width, turned: see `read_video`.

    Returns:
        The frames; their times are still those since the first frame of the video.

    Raises:
        InputError: as `read_frame_times` and `read_video`; no frame is shown at these times, or one is damaged.
    """
    with open_video(path) as video:
        coded = read_coded_frames(video)
        timestamps_us = _microseconds([frame.time for frame in _shown(coded)])
        inside = np.flatnonzero((timestamps_us >= first_us) & (timestamps_us <= last_us))
        if len(inside) == 0:
            raise InputError(f"{path}: no frame is shown between {first_us} and {last_us} us; give times of the video")
        pictures = PictureReader(path, video.stream, width, turned)
        video.stream.thread_type = "AUTO"
        frames = _decode_some(video, coded, inside.tolist(), pictures)
        return _as_video(video.stream, frames, timestamps_us[inside], pictures)


def read_video_images(
    path: Path, wanted_us: NDArray[np.int64], reach_us: NDArray[np.int64], width: int
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Decode a few frames of a video, each from the last key frame before it on.

    Args:
        path: a file that FFmpeg can decode.
        wanted_us: (m,) times in microseconds since the first frame of the video.
        reach_us: (m,) how far from each wanted time a key frame may be to be taken in place of the nearest frame.
        width: see `read_video`.

    Returns:
        A frame (m, H, W, 3) for each wanted time, and the times (m,) at which these are shown.

    Raises:
        InputError: as `read_video_window`.
    """
    with open_video(path) as video:
        coded = read_coded_frames(video)
        shown = _shown(coded)
        times_us = _microseconds([frame.time for frame in shown])
        keys = np.flatnonzero([frame.is_key for frame in shown])
        numbers = _nearest(times_us, wanted_us)
        if len(keys):
            near = keys[_nearest(times_us[keys], wanted_us)]
            numbers = np.where(np.abs(times_us[near] - wanted_us) <= reach_us, near, numbers)
        pictures = PictureReader(path, video.stream, width)
        # Frames after the same key frame are decoded in one go.
        distinct = np.unique(numbers)
        parts = np.split(distinct, np.flatnonzero(np.diff(np.searchsorted(keys, distinct, side="right"))) + 1)
        images = np.concatenate([_decode_some(video, coded, part.tolist(), pictures) for part in parts])
        return images[np.searchsorted(distinct, numbers)], times_us[numbers]


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
        # FFmpeg makes BT.601 of RGB, and players take large pictures that do not say so for BT.709.
        stream.codec_context.colorspace = int(Colorspace.ITU601)
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


def _as_video(
    stream: VideoStream, frames: NDArray[np.uint8], timestamps_us: NDArray[np.int64], pictures: PictureReader
) -> Video:
    rate = float(stream.average_rate or 0.0)
    if len(frames) > 1:
        rate = 1e6 * (len(frames) - 1) / float(timestamps_us[-1] - timestamps_us[0])
    return Video(frames, timestamps_us, rate, tuple(pictures.notes))


def _shown(coded: list[CodedFrame]) -> list[CodedFrame]:
    return [frame for frame in coded if not frame.is_hidden]


def _decode_some(
    video: OpenVideo, coded: list[CodedFrame], inside: list[int], pictures: PictureReader
) -> NDArray[np.uint8]:
    """Decode the shown frames of these numbers; they are known by their times and not by where a seek lands."""
    path, stream, shown = video.path, video.stream, _shown(coded)
    numbers = {shown[number].pts: number for number in inside}
    first, last = min(numbers), max(numbers)
    # Frames that are decoded after a key frame but shown before it need the key frame before that.
    keys = [frame for frame in coded if frame.is_key and frame.pts <= first]
    start = max(keys, key=lambda frame: frame.pts) if keys else min(coded, key=lambda frame: frame.pts)
    video.container.seek(start.dts, stream=stream)
    found: dict[int, NDArray[np.uint8]] = {}
    for frame in video.container.decode(stream):
        if frame.pts in numbers:
            if frame.is_corrupt:
                raise InputError(f"{path}: frame {numbers[frame.pts]} is damaged; copy the video again")
            found[frame.pts] = pictures.read(frame, numbers[frame.pts])
        if frame.pts is not None and frame.pts >= last:
            break
    missing = [number for pts, number in numbers.items() if pts not in found]
    if missing:
        raise InputError(f"{path}: frame {min(missing)} cannot be decoded; copy or convert the video again")
    return np.stack([found[shown[number].pts] for number in inside])


def _decode(video: OpenVideo, pictures: PictureReader, duration: float) -> tuple[NDArray[np.uint8], list[Fraction]]:
    path, stream = video.path, video.stream
    frames: list[NDArray[np.uint8]] = []
    times: list[Fraction] = []
    stored = hidden = 0
    end = Fraction(0)
    try:
        for packet in video.container.demux(stream):
            if packet.size:
                check_packet(path, packet, stored)
                stored, hidden = stored + 1, hidden + packet.is_discard
            for frame in packet.decode():
                where = f"{path}: frame {len(frames)}"
                if frame.is_corrupt:
                    raise InputError(f"{where} is damaged; copy the video again or cut it before this frame")
                if frame.pts is None or frame.time_base is None:
                    raise InputError(f"{where} has no presentation time; convert the video to mp4")
                time = frame.pts * frame.time_base
                if times and time <= times[-1]:
                    raise InputError(f"{where} is not later than the one before it; convert it to mp4")
                if times and time - times[0] >= duration:
                    return np.stack(frames), times
                times.append(time)
                end = time + frame.duration * frame.time_base
                frames.append(pictures.read(frame, len(frames)))
    except FFmpegError as error:
        raise InputError(
            f"{path}: decoding fails after frame {len(frames) - 1} ({error.strerror}); copy the video again"
        ) from error
    if not frames:
        raise InputError(f"{path}: no frame could be decoded; copy or convert the video again")
    check_complete(path, stream, stored, float(end - times[0]))
    if stream.frames and len(frames) + hidden < stored - MISSING_FRAMES_ALLOWED:
        raise InputError(f"{path}: only {len(frames)} of {stored - hidden} frames can be decoded; copy the video again")
    return np.stack(frames), times


def _nearest(times_us: NDArray[np.int64], wanted_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number (m,) of the time of increasing ones (n,) nearest to each wanted one; of two as near, the earlier."""
    after = np.minimum(np.searchsorted(times_us, wanted_us), len(times_us) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(wanted_us - times_us[before] <= times_us[after] - wanted_us, before, after)


def _microseconds(times: list[Fraction]) -> NDArray[np.int64]:
    return np.array([round((time - times[0]) * 1_000_000) for time in times], dtype=np.int64)
