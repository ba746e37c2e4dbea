"""The clips that a data set can give, listed in a clip table; no image is decoded but a few for fingerprints.

Workers describe and cut drives, and write the rows of each part to a file of its own. Rows are then brought into the
order of their ids a range of ids at a time, so that a table of ten million rows is never held. What a table says is a
function of the data set and the cutting alone: the number of workers changes no byte of it.
"""

import math
import tempfile
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import polars as pl
import pyarrow.parquet as pq

from olt_datasets.tables.clip_frame import TABLE_SUFFIX, check_table_name, scan_clip_tables
from olt_datasets.tables.cutting import Cutting, cut_drive
from olt_datasets.tables.window_fingerprints import fingerprint_windows
from olt_generator.errors import InputError
from olt_generator.files import make_folder, write_whole
from olt_generator.omissions import Omission
from olt_generator.progress import Progress, silent
from olt_toolkit import ClipInfo, DatasetPlace
from olt_toolkit.clips.table import SCHEMA, write_clip_table
from olt_toolkit.recordings.drives import WHOLE, Dataset, list_left_out
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import Engine, map_parallel

# Enough parts to keep many workers busy, and few enough files to read together.
_PARTS = 512
_ROWS_AT_ONCE = 500_000
_ROW_GROUP = 250_000
# Columns that tell where a recording lies, and may change while a row stays what it is.
_WHERE = ("recording", "name")


@dataclass(frozen=True)
class IndexSummary:
    """What an index holds: how many drives, clips (rows), clips with samples, and samples (times of all rows).

    `kept` rows were taken from the table that was there before, with their splits: they describe the same windows.
    `fingerprints` rows tell what the clip looks like; `unreadable` tells by drive why images that this takes could not
    be decoded. `without_clips` are keys of drives that fill no window, `copies` those of recordings that are in the
    data set under a key before theirs, which is told, and whose clips are in the table once; `failed` tells why drives
    could not be described, and `left_out` what the data set passed over beside them.
    """

    source: str
    drives: int
    clips: int
    clips_with_samples: int
    samples: int
    kept: int
    fingerprints: int
    unreadable: dict[str, str] = field(default_factory=dict)
    without_clips: list[str] = field(default_factory=list)
    copies: dict[str, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    left_out: list[Omission] = field(default_factory=list)


def index_dataset(
    place: DatasetPlace,
    table: Path,
    cutting: Cutting,
    workers: int,
    on_progress: Progress = silent,
    keep_going: bool = False,
    engine: Engine = Engine.LOCAL,
    with_fingerprints: bool = True,
) -> IndexSummary:
    """Write the table of all clips that the drives of a data set can be cut into; it appears whole.

    Where the table is there already, rows that still describe the same window of the same drive are taken from it, so
    that splits which were given to them stay, also where folders were renamed, and fingerprints are not made again;
    rows of windows and drives that are gone are left out. A recording that is there twice gives its clips once.

    Args:
        on_progress: told the share of drives that are done.
        keep_going: whether a drive that cannot be described is told in the summary instead of an error.
        workers, engine: number of processes and where they run.
        with_fingerprints: whether to look at a few images of each window, so that near-duplicates can be found.

    Raises:
        InputError: the data set or one of its drives cannot be used, or a table at that path cannot be read.
    """
    check_table_name(table)
    known = table if table.is_file() else None
    if known is not None:
        scan_clip_tables([known])  # refuses a table that cannot be used before any drive is described
    keys = place.open().keys()
    if not keys:
        raise InputError(f"{place.path}: the data set has no drive; check that its files are unpacked")
    make_folder(table.parent)
    size = math.ceil(len(keys) / _PARTS)
    with tempfile.TemporaryDirectory(prefix=f".{table.stem}.", dir=table.parent) as folder:
        parts = [
            _Part(
                place,
                keys[start : start + size],
                cutting,
                keep_going,
                Path(folder) / f"{start:09d}{TABLE_SUFFIX}",
                known,
                with_fingerprints,
            )
            for start in range(0, len(keys), size)
        ]
        indexed = map_parallel(_Part.index, parts, workers, on_progress, engine)
        clips = sum(part.clips for part in indexed)
        kept, fingerprints, copies = _merge([part.file for part in parts], clips, table, known)
    times = pl.col("sample_t0_us").list.len()
    counted = pl.scan_parquet(table).select(pl.len(), (times > 0).sum().alias("give"), times.sum().alias("samples"))
    clips, clips_with_samples, sample_count = counted.collect(engine="streaming").row(0)
    return IndexSummary(
        source=place.open().source,
        drives=len(keys),
        clips=clips,
        clips_with_samples=clips_with_samples,
        samples=sample_count,
        kept=kept,
        fingerprints=fingerprints,
        unreadable={key: message for part in indexed for key, message in part.unreadable.items()},
        copies=copies,
        without_clips=[key for part in indexed for key in part.without_clips],
        failed={key: message for part in indexed for key, message in part.failed.items()},
        left_out=list(list_left_out(place.path, place.cache)) if place.source is None else [],
    )


@dataclass(frozen=True)
class _Indexed:
    """How many rows a part has, keys that fill no window, and why drives failed or their images cannot be decoded."""

    clips: int
    without_clips: list[str]
    failed: dict[str, str]
    unreadable: dict[str, str]


@dataclass(frozen=True)
class _Part:
    """Some drives of a data set, the file that their rows are written to, and the table that is known already."""

    place: DatasetPlace
    keys: list[str]
    cutting: Cutting
    keep_going: bool
    file: Path
    known: Path | None
    with_fingerprints: bool

    def index(self) -> _Indexed:
        """Write the rows of the drives."""
        use_one_thread()
        dataset = self.place.open()
        clips: dict[str, list[ClipInfo]] = {}
        failed = {}
        for key in self.keys:
            try:
                name = self.place.drive_name(key) if key == WHOLE else None
                clips[key] = cut_drive(dataset.drive(key), self.cutting, dataset.licence.name, name)
            except InputError as error:
                if not self.keep_going:
                    raise
                failed[key] = str(error)
        unreadable = self._add_fingerprints(dataset, clips) if self.with_fingerprints else {}
        rows = [row for each in clips.values() for row in each]
        write_clip_table(self.file, rows)
        return _Indexed(len(rows), [key for key, each in clips.items() if not each], failed, unreadable)

    def _add_fingerprints(self, dataset: Dataset, clips: dict[str, list[ClipInfo]]) -> dict[str, str]:
        """Give a fingerprint to all clips but those that have one in the known table; by key, why some lack it."""
        have = self._find_known([row for each in clips.values() for row in each])
        unreadable = {}
        for key, rows in clips.items():
            places = [place for place, row in enumerate(rows) if row.clip_id not in have]
            windows = [(rows[place].origin.start_us, rows[place].origin.end_us) for place in places]
            found, reasons = fingerprint_windows(dataset, key, windows)
            for place, fingerprint in zip(places, found, strict=True):
                rows[place] = replace(rows[place], fingerprint=fingerprint)
            if reasons:
                unreadable[key] = f"{sum(reasons.values())} of {len(rows)} clips: {next(iter(reasons))}"
        return unreadable

    def _find_known(self, rows: list[ClipInfo]) -> set[str]:
        if self.known is None or not rows:
            return set()
        fresh = pl.LazyFrame({"clip_id": [row.clip_id for row in rows], "checksum": [row.checksum for row in rows]})
        told = pl.scan_parquet(self.known).filter(pl.col("fingerprint").is_not_null()).select("clip_id", "checksum")
        same = told.join(fresh, on=("clip_id", "checksum"), how="semi")
        return set(same.collect(engine="streaming")["clip_id"])


def _merge(parts: list[Path], clips: int, table: Path, known: Path | None) -> tuple[int, int, dict[str, str]]:
    """Write the rows of all parts by clip id, one for each.

    Returns:
        How many rows were taken from the table that is known already, how many have a fingerprint, and the keys of
        drives whose clips another drive gives too, with the first such key: they are the same recording.
    """
    kept, fingerprints, copies, fresh = 0, 0, {}, pl.scan_parquet(parts)
    # Ids are evenly spread: these bounds divide them into ranges of about as many.
    count = math.ceil(clips / _ROWS_AT_ONCE)
    bounds = ["", *(f"{round(2**32 * part / count):08x}" for part in range(1, count)), "g"]
    with write_whole(table) as temporary, pq.ParquetWriter(temporary, SCHEMA, compression="zstd") as writer:
        for low, high in pairwise(bounds):
            in_range = pl.col("clip_id").is_between(pl.lit(low), pl.lit(high), closed="left")
            rows, found = _leave_out_copies(fresh.filter(in_range).collect())
            copies |= found
            if known is not None:
                before = pl.scan_parquet(known).filter(in_range).drop(_WHERE)
                made = rows.lazy().select("clip_id", "checksum", *_WHERE, made="fingerprint")
                same = before.join(made, on=("clip_id", "checksum"))
                same = same.with_columns(fingerprint=pl.coalesce("fingerprint", "made")).select(rows.columns).collect()
                kept += len(same)
                rows = pl.concat([rows.join(same, on="clip_id", how="anti"), same])
            rows = rows.sort("clip_id")
            stored = rows.select(SCHEMA.names).to_arrow(compat_level=pl.CompatLevel.oldest()).cast(SCHEMA)
            fingerprints += len(rows) - rows["fingerprint"].null_count()
            writer.write_table(stored, row_group_size=_ROW_GROUP)
    return kept, fingerprints, dict(sorted(copies.items()))


def _leave_out_copies(rows: pl.DataFrame) -> tuple[pl.DataFrame, dict[str, str]]:
    """Of rows with one id that with the first key, and the keys of the others with that first one."""
    if rows["clip_id"].is_unique().all():
        return rows, {}
    rows = rows.sort("clip_id", "recording")
    first = rows.unique("clip_id", keep="first", maintain_order=True)
    others = rows.filter(~pl.col("clip_id").is_first_distinct())
    pairs = others.join(first.select("clip_id", first="recording"), on="clip_id").select("recording", "first")
    return first, dict(pairs.unique().rows())
