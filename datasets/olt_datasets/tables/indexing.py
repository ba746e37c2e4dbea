"""The clips that a data set can give, listed in a clip table without decoding an image.

Workers describe and cut drives, and write the rows of each part to a file of its own. Rows are then brought into the
order of their ids a range of ids at a time, so that a table of ten million rows is never held. What a table says is a
function of the data set and the cutting alone: the number of workers changes no byte of it.
"""

import math
import tempfile
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import polars as pl
import pyarrow.parquet as pq

from olt_datasets.tables.clip_frame import TABLE_SUFFIX, check_table_name, scan_clip_tables
from olt_datasets.tables.cutting import Cutting, cut_drive
from olt_generator.errors import InputError
from olt_generator.files import make_folder, write_whole
from olt_generator.omissions import Omission
from olt_generator.progress import Progress, silent
from olt_toolkit import ClipInfo, DatasetPlace
from olt_toolkit.clips.table import SCHEMA, write_clip_table
from olt_toolkit.recordings.drives import WHOLE, list_left_out
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
    `without_clips` are keys of drives that fill no window, `copies` those of recordings that are in the data set under
    a key before theirs, which is told, and whose clips are in the table once; `failed` tells why drives could not be
    described, and `left_out` what the data set passed over beside them.
    """

    source: str
    drives: int
    clips: int
    clips_with_samples: int
    samples: int
    kept: int
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
) -> IndexSummary:
    """Write the table of all clips that the drives of a data set can be cut into; it appears whole.

    Where the table is there already, rows that still describe the same window of the same drive are taken from it, so
    that splits which were given to them stay, also where folders were renamed; rows of windows and drives that are gone
    are left out. A recording that is there twice gives its clips once.

    Args:
        on_progress: told the share of drives that are done.
        keep_going: whether a drive that cannot be described is told in the summary instead of an error.
        workers, engine: number of processes and where they run.

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
            (place, keys[start : start + size], cutting, keep_going, Path(folder) / f"{start:09d}{TABLE_SUFFIX}")
            for start in range(0, len(keys), size)
        ]
        counts, without_clips, failed = zip(
            *map_parallel(_index_part, parts, workers, on_progress, engine), strict=True
        )
        kept, copies = _merge([file for *_, file in parts], sum(counts), table, known)
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
        copies=copies,
        without_clips=[key for each in without_clips for key in each],
        failed={key: message for each in failed for key, message in each.items()},
        left_out=list(list_left_out(place.path, place.cache)) if place.source is None else [],
    )


def _index_part(part: tuple[DatasetPlace, list[str], Cutting, bool, Path]) -> tuple[int, list[str], dict[str, str]]:
    """Write the rows of some drives to a file; the number of rows, keys that fill no window, and why others failed."""
    place, keys, cutting, keep_going, file = part
    use_one_thread()
    dataset = place.open()
    rows: list[ClipInfo] = []
    without_clips, failed = [], {}
    for key in keys:
        try:
            name = place.drive_name(key) if key == WHOLE else None
            clips = cut_drive(dataset.drive(key), cutting, dataset.licence.name, name)
        except InputError as error:
            if not keep_going:
                raise
            failed[key] = str(error)
            continue
        rows += clips
        if not clips:
            without_clips.append(key)
    write_clip_table(file, rows)
    return len(rows), without_clips, failed


def _merge(parts: list[Path], clips: int, table: Path, known: Path | None) -> tuple[int, dict[str, str]]:
    """Write the rows of all parts by clip id, one for each.

    Returns:
        How many rows were taken from the table that is known already, and the keys of drives whose clips another drive
        gives too, with the first such key: they are the same recording.
    """
    kept, copies, fresh = 0, {}, pl.scan_parquet(parts)
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
                same = before.join(rows.lazy().select("clip_id", "checksum", *_WHERE), on=("clip_id", "checksum"))
                same = same.select(rows.columns).collect()
                kept += len(same)
                rows = pl.concat([rows.join(same, on="clip_id", how="anti"), same])
            rows = rows.sort("clip_id")
            stored = rows.select(SCHEMA.names).to_arrow(compat_level=pl.CompatLevel.oldest()).cast(SCHEMA)
            writer.write_table(stored, row_group_size=_ROW_GROUP)
    return kept, dict(sorted(copies.items()))


def _leave_out_copies(rows: pl.DataFrame) -> tuple[pl.DataFrame, dict[str, str]]:
    """Of rows with one id that with the first key, and the keys of the others with that first one."""
    if rows["clip_id"].is_unique().all():
        return rows, {}
    rows = rows.sort("clip_id", "recording")
    first = rows.unique("clip_id", keep="first", maintain_order=True)
    others = rows.filter(~pl.col("clip_id").is_first_distinct())
    pairs = others.join(first.select("clip_id", first="recording"), on="clip_id").select("recording", "first")
    return first, dict(pairs.unique().rows())
