"""The coded frames of a video file: when each is shown, which are hidden, and whether all are there."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.packet import Packet
from av.stream import Disposition
from av.video.stream import VideoStream

from olt_generator.decoding.edit_lists import Edit, read_several_edits
from olt_generator.errors import InputError

# How many frames a container may announce and not hold: some writers count one that is never shown.
MISSING_FRAMES_ALLOWED = 1
MISSING_SECONDS_ALLOWED = 0.5
# Phones note the rate of capture here; a rate that varies with the light differs from it by less than this log ratio.
_CAPTURE_RATE, _MOST_SPEED_ERROR = "com.android.capture.fps", 0.4


@dataclass(frozen=True)
class CodedFrame:
    """When a frame is shown and decoded.

    Attributes:
        pts, dts: its times in ticks of the stream, by which it is found.
        time, end: seconds from when to when it is shown, on the clock of the stream.
        is_key: whether it is decoded without others.
        is_hidden: whether an edit list hides it; others may need it all the same.
    """

    pts: int
    dts: int
    time: Fraction
    end: Fraction
    is_key: bool
    is_hidden: bool


@dataclass(frozen=True)
class OpenVideo:
    """The container and the first video stream of a file, and edits that FFmpeg does not apply."""

    path: Path
    container: InputContainer
    stream: VideoStream
    edits: list[Edit]


@contextmanager
def open_video(path: Path) -> Iterator[OpenVideo]:
    """Open a file; FFmpeg's errors inside become `InputError`."""
    if not path.is_file():
        raise InputError(f"{path}: {'not a regular file' if path.exists() else 'no such video file'}; give a video")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; copy or download it again")
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            stream = _find_stream(path, container)
            _check_speed(path, container, stream)
            edits = read_several_edits(path, stream.id) if "mp4" in container.format.name else []
            if not edits:
                yield OpenVideo(path, container, stream, [])
                return
        with _open_unedited(path) as container:
            yield OpenVideo(path, container, _find_stream(path, container), edits)
    except FFmpegError as error:
        raise InputError(f"{path}: not a readable video ({error.strerror}); copy or convert it again") from error


def read_coded_frames(
    video: OpenVideo, duration: float | None = None, on_packet: Callable[[Packet], None] | None = None
) -> list[CodedFrame]:
    """All frames, shown and hidden, in the order of their times; B-frames lie in another order in the file.

    Only the beginning of the file is read where a duration in seconds from the first shown frame is given. `on_packet`
    is given each coded picture, in the order of the file.

    Raises:
        InputError: none is shown, one has no time or that of another, or the file was cut off.
    """
    path, count, reached_end = video.path, 0, False
    coded: list[CodedFrame] = []
    first = None
    for packet in video.container.demux(video.stream):
        if packet.size == 0:
            continue  # the end of the stream
        check_packet(path, packet, count)
        if on_packet is not None:
            on_packet(packet)
        coded += _code(path, packet, count, video.edits)
        count += 1
        if first is None and not coded[-1].is_hidden:
            first = coded[-1].time
        # What is decoded later is shown later still, unless parts of the media have changed places.
        is_beyond = first is not None and duration is not None and coded[-1].dts * packet.time_base - first >= duration
        if is_beyond and not video.edits:
            break
    else:
        reached_end = True
    coded.sort(key=lambda frame: frame.time)
    shown = [frame for frame in coded if not frame.is_hidden]
    if not shown:
        raise InputError(f"{path}: holds no frame that is shown; copy or convert the video again")
    if reached_end:
        check_complete(path, video.stream, count, float(shown[-1].end - shown[0].time))
    twice = [number for number, (before, after) in enumerate(pairwise(shown), 1) if before.time == after.time]
    if twice:
        raise InputError(f"{path}: frame {twice[0]} is not later than the one before it; convert it to mp4")
    return coded


def _code(path: Path, packet: Packet, number: int, edits: list[Edit]) -> Iterator[CodedFrame]:
    """The coded frame of a packet, once for each edit that shows it; hidden where none of them does."""
    if packet.pts is None or packet.time_base is None:
        raise InputError(f"{path}: frame {number} has no presentation time; convert the video to mp4")
    dts = packet.pts if packet.dts is None else packet.dts
    media, length = packet.pts * packet.time_base, (packet.duration or 0) * packet.time_base
    shown = [time for edit in edits if (time := edit.shown_time(media)) is not None]
    is_hidden = packet.is_discard or (bool(edits) and not shown)
    for time in shown or [media]:
        yield CodedFrame(packet.pts, dts, time, time + length, packet.is_keyframe, is_hidden)


def _find_stream(path: Path, container: InputContainer) -> VideoStream:
    # Pictures of a cover or a thumbnail are streams too.
    films = [each for each in container.streams.video if Disposition.attached_pic not in each.disposition]
    if not films:
        raise InputError(f"{path}: the file has no video stream; give a video file")
    if films[0].codec_context is None:
        raise InputError(f"{path}: nothing here decodes its video; convert it to H.264")
    return films[0]


def _check_speed(path: Path, container: InputContainer, stream: VideoStream) -> None:
    """Refuse slow motion and time lapse that the recorder notes, as Android does, beside times at another speed."""
    noted = container.metadata.get(_CAPTURE_RATE) or stream.metadata.get(_CAPTURE_RATE)
    try:
        captured = float(noted or 0.0)
    except ValueError:
        return
    played = float(stream.average_rate or 0.0)
    if captured > 0.0 and played > 0.0 and abs(np.log(captured / played)) > _MOST_SPEED_ERROR:
        raise InputError(
            f"{path}: was captured at {captured:g} frames a second and plays at {played:g}, as slow motion or time "
            "lapse; convert it so that it plays at the speed at which things happened"
        )


def _open_unedited(path: Path) -> InputContainer:
    return av.open(str(path), options={"ignore_editlist": "1"}, metadata_errors="replace")


def check_packet(path: Path, packet: Packet, number: int) -> None:
    """Refuse (`InputError`) a coded frame of which only a part is there."""
    if packet.is_corrupt:
        raise InputError(
            f"{path}: the coded frame {number} is not whole; the file is damaged or cut off, copy it again"
        )


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
    with _open_unedited(path) as container:
        packets = container.demux(container.streams[stream_index])
        return sum(packet.size > 0 and not packet.is_corrupt for packet in packets)
