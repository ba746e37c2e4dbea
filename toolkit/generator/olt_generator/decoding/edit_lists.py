"""Edit lists of mp4 and mov files: which parts of a track are shown, and in which order (ISO/IEC 14496-12, 8.6.6).

FFmpeg applies the usual ones, a wait and then one part. Of several parts with reordered frames, and of waits between
them, it makes wrong times, so these are applied here.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO

from olt_generator.errors import InputError

_LARGEST_LIST = 1 << 20


@dataclass(frozen=True)
class Edit:
    """Media from `media_start` to `media_end`, in seconds of the track, is shown from `shown_start` on."""

    media_start: Fraction
    media_end: Fraction
    shown_start: Fraction

    def shown_time(self, media_time: Fraction) -> Fraction | None:
        """When a frame of this media time is shown, in seconds; None where this edit leaves it out."""
        if not self.media_start <= media_time < self.media_end:
            return None
        return self.shown_start + media_time - self.media_start


def read_several_edits(path: Path, track_id: int) -> list[Edit]:
    """The edits of a track in the order in which they are shown, if it has several; none where FFmpeg gets it right.

    Raises:
        InputError: a picture is held or media runs faster, which no list of frame times says.
    """
    with path.open("rb") as file:
        entries = _read_entries(file, track_id)
    if entries is None:
        return []
    movie_scale, media_scale, rows = entries
    edits, shown = [], Fraction(0)
    for duration, start, rate in rows:
        if start >= 0 and rate != 1:
            raise InputError(
                f"{path}: its edit list shows a part at {rate:g} times its speed; convert the video, so that frame "
                "times say what is shown"
            )
        length = Fraction(duration, movie_scale)
        if start >= 0:
            first = Fraction(start, media_scale)
            edits.append(Edit(first, first + length, shown))
        shown += length
    return edits if len(edits) > 1 else []


def _read_entries(file: BinaryIO, track_id: int) -> tuple[int, int, list[tuple[int, int, float]]] | None:
    """Ticks a second of the movie and of the track, and (duration, media time, rate) of each edit."""
    end = file.seek(0, 2)
    movie = next((span for name, span in _boxes(file, (0, end)) if name == b"moov"), None)
    if movie is None:
        return None
    movie_scale = 0
    for name, span in _boxes(file, movie):
        if name == b"mvhd":
            movie_scale = _time_scale(_read(file, span, 32))
        if name == b"trak":
            track = dict(_boxes(file, span))
            if not {b"tkhd", b"edts", b"mdia"} <= track.keys():
                continue
            header = _read(file, track[b"tkhd"], 32)
            if struct.unpack_from(">I", header, 20 if header[0] == 1 else 12)[0] != track_id:
                continue
            media, edits = dict(_boxes(file, track[b"mdia"])), dict(_boxes(file, track[b"edts"]))
            if b"mdhd" in media and b"elst" in edits and movie_scale:
                rows = _parse_list(_read(file, edits[b"elst"], _LARGEST_LIST))
                return movie_scale, _time_scale(_read(file, media[b"mdhd"], 32)), rows
    return None


def _boxes(file: BinaryIO, span: tuple[int, int]) -> Iterator[tuple[bytes, tuple[int, int]]]:
    """Names of the boxes between two places of a file, and where their contents begin and end."""
    start, end = span
    while start + 8 <= end:
        size, name = struct.unpack(">I4s", _read(file, (start, start + 8), 8))
        head = 8
        if size == 1 and start + 16 <= end:
            size, head = struct.unpack(">Q", _read(file, (start + 8, start + 16), 8))[0], 16
        elif size == 0:
            size = end - start
        if size < head:
            return  # damaged; FFmpeg says so
        yield name, (start + head, min(start + size, end))
        start += size


def _read(file: BinaryIO, span: tuple[int, int], most: int) -> bytes:
    file.seek(span[0])
    content = file.read(min(most, span[1] - span[0]))
    return content.ljust(min(most, 32), b"\0")


def _time_scale(header: bytes) -> int:
    return struct.unpack_from(">I", header, 20 if header[0] == 1 else 12)[0]


def _parse_list(content: bytes) -> list[tuple[int, int, float]]:
    layout = ">QqhH" if content[0] == 1 else ">IihH"
    size = struct.calcsize(layout)
    count = min(struct.unpack_from(">I", content, 4)[0], (len(content) - 8) // size)
    rows = (struct.unpack_from(layout, content, 8 + size * number) for number in range(count))
    return [(duration, start, whole + fraction / 65536) for duration, start, whole, fraction in rows]
