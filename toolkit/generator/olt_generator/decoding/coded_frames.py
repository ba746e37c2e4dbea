"""The coded frames of a video file: when each is shown, which are hidden, and whether all are there."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
from av.container import InputContainer
from av.error import FFmpegError
from av.packet import Packet
from av.stream import Disposition
from av.video.stream import VideoStream

from olt_generator.errors import InputError

# How many frames a container may announce and not hold: some writers count one that is never shown.
MISSING_FRAMES_ALLOWED = 1
MISSING_SECONDS_ALLOWED = 0.5


@dataclass(frozen=True)
class CodedFrame:
    """When a frame is shown and decoded, and for how long, in units of `time_base` seconds.

    Attributes:
        is_key: whether it is decoded without others.
        is_hidden: whether an edit list hides it; others may need it all the same.
    """

    pts: int
    dts: int
    duration: int
    time_base: Fraction
    is_key: bool
    is_hidden: bool

    @property
    def time(self) -> Fraction:
        """Seconds at which it is shown, on the clock of the stream."""
        return self.pts * self.time_base

    @property
    def end(self) -> Fraction:
        """Seconds at which it is shown no longer."""
        return (self.pts + self.duration) * self.time_base


@contextmanager
def open_video(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    """The container and first video stream of a file; FFmpeg's errors inside become `InputError`."""
    if not path.is_file():
        raise InputError(f"{path}: no such video file")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; copy or download it again")
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            # Pictures of a cover or a thumbnail are streams too.
            films = [each for each in container.streams.video if Disposition.attached_pic not in each.disposition]
            if not films:
                raise InputError(f"{path}: the file has no video stream; give a video file")
            if films[0].codec_context is None:
                raise InputError(f"{path}: nothing here decodes its video; convert it to H.264")
            yield container, films[0]
    except FFmpegError as error:
        raise InputError(f"{path}: not a readable video ({error.strerror}); copy or convert it again") from error


def read_coded_frames(
    path: Path, container: InputContainer, stream: VideoStream, duration: float | None = None
) -> list[CodedFrame]:
    """All frames, in the order in which they are shown; B-frames lie in another order in the file.

    Only the beginning of the file is read where a duration in seconds from the first shown frame is given.

    Raises:
        InputError: there is none, one has no time or that of another, or the file was cut off.
    """
    coded, first, reached_end = [], None, False
    for packet in container.demux(stream):
        if packet.size == 0:
            continue  # the end of the stream
        check_packet(path, packet, len(coded))
        if packet.pts is None:
            raise InputError(f"{path}: frame {len(coded)} has no presentation time; convert the video to mp4")
        dts = packet.pts if packet.dts is None else packet.dts
        base = Fraction(packet.time_base)
        frame = CodedFrame(packet.pts, dts, packet.duration or 0, base, packet.is_keyframe, packet.is_discard)
        coded.append(frame)
        if first is None and not frame.is_hidden:
            first = frame.time
        # What is decoded later is shown later still.
        if duration is not None and first is not None and dts * base - first >= duration:
            break
    else:
        reached_end = True
    shown = sorted((frame for frame in coded if not frame.is_hidden), key=lambda frame: frame.pts)
    if not shown:
        raise InputError(f"{path}: holds no frame that is shown; copy or convert the video again")
    if reached_end:
        check_complete(path, stream, len(coded), float(shown[-1].end - shown[0].time))
    twice = [number for number, (before, after) in enumerate(pairwise(shown), 1) if before.pts == after.pts]
    if twice:
        raise InputError(f"{path}: frame {twice[0]} is not later than the one before it; convert it to mp4")
    return sorted(coded, key=lambda frame: frame.pts)


def check_packet(path: Path, packet: Packet, number: int) -> None:
    """Refuse (`InputError`) a coded frame of which the file holds only a part."""
    if packet.is_corrupt:
        raise InputError(f"{path}: the coded frame {number} is not whole; the file was cut off, copy it again")


def check_complete(path: Path, stream: VideoStream, count: int, seconds: float) -> None:
    """Hold `count` frames, shown and hidden, that are shown for so many seconds, against what the container declares.

    A file that was cut off can decode without any error. Containers that count their frames are held to that, counted
    with those that an edit list leaves out; others to the time until the last frame is shown no longer.

    Raises:
        InputError: the file was cut off.
    """
    if stream.frames:
        least = stream.frames - MISSING_FRAMES_ALLOWED
        if count < least and (held := _count_stored(path, stream.index)) < least:
            raise InputError(f"{path}: holds {held} of {stream.frames} frames; the file was cut off, copy it again")
    elif stream.duration and stream.time_base:
        declared = float(stream.duration * stream.time_base)
        if seconds < declared - MISSING_SECONDS_ALLOWED:
            raise InputError(
                f"{path}: ends after {seconds:.1f} of {declared:.1f} s; the file was cut off, copy it again"
            )


def _count_stored(path: Path, stream_index: int) -> int:
    """How many whole frames of a stream a file holds, with those that its edit list leaves out altogether."""
    with av.open(str(path), options={"ignore_editlist": "1"}, metadata_errors="replace") as container:
        packets = container.demux(container.streams[stream_index])
        return sum(packet.size > 0 and not packet.is_corrupt for packet in packets)
