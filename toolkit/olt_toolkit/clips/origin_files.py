"""Masks that tell where every pixel of a view comes from, as one small Parquet table a clip and camera.

A row is a frame: its `timestamp` (int64, clip time in microseconds, those of the video's table), and its pixels, row by
row from the top left, as runs of equal values: `origin` (list of uint8, a `PixelOrigin`) and `length` (list of uint32,
pixels). The metadata of the table tell `width` and `height`. Losslessly, of two views of a real drive at 576 x 320, a
frame took 5.2 and 1.5 kB and 0.6 and 0.1 ms to read (FFV1: 3.6 and 1.7 kB, 0.5 and 0.3 ms; PNG: 5.7 and 2.3 kB, 0.6 and
0.4 ms), any single frame can be read without the others, and no video codec decides about the bytes.
"""

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips.clip import shares_of
from olt_toolkit.clips.pai_tables import read_table

# Of the width and the height of a mask.
_MOST_DIGITS = 5
_SCHEMA = pa.schema([("timestamp", pa.int64()), ("origin", pa.list_(pa.uint8())), ("length", pa.list_(pa.uint32()))])


def encode_origin(timestamps_us: NDArray[np.int64], origin: NDArray[np.uint8]) -> bytes:
    """The table of masks (n, H, W) at clip times (n,); equal masks give equal bytes."""
    starts = [np.flatnonzero(np.diff(frame.ravel(), prepend=frame.flat[0] ^ 1)) for frame in origin]
    values = [frame.ravel()[start] for frame, start in zip(origin, starts, strict=True)]
    lengths = [np.diff(start, append=origin[0].size).astype(np.uint32) for start in starts]
    size = {"width": str(origin.shape[2]), "height": str(origin.shape[1])}
    columns = [
        pa.array(column, kind) for column, kind in zip((timestamps_us, values, lengths), _SCHEMA.types, strict=True)
    ]
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns, schema=_SCHEMA.with_metadata(size)), sink, compression="zstd")
    return sink.getvalue().to_pybytes()


@dataclass(frozen=True)
class OriginRuns:
    """The masks of one view, still as runs.

    Attributes:
        timestamps_us: (n,) clip times.
        width, height: pixels.
        edges: (n + 1,) where the runs of each frame begin and end in the arrays below.
        values, lengths: (m,) `PixelOrigin` and number of pixels of each run, of all frames.
    """

    timestamps_us: NDArray[np.int64]
    width: int
    height: int
    edges: NDArray[np.int64]
    values: NDArray[np.uint8]
    lengths: NDArray[np.int64]

    @property
    def shares(self) -> dict[str, float]:
        """The shares of all frames together, as `ViewProvenance` has them."""
        counts = np.bincount(self.values, self.lengths, len(PixelOrigin))
        return shares_of(counts / counts.sum())

    @property
    def seen_frames(self) -> NDArray[np.bool_]:
        """Frames (n,) of which a camera saw any pixel at any time."""
        seen = (self.values == PixelOrigin.SAME_FRAME) | (self.values == PixelOrigin.OTHER_FRAME)
        return np.logical_or.reduceat(seen, self.edges[:-1])

    def masks(self, indices: NDArray[np.int64]) -> NDArray[np.uint8]:
        """The masks (m, H, W) of frames by their number."""
        masks = np.empty((len(indices), self.height * self.width), np.uint8)
        for mask, index in zip(masks, indices.tolist(), strict=True):
            runs = slice(self.edges[index], self.edges[index + 1])
            mask[:] = np.repeat(self.values[runs], self.lengths[runs])
        return masks.reshape(-1, self.height, self.width)


def decode_origin(data: bytes, where: str) -> OriginRuns:
    """Read a table of masks; an `InputError`, which calls it `where`, if it is damaged or contradicts itself."""
    table = read_table(data, _SCHEMA.names, where)
    if any(table.schema.field(name).type != _SCHEMA.field(name).type for name in _SCHEMA.names):
        raise InputError(f"{where}: columns are {table.schema.types}, not {_SCHEMA.types}; build the clip again")
    size = [(table.schema.metadata or {}).get(key, b"").decode(errors="replace") for key in (b"width", b"height")]
    if not all(side.isdecimal() and len(side) <= _MOST_DIGITS and int(side) > 0 for side in size):
        raise InputError(f"{where}: its metadata tell no width and height; build the clip again")
    width, height = map(int, size)
    origin, length = (table.column(name).combine_chunks() for name in ("origin", "length"))
    edges = origin.offsets.to_numpy().astype(np.int64)
    runs = origin.flatten(), length.flatten()
    values, lengths = (column.fill_null(0).to_numpy() for column in runs)
    totals = np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)])
    if (
        any(column.null_count for column in (*table.columns, *runs))
        or not np.array_equal(edges, length.offsets.to_numpy())
        or len(totals) <= edges[-1]
        or np.any(np.diff(totals[edges]) != width * height)
        or values.max(initial=0) >= len(PixelOrigin)
    ):
        raise InputError(f"{where}: its runs are not those of masks of {width} x {height} pixels; build the clip again")
    return OriginRuns(table.column("timestamp").to_numpy(), width, height, edges, values, lengths.astype(np.int64))
