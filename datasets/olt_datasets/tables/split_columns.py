"""What the rules of splits look at of a clip table, as numbers: ten million clips are some 300 MB."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from olt_generator.seeds import derive_seed

NUMBERS = {"train": 0, "val": 1, "test": 2, None: 3}
"""The number of each split, and of none."""
NO_SPLIT = NUMBERS[None]

Counts = NDArray[np.int64]
Read = Callable[[Sequence[str]], Iterable[pl.DataFrame]]

_SEED_RANGE = 2.0**63
_ROWS_READ = 50_000


@dataclass(frozen=True)
class SplitColumns:
    """What rules look at, in the order of the rows.

    Attributes:
        scene: (n,) numbers of the scenes, each of which has a clip.
        source: (n,) numbers of `sources`.
        start_us, end_us, samples: (n,) as in the table, and how many samples each gives.
        split: (n,) numbers of the splits that they have, `NO_SPLIT` where none.
        sources: their names.
        place: (scenes,) a place in [0, 1) for each scene, by its id and a seed alone.
    """

    scene: NDArray[np.uint32]
    source: NDArray[np.uint16]
    start_us: Counts
    end_us: Counts
    samples: NDArray[np.int32]
    split: NDArray[np.uint8]
    sources: list[str]
    place: NDArray[np.float64]

    def take(self, rows: Counts) -> "SplitColumns":
        """Some of the clips, and their scenes."""
        present, scene = np.unique(self.scene[rows], return_inverse=True)
        return SplitColumns(
            scene.astype(np.uint32),
            self.source[rows],
            self.start_us[rows],
            self.end_us[rows],
            self.samples[rows],
            self.split[rows],
            self.sources,
            self.place[present],
        )


def read_columns(file: pq.ParquetFile, columns: Sequence[str]) -> Iterator[pl.DataFrame]:
    """Some columns of a clip table a part at a time, and `samples`, how many there are, with the sample times."""
    for rows in file.iter_batches(_ROWS_READ, columns=list(columns), use_threads=False):
        few = pl.DataFrame(pa.Table.from_batches([rows]))
        yield few.with_columns(samples=pl.col("sample_t0_us").list.len()) if "sample_t0_us" in columns else few


def gather_columns(read: Read, count: int, seed: int) -> SplitColumns:
    """Read the columns of `count` clips, twice and a part at a time: the ids of all scenes are never held together."""
    # Scenes are told by a hash of 64 bits. That two of millions have the same is less likely than a broken disk.
    hashes, start = np.empty(count, np.uint64), 0
    for rows in read(["scene_id"]):
        hashes[start : (start := start + len(rows))] = rows["scene_id"].hash()
    known = np.unique(hashes)
    del hashes
    sources: dict[str, int] = {}
    clips = SplitColumns(
        scene=np.empty(count, np.uint32),
        source=np.empty(count, np.uint16),
        start_us=np.empty(count, np.int64),
        end_us=np.empty(count, np.int64),
        samples=np.empty(count, np.int32),
        split=np.empty(count, np.uint8),
        sources=[],
        place=np.full(len(known), np.nan),
    )
    start = 0
    for rows in read(["scene_id", "source", "start_us", "end_us", "sample_t0_us", "split"]):
        these = slice(start, start := start + len(rows))
        clips.scene[these] = np.searchsorted(known, rows["scene_id"].hash().to_numpy())
        _draw_places(clips.place, clips.scene[these], rows["scene_id"], seed)
        for name in rows["source"].unique().sort():
            sources.setdefault(name, len(sources))
        clips.source[these] = rows["source"].replace_strict(sources, return_dtype=pl.UInt16)
        clips.split[these] = rows["split"].replace_strict(NUMBERS, return_dtype=pl.UInt8)
        for name in ("start_us", "end_us", "samples"):
            getattr(clips, name)[these] = rows[name]
    clips.sources.extend(sources)
    return clips


def name_splits(codes: NDArray[np.uint8]) -> pl.Series:
    """The splits (n,) of numbers, None for none."""
    return pl.Series(list(NUMBERS), dtype=pl.Enum([name for name in NUMBERS if name])).gather(codes)


def _draw_places(place: NDArray[np.float64], scenes: NDArray[np.uint32], ids: pl.Series, seed: int) -> None:
    """Give a place to the scenes that have none yet: hashes of ids are slow, and each is made once."""
    numbers, first = np.unique(scenes, return_index=True)
    new = np.isnan(place[numbers])
    for number, scene_id in zip(numbers[new], ids.gather(first[new]), strict=True):
        place[number] = derive_seed("split", seed, scene_id) / _SEED_RANGE
