"""Videos written again with a fault: frames missing, too small, frozen, or beginning late."""

import io
import tempfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from olt_generator.video import write_video

_RATE = 10.0
_LATE, _FROZEN = 5, 5  # frames


def cut_frames(data: bytes) -> bytes:
    """Without the last three frames."""
    return _written(_frames(data)[:-3])


def shrink_frames(data: bytes) -> bytes:
    """At half the size."""
    return _written(_frames(data)[:, ::2, ::2])


def freeze_frames(data: bytes) -> bytes:
    """With one frame in place of the five after it, where images change most."""
    frames = _frames(data)
    change = np.abs(np.diff(frames.astype(np.int16), axis=0)).mean(axis=(1, 2, 3))
    first = int(np.argmax(np.convolve(change, np.ones(_FROZEN), "valid")))
    frames[first : first + _FROZEN + 1] = frames[first]
    return _written(frames)


def change_frames(data: bytes, change: Callable[[NDArray[np.uint8]], NDArray[np.uint8]]) -> bytes:
    """With frames (n, H, W, 3) that `change` makes of its own."""
    return _written(change(_frames(data)))


def shift_start(data: bytes) -> bytes:
    """With container times that begin five frames late."""
    source, target = io.BytesIO(data), io.BytesIO()
    with av.open(source, "r") as reading, av.open(target, "w", format="mp4") as writing:
        stream = writing.add_stream_from_template(reading.streams.video[0])
        for packet in reading.demux(reading.streams.video[0]):
            if packet.pts is None or packet.dts is None or packet.time_base is None:
                continue
            late = int(_LATE / Fraction(_RATE) / packet.time_base)
            packet.pts, packet.dts = packet.pts + late, packet.dts + late
            packet.stream = stream
            writing.mux(packet)
    return target.getvalue()


def _frames(data: bytes) -> NDArray[np.uint8]:
    with av.open(io.BytesIO(data), "r") as container:
        return np.stack([np.asarray(frame.to_ndarray(format="rgb24"), np.uint8) for frame in container.decode(video=0)])


def _written(frames: NDArray[np.uint8]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        write_video(path, np.ascontiguousarray(frames), _RATE)
        return path.read_bytes()
