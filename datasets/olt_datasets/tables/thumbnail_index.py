"""Thumbnails of the clips of a table, a block at a time, and where those with a key are found among them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.tables.thumbnail_alignment import Sequence
from olt_datasets.tables.thumbnail_keys import Effort, Keys, make_keys, measure_middle
from olt_generator.errors import InputError
from olt_toolkit.clips.fingerprint import IMAGES, RECORD, unpack_signs

# Keys of a block, held at once: 8 bytes each.
_KEYS_AT_ONCE = 1 << 25
_ROWS_AT_ONCE = 20_000
# From this many thumbnails the middle of a block is measured.
_MEASURED = 200_000

Places = NDArray[np.int64]


@dataclass(frozen=True)
class Thumbnails:
    """Thumbnails of consecutive clips of a table that have some.

    Attributes:
        records: (n,) of all clips in turn.
        clips: (c,) places of the clips in the table.
        starts: (c + 1,) where the thumbnails of each clip start, and the end.
        scenes: (c,) hashes of their scenes, 0 where unknown: a scene of its own.
    """

    records: NDArray[np.void]
    clips: Places
    starts: Places
    scenes: NDArray[np.uint64]

    def signs(self) -> NDArray[np.float32]:
        """-1 or 1 (n, cells)."""
        return unpack_signs(self.records["signs"])

    def owners(self) -> NDArray[np.int32]:
        """Which of the clips (c,) each thumbnail is of (n,)."""
        return np.repeat(np.arange(len(self.clips), dtype=np.int32), np.diff(self.starts))

    def sequence(self, clip: int) -> Sequence:
        """The thumbnails of one of the clips (c,)."""
        records = self.records[self.starts[clip] : self.starts[clip + 1]]
        return Sequence(unpack_signs(records["signs"]), records["time_ms"] / 1e3, bool(records["dim"].mean() > 0.5))


@dataclass(frozen=True)
class Index:
    """Thumbnails by their keys.

    Attributes:
        thumbnails: those of a block of clips.
        owners: which clip of the block each is of.
        keys: (tables, n) ascending, a key in the upper and the place of the thumbnail in the lower 32 bits of each.
        middle: what thumbnails of the block have in common, which keys are made without.
        effort: how much is spent on looking up.
    """

    thumbnails: Thumbnails
    owners: NDArray[np.int32]
    keys: Keys
    middle: NDArray[np.float32]
    effort: Effort


def is_telling(fingerprints: pl.Series) -> pl.Series:
    """Whether each clip can be compared at all: not one without a fingerprint, and none that shows fog or a wall."""
    return (fingerprints.bin.size() > 0).fill_null(value=False).alias("telling")


def read_thumbnails(table: pl.LazyFrame, clips: int) -> Iterator[Thumbnails]:
    """Thumbnails of a table with columns `fingerprint` and `scene_id`, at most so many clips at a time.

    Raises:
        InputError: a fingerprint is of another form.
    """
    start = 0
    for rows in table.select("fingerprint", "scene_id").collect_batches(chunk_size=_ROWS_AT_ONCE, engine="streaming"):
        telling = rows.with_row_index("clip", start).filter(is_telling(rows["fingerprint"]))
        start += len(rows)
        for part in telling.iter_slices(clips):
            yield _thumbnails(part)


def build_indexes(table: pl.LazyFrame, effort: Effort) -> Iterator[Index]:
    """Indexes of a table, a block of clips at a time."""
    most = _KEYS_AT_ONCE // (IMAGES * effort.tables)
    parts: list[Thumbnails] = []
    for part in read_thumbnails(table, most):
        if sum(len(each.clips) for each in [*parts, part]) > most:
            yield _index(parts, effort)
        parts.append(part)
    if parts:
        yield _index(parts, effort)


def _thumbnails(rows: pl.DataFrame) -> Thumbnails:
    sizes, rest = np.divmod(rows["fingerprint"].bin.size().to_numpy(), RECORD.itemsize)
    if rest.any():
        wrong = int(rest.argmax())
        raise InputError(
            f"row {rows['clip'][wrong]}: its fingerprint has {len(rows['fingerprint'][wrong])} bytes, no multiple of "
            f"{RECORD.itemsize}: it is of another form; index the data set or build the clip again"
        )
    scenes = rows.select(pl.coalesce("scene_id", pl.lit("")).hash(0))["scene_id"].to_numpy().astype(np.uint64)
    return Thumbnails(
        np.frombuffer(b"".join(rows["fingerprint"]), RECORD),
        rows["clip"].to_numpy().astype(np.int64),
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        np.where(rows["scene_id"].is_null().to_numpy(), 0, scenes),
    )


def _join(parts: list[Thumbnails]) -> Thumbnails:
    """One of several, which are taken out of the list, so that they are not held beside it for longer than needed."""
    sizes = np.concatenate([np.diff(part.starts) for part in parts])
    clips, scenes = (np.concatenate([getattr(part, name) for part in parts]) for name in ("clips", "scenes"))
    records = np.concatenate([part.records for part in parts])
    parts.clear()
    return Thumbnails(records, clips, np.concatenate([[0], np.cumsum(sizes)]), scenes)


def _index(parts: list[Thumbnails], effort: Effort) -> Index:
    block = _join(parts)
    signs = block.records["signs"]
    middle = measure_middle(unpack_signs(signs[:: -(-len(signs) // _MEASURED)]), len(block.clips))
    keys = np.empty((effort.tables, len(signs)), np.uint64)
    for start in range(0, len(signs), _ROWS_AT_ONCE):
        part = slice(start, start + _ROWS_AT_ONCE)
        keys[:, part] = make_keys(unpack_signs(signs[part]), middle, effort) << np.uint64(32)
    keys |= np.arange(keys.shape[1], dtype=np.uint64)
    keys.sort(axis=1)
    return Index(block, block.owners(), keys, middle, effort)
