"""Frames out of a clip's video, by number and at the size that is wanted.

Of a plain mp4 file only the bytes that the wanted frames depend on are read, and frames that no other frame needs are
not decoded unless they are wanted. Any other file goes through FFmpeg's demuxer, with the same result.
"""

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import av
import av.error
import cv2
import numpy as np
from av.video.codeccontext import VideoCodecContext
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_toolkit.clips.chunk_archive import ByteRange
from olt_toolkit.clips.mp4_index import Mp4Index, Read, read_mp4_index

# A reformatter keeps its tables from frame to frame; making them takes longer than using them.
Convert = Callable[[VideoFrame], NDArray[np.uint8]]
Found = Iterator[tuple[int, NDArray[np.uint8]]]


def decode_frames(video: ByteRange | bytes, indices: NDArray[np.int64], where: str) -> NDArray[np.uint8]:
    """Decode frames (m, H, W, 3), RGB, each once and in one pass.

    Frame k of a stream of constant rate starts at k whole periods of container time, which is how the public reader
    counts (docs/formats/physicalai_av.md). Numbers (m,) may repeat; `where` is what an error message calls the video.

    Raises:
        InputError: the video is damaged or has fewer frames.
    """
    reformatter = VideoReformatter()
    return _decode(video, indices, where, lambda frame: _to_rgb(reformatter, frame))


def decode_images(
    video: ByteRange | bytes, indices: NDArray[np.int64], where: str, size: tuple[int, int] | None
) -> NDArray[np.uint8]:
    """Decode frames as policies take them: (m, 3, H, W), RGB, scaled to a height and width where these are given.

    Scaling takes the mean of the area that a new pixel covers, of brightness and colour before they become RGB. It
    differs from scaling the RGB image because the colour planes of a video are coarser than its brightness: by less
    than 2 grey levels RMS in brightness, and by more only where strong colours change within a few pixels.

    The other arguments and errors are those of `decode_frames`.
    """
    reformatter = VideoReformatter()

    def to_planes(frame: VideoFrame) -> NDArray[np.uint8]:
        height, width = size or (frame.height, frame.width)
        if (height, width) == (frame.height, frame.width):
            image = _to_rgb(reformatter, frame)
        else:
            # Planar RGB, because FFmpeg halves the resolution of colour on its way to packed RGB.
            image = reformatter.reformat(frame, width, height, "gbrp", interpolation="AREA", threads=1).to_ndarray()
        planes = np.empty((3, height, width), np.uint8)
        cv2.split(image, [planes[0], planes[1], planes[2]])
        return planes

    return _decode(video, indices, where, to_planes)


def find_key_frames(video: ByteRange | bytes, count: int) -> NDArray[np.int64]:
    """Numbers (k,) of the first `count` frames that are decoded without others; none where its tables do not tell."""
    with _open(video) as (read, length):
        index = read_mp4_index(read, length)
    if index is None:
        return np.empty(0, np.int64)
    keys = np.sort(index.shown[index.is_key])
    return keys[keys < count]


def check_video(video: ByteRange | bytes, count: int, where: str) -> None:
    """Check (`InputError`) that the public reader finds `count` frames; decodes only where the tables do not tell."""
    with _open(video) as (read, length):
        index = read_mp4_index(read, length)
    if index is None:
        decode_frames(video, np.arange(count), where)
    elif len(index.shown) < count:
        raise InputError(f"{where}: the video has {len(index.shown)} frames for {count} timestamps; build it again")


def _decode(video: ByteRange | bytes, indices: NDArray[np.int64], where: str, convert: Convert) -> NDArray[np.uint8]:
    wanted = np.unique(indices)
    try:
        with _open(video) as (read, length):
            index = read_mp4_index(read, length)
            if index is None:
                found = dict(_decode_by_container(read(0, length), wanted, convert, where))
            else:
                found = dict(_decode_by_index(read, index, wanted, convert, where))
    except (av.error.FFmpegError, IndexError, OSError) as error:
        raise InputError(f"{where}: the video cannot be decoded; build the clip again") from error
    missing = set(wanted.tolist()) - found.keys()
    if missing:
        raise InputError(
            f"{where}: the video has no frame {min(missing)}, which its timestamps promise; build it again"
        )
    return np.stack([found[number] for number in indices.tolist()])


def _decode_by_index(read: Read, index: Mp4Index, wanted: NDArray[np.int64], convert: Convert, where: str) -> Found:
    asked = set(wanted.tolist())
    decoder = av.CodecContext.create(index.codec, "r")
    assert isinstance(decoder, VideoCodecContext)
    decoder.extradata = index.extradata
    decoder.thread_count = 1
    for first, last in _runs(index, wanted):
        offsets, sizes = index.offsets[first : last + 1], index.sizes[first : last + 1]
        start, end = int(offsets.min()), int((offsets + sizes).max())
        data = read(start, end - start)
        for number, offset, size in zip(index.shown[first : last + 1].tolist(), offsets - start, sizes, strict=True):
            # A frame that no other depends on is not decoded unless it is asked for.
            decoder.skip_frame = "DEFAULT" if number in asked else "NONREF"
            packet = av.Packet(data[offset : offset + size])
            packet.pts = number
            yield from _take(decoder.decode(packet), asked, convert, where)
        yield from _take(decoder.decode(None), asked, convert, where)
        decoder.flush_buffers()


def _runs(index: Mp4Index, wanted: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Ranges (first, last), in the order of decoding, of the frames that give the wanted ones."""
    position = np.argsort(index.shown)
    keys = np.flatnonzero(index.is_key)
    runs: list[tuple[int, int]] = []
    for last in sorted(position[wanted[wanted < len(position)]].tolist()):
        key = int(np.searchsorted(keys, last, side="right")) - 1
        # Frames that are decoded after a key frame but shown before it need the key frame before that, too.
        leading = index.shown[last] < index.shown[keys[key]] and key > 0
        first = int(keys[key - leading])
        while runs and first <= runs[-1][1]:
            first = min(first, runs.pop()[0])
        runs.append((first, last))
    return runs


def _decode_by_container(video: bytes, wanted: NDArray[np.int64], convert: Convert, where: str) -> Found:
    asked = set(wanted.tolist())
    with av.open(io.BytesIO(video), "r") as container:
        stream = container.streams.video[0]
        if stream.codec_context is None or stream.average_rate is None or stream.time_base is None:
            raise InputError(f"{where}: the video has no known codec or no frame rate; build the clip again")
        stream.codec_context.thread_count = 1
        period = int(1 / stream.average_rate / stream.time_base)
        container.seek(int(wanted[0]) * period, stream=stream)
        for frame in container.decode(stream):
            frame.pts = round((frame.pts or 0) / period)
            yield from _take([frame], asked, convert, where)
            if frame.pts >= wanted[-1]:
                break


def _take(frames: Sequence[VideoFrame], asked: set[int], convert: Convert, where: str) -> Found:
    for frame in frames:
        if frame.is_corrupt:
            raise InputError(f"{where}: frame {frame.pts} of the video is damaged; build the clip again")
        if frame.pts in asked:
            yield frame.pts, convert(frame)


def _to_rgb(reformatter: VideoReformatter, frame: VideoFrame) -> NDArray[np.uint8]:
    return np.asarray(reformatter.reformat(frame, format="rgb24", threads=1).to_ndarray(), np.uint8)


@contextmanager
def _open(video: ByteRange | bytes) -> Iterator[tuple[Read, int]]:
    if isinstance(video, bytes):
        yield lambda start, size: video[start : start + size], len(video)
        return
    with video.path.open("rb") as file:

        def read(start: int, size: int) -> bytes:
            file.seek(video.start + start)
            return file.read(min(size, video.size - start))

        yield read, video.size
