"""Small videos with what PyAV does not write: boxes of mp4 files patched by hand (ISO/IEC 14496-12)."""

import struct
from fractions import Fraction

import av
import numpy as np

RATE = 25


def write_greys(path, count=75, b_frames=2, key_every=10, size=(48, 64), rate=RATE, **options):
    """A video whose frame k is a grey of level 20 + 3 k; without an edit list, its index at its end."""
    frames = [np.full((*size, 3), 20 + 3 * number, np.uint8) for number in range(count)]
    return write_frames(path, frames, rate, b_frames, key_every, **options)


def copy_video(source_path, path, rotation=None, metadata=None, **options):
    """The coded frames of a video in a new file, with what is said of them there."""
    with av.open(str(source_path)) as source, av.open(str(path), "w", options=options) as target:
        target.metadata.update(metadata or {})
        stream = source.streams.video[0]
        copy = target.add_stream_from_template(stream)
        if rotation is not None:
            copy.set_display_rotation(rotation)
        for packet in source.demux(stream):
            if packet.dts is not None:
                packet.stream = copy
                target.mux(packet)


def write_frames(path, frames, rate=RATE, b_frames=2, key_every=10, codec="libx264", layout="yuv420p", **options):
    with av.open(str(path), "w", options={"use_editlist": "0"} if path.suffix in (".mp4", ".mov") else {}) as container:
        stream = container.add_stream(codec, rate=rate)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt, stream.gop_size, stream.thread_count = layout, key_every, 1
        if codec == "libx264":
            options = {"crf": "10", "bf": str(b_frames), "sc_threshold": "0"} | options
        stream.options = options
        for number, image in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts, frame.time_base = number, 1 / Fraction(rate)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def grey_numbers(frames):
    """Which frames of `write_greys` these are."""
    return np.rint((frames.mean(axis=(1, 2, 3)) - 20.0) / 3.0).astype(int).tolist()


def set_matrix(path, matrix):
    """Write a display matrix ((a, b), (c, d)) into the header of the only track."""
    content = bytearray(path.read_bytes())
    start = content.index(b"tkhd") + 4
    start += 4 + (32 if content[start] == 1 else 20) + 16
    (a, b), (c, d) = matrix
    entries = [round(value * 65536) for value in (a, b)] + [0] + [round(value * 65536) for value in (c, d)]
    content[start : start + 36] = struct.pack(">9i", *entries, 0, 0, 0, 1 << 30)
    path.write_bytes(content)
    return path


def set_edits(path, edits):
    """Write an edit list: (seconds shown, first second of the media or None for nothing) in the order shown."""
    content = path.read_bytes()
    scale = struct.unpack(">I", content[(start := content.index(b"mvhd") + 16) : start + 4])[0]
    media_scale = struct.unpack(">I", content[(start := content.index(b"mdhd") + 16) : start + 4])[0]
    entries = b"".join(
        struct.pack(">iihh", round(shown * scale), -1 if first is None else round(first * media_scale), 1, 0)
        for shown, first in edits
    )
    elst = _box(b"elst", struct.pack(">II", 0, len(edits)) + entries)
    return insert_box(path, b"mdia", _box(b"edts", elst), (b"moov", b"trak"))


def insert_box(path, before, box, parents):
    """Put a box in front of the first of the name `before`, and make the boxes that hold it as much longer."""
    content = path.read_bytes()
    at = content.index(before) - 4
    assert content.rindex(b"mdat", 0, at) < content.index(b"moov"), "offsets of frames would change"
    patched = bytearray(content[:at] + box + content[at:])
    for parent in parents:
        start = content.rindex(parent, 0, at) - 4
        size = struct.unpack(">I", content[start : start + 4])[0]
        patched[start : start + 4] = struct.pack(">I", size + len(box))
    path.write_bytes(patched)
    return path


def _box(name, content):
    return struct.pack(">I", 8 + len(content)) + name + content
