"""Where the frames of an mp4 file lie, from its sample tables alone (ISO/IEC 14496-12).

A general demuxer decodes the first frames of every file that it opens, to learn what the tables do not say. The tables
of a clip's video say all that decoding a few frames takes.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Read = Callable[[int, int], bytes]
"""Gives `size` bytes of the video from `start` on."""

_CODECS = {
    b"avc1": ("h264", b"avcC"),
    b"avc3": ("h264", b"avcC"),
    b"hvc1": ("hevc", b"hvcC"),
    b"hev1": ("hevc", b"hvcC"),
}
_SAMPLE_ENTRY_FIELDS = 78
_LARGEST_TABLES = 64 << 20


@dataclass(frozen=True)
class Mp4Index:
    """The frames of a video in the order in which they are decoded.

    Attributes:
        codec: name of the decoder.
        extradata: what the decoder must know before the first frame.
        offsets, sizes: (n,) where each frame's bytes lie in the file.
        is_key: (n,) whether decoding can begin with the frame.
        shown: (n,) the frame's number in the order of showing.
    """

    codec: str
    extradata: bytes
    offsets: NDArray[np.int64]
    sizes: NDArray[np.int64]
    is_key: NDArray[np.bool_]
    shown: NDArray[np.int64]


def read_mp4_index(read: Read, size: int) -> Mp4Index | None:
    """Read the index of a file of `size` bytes.

    Returns:
        None for everything that is not a plain file of one H.264 or H.265 stream of constant rate that begins at time
        0: another format, a fragmented or damaged file, gaps, tagged colours. A demuxer has to see to those.
    """
    try:
        movie = _find_movie(read, size)
        if movie is None:
            return None
        tracks = [track for kind, track in _boxes(movie) if kind == b"trak"]
        (video,) = [track for track in tracks if _box(track, b"mdia", b"hdlr")[8:12] == b"vide"]
        return _read_track(video, size)
    except (struct.error, LookupError, ValueError):
        return None


def _find_movie(read: Read, size: int) -> bytes | None:
    start = 0
    while start + 8 <= size:
        length, kind = struct.unpack(">I4s", read(start, 8))
        header = 8
        if length == 1:
            (length,), header = struct.unpack(">Q", read(start + 8, 8)), 16
        if length < header:
            return None
        if kind == b"moov":
            return read(start + header, length - header) if length <= _LARGEST_TABLES else None
        start += length
    return None


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    start = 0
    while start + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, start)
        if length < 8:
            raise ValueError("a box of no length")
        yield kind, data[start + 8 : start + length]
        start += length


def _box(data: bytes, *path: bytes) -> bytes:
    for kind in path:
        data = dict(_boxes(data))[kind]
    return data


def _read_track(track: bytes, file_size: int) -> Mp4Index | None:
    tables = dict(_boxes(_box(track, b"mdia", b"minf", b"stbl")))
    entry_kind, entry = next(_boxes(tables[b"stsd"][8:]))
    codec, configuration = _CODECS[entry_kind]
    settings = dict(_boxes(entry[_SAMPLE_ENTRY_FIELDS:]))
    uniform, count = struct.unpack_from(">II", tables[b"stsz"], 4)
    if uniform and count > file_size:
        raise ValueError("more frames than bytes")
    sizes = np.full(count, uniform, np.int64) if uniform else _numbers(tables[b"stsz"], 12)[:count]
    shown = _shown(tables, _first_shown_time(track), len(sizes))
    offsets = _offsets(tables, sizes)
    if shown is None or b"colr" in settings or int((offsets + sizes).max()) > file_size:
        return None
    is_key = np.ones(len(sizes), bool) if b"stss" not in tables else np.zeros(len(sizes), bool)
    if b"stss" in tables:
        is_key[_numbers(tables[b"stss"], 8) - 1] = True
    return Mp4Index(codec, settings[configuration], offsets, sizes, is_key, shown) if is_key[0] else None


def _shown(tables: dict[bytes, bytes], start: int, count: int) -> NDArray[np.int64] | None:
    """Number of each frame in the order of showing; None unless these are at one constant distance from time 0 on."""
    runs = _numbers(tables[b"stts"], 8).reshape(-1, 2)
    steps = _repeat(runs[:, 1], runs[:, 0], count)
    times = np.cumsum(steps) - steps - start
    if b"ctts" in tables:
        delays = _numbers(tables[b"ctts"], 8, signed=True).reshape(-1, 2)
        times = times + _repeat(delays[:, 1], delays[:, 0], count)
    step = int(steps[0])
    constant = step > 0 and len(times) == count and np.array_equal(np.sort(times), step * np.arange(count))
    return times // step if constant else None


def _first_shown_time(track: bytes) -> int:
    """Time of the media at which showing begins."""
    boxes = dict(_boxes(track))
    if b"edts" not in boxes:
        return 0
    edits = _box(boxes[b"edts"], b"elst")
    version, count = edits[0], struct.unpack_from(">I", edits, 4)[0]
    start = struct.unpack_from(">q", edits, 16)[0] if version == 1 else struct.unpack_from(">i", edits, 12)[0]
    if count != 1 or start < 0:
        raise ValueError("the video is put together of several pieces")
    return start


def _offsets(tables: dict[bytes, bytes], sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Where each frame lies: frames are grouped in runs, whose places and lengths the tables give."""
    wide = b"co64" in tables
    starts = np.frombuffer(tables[b"co64"], ">i8", offset=8).astype(np.int64) if wide else _numbers(tables[b"stco"], 8)
    first_run, per_run, _ = _numbers(tables[b"stsc"], 8).reshape(-1, 3).T
    lengths = _repeat(per_run, np.diff(np.append(first_run - 1, len(starts))), len(starts))
    run = _repeat(np.arange(len(starts)), lengths, len(sizes))
    before = np.cumsum(sizes) - sizes
    run_begins = before[np.cumsum(lengths) - lengths]
    return starts[run] + before - run_begins[run]


def _repeat(values: NDArray[np.int64], times: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Each value so many times, `count` of them in all; a table that says otherwise could fill the memory."""
    if times.sum() != count:
        raise ValueError("a table of runs is not as long as what it is about")
    return np.repeat(values, times)


def _numbers(table: bytes, start: int, signed: bool = False) -> NDArray[np.int64]:
    return np.frombuffer(table, ">i4" if signed else ">u4", offset=start).astype(np.int64)
