"""Clip tables, read together: one row per clip of clip stores and of tables of indexed clips, checked where it enters.

Ten million rows are no trouble: a table is scanned, and only the columns that a question needs are read. The order of
rows is a property of the clips: it depends neither on the order of rows in a file nor on the order in which tables are
given, so that everything drawn from a table by row number is reproducible.
"""

import hashlib
from collections.abc import Callable, Sequence
from functools import partial, reduce
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_toolkit.clips.clip import ClipKind, Split
from olt_toolkit.clips.table import CLIP_TABLE, OPTIONAL_COLUMNS, VERSION_KEY, check_table_version
from olt_toolkit.clips.table import SCHEMA as STORED_SCHEMA

# The provenance of every view stays in the store; no mixture depends on it.
SCHEMA = pl.DataFrame(STORED_SCHEMA.empty_table()).drop("views").schema
TABLE_SUFFIX = ".parquet"

# What decides which samples a mixture holds; the checksum of a table is taken over these.
DECIDING_COLUMNS = ("clip_id", "scene_id", "source", "kind", "category", "factors", "split", "sample_t0_us")


def scan_clip_tables(paths: Sequence[Path]) -> pl.LazyFrame:
    """The clips of all tables, by clip id: the columns of `SCHEMA` and `store`.

    `store` is the resolved path that was given: the folder of a clip store, or the file of a table of indexed clips. A
    clip that two tables hold comes once from each, in the order of their paths.

    Raises:
        InputError: a table is missing, damaged, of another version, or holds a column or value that is not known.
    """
    resolved = sorted(path.resolve() for path in paths)
    twice = next((first for first, second in pairwise(resolved) if first == second), None)
    if twice is not None:
        raise InputError(f"{twice} was given twice; give each store and each table once")
    if not resolved:
        raise InputError(f"no clip table was given; give a folder that holds {CLIP_TABLE}, or an indexed table")
    merge = partial(pl.LazyFrame.merge_sorted, key="clip_id", maintain_order=True)
    return reduce(merge, [_scan_clip_table(path) for path in resolved])


def read_clip_tables(paths: Sequence[Path]) -> pl.DataFrame:
    """All rows and columns of `scan_clip_tables`, in memory."""
    return scan_clip_tables(paths).collect()


def rewrite_rows(table: Path, out: Path, change: Callable[[pa.Table, int], pa.Table]) -> None:
    """Write a table of indexed clips again, changed row group by row group; it appears whole and may replace the old.

    Args:
        table: the table, checked before.
        out: the table to write.
        change: gives the new rows for old ones and the number of the first of them; the same columns, as many rows.
    """
    with (
        pq.ParquetFile(table) as file,
        write_whole(out) as temporary,
        pq.ParquetWriter(temporary, file.schema_arrow, compression="zstd") as writer,
    ):
        start = 0
        for group in range(file.num_row_groups):
            rows = file.read_row_group(group)
            writer.write_table(change(rows, start))
            start += len(rows)


def replace_column(rows: pa.Table, name: str, cells: pl.Series) -> pa.Table:
    """Rows with other cells in one column, in the column's own type."""
    place = rows.schema.get_field_index(name)
    new = cells.to_arrow(compat_level=pl.CompatLevel.oldest()).cast(rows.schema.field(place).type)
    return rows.set_column(place, rows.schema.field(place), new)


def explode_samples(table: pl.DataFrame) -> pl.DataFrame:
    """One row per sample: the columns of the table with `t0_us` (int64) in place of `sample_t0_us`.

    Clips that give no sample disappear.
    """
    has_sample = pl.col("sample_t0_us").list.len() > 0
    return table.filter(has_sample).explode("sample_t0_us").rename({"sample_t0_us": "t0_us"})


def table_checksum(table: pl.DataFrame | pl.LazyFrame) -> str:
    """BLAKE2b (16 bytes, hexadecimal) of what decides a mixture, row by row; moving a store does not change it."""
    columns = {name: _ColumnDigest() for name in DECIDING_COLUMNS}
    for batch in table.lazy().select(DECIDING_COLUMNS).collect_batches(maintain_order=True):
        for name, digest in columns.items():
            digest.update(batch[name].rechunk().to_arrow(compat_level=pl.CompatLevel.oldest()))
    return _hash_of(b"".join(digest.finish() for digest in columns.values())).hexdigest()


class _ColumnDigest:
    """The checksum of a column that comes in parts of any sizes: lengths and values are hashed apart."""

    def __init__(self) -> None:
        self._lengths = [_hash_of(b""), _hash_of(b"")]
        self._values = _hash_of(b"")

    def update(self, cells: pa.Array, depth: int = 0) -> None:
        if pa.types.is_integer(cells.type):
            self._values.update(cells.to_numpy().data)
            return
        offsets = np.frombuffer(cells.buffers()[1], np.int64)[cells.offset : cells.offset + len(cells) + 1]
        self._lengths[depth].update(np.diff(offsets).astype(np.int32).data)
        if pa.types.is_large_list(cells.type):
            self.update(cells.flatten(), depth + 1)
        else:
            self._values.update(cells.buffers()[2][offsets[0] : offsets[-1]])

    def finish(self) -> bytes:
        return b"".join(part.digest() for part in (*self._lengths, self._values))


def _hash_of(data: bytes) -> hashlib.blake2b:
    return hashlib.blake2b(data, digest_size=16)


def _scan_clip_table(path: Path) -> pl.LazyFrame:
    file = path if path.suffix == TABLE_SUFFIX else path / CLIP_TABLE
    if not file.is_file():
        raise InputError(
            f"{file}: no such file; give the folder of a clip store, or the {TABLE_SUFFIX} file of indexed clips"
        )
    try:
        check_table_version(pl.read_parquet_metadata(file).get(VERSION_KEY.decode()), file)
        found = pl.read_parquet_schema(file)
        for name, dtype in SCHEMA.items():
            if name not in found:
                raise InputError(f"{file}: column {name} is missing; build the clips again")
            if found[name] != dtype:
                raise InputError(f"{file}: column {name} is {found[name]}, not {dtype}; build the clips again")
        table = pl.scan_parquet(file).select(SCHEMA.names())
        is_sorted = _check_values(table, file)
    except (pl.exceptions.PolarsError, OSError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"{file}: not a readable Parquet file ({reason}); build or index the clips again") from error
    ordered = table.set_sorted("clip_id") if is_sorted else table.sort("clip_id")
    return ordered.with_columns(store=pl.lit(str(path)))


def _check_values(table: pl.LazyFrame, file: Path) -> bool:
    """Check every value, a few columns at a time; returns whether the rows are sorted by clip id."""
    statistics = pq.read_metadata(file)
    for name, dtype in SCHEMA.items():
        if _count_empty_cells(table, name, dtype, statistics):
            raise InputError(f"{file}: column {name} has empty cells; every clip needs a value")
    for name, allowed in (("kind", get_args(ClipKind)), ("split", get_args(Split))):
        unknown = _tell(table, pl.col(name).filter(~pl.col(name).is_in(allowed)).min())
        if unknown is not None:
            raise InputError(f"{file}: column {name} has {unknown!r}; it must be one of {', '.join(allowed)}")
    if _tell(table, (pl.col("end_us") < pl.col("start_us")).any()):
        raise InputError(f"{file}: column end_us is less than start_us; a clip ends after it starts")
    if _tell(table, (pl.col("clip_id") > pl.col("clip_id").shift(1)).all()):
        return True
    clip_ids = table.select("clip_id").collect()["clip_id"].sort()
    repeated = clip_ids.filter(clip_ids == clip_ids.shift(1))
    if len(repeated):
        raise InputError(f"{file}: column clip_id has {repeated[0]!r} more than once; each clip needs one row")
    return False


def _count_empty_cells(table: pl.LazyFrame, name: str, dtype: pl.DataType, statistics: pq.FileMetaData) -> int:
    """The number of empty cells of a column, those within lists too; cells of some columns may be empty."""
    column, may_be_empty = pl.col(name), name in OPTIONAL_COLUMNS
    if isinstance(dtype, pl.List):
        return _tell(table, column.explode(empty_as_null=False, keep_nulls=not may_be_empty).null_count())
    if may_be_empty:
        return 0
    index = statistics.schema.names.index(name)
    counted = [statistics.row_group(group).column(index).statistics for group in range(statistics.num_row_groups)]
    if all(part is not None and part.has_null_count for part in counted):
        return sum(part.null_count for part in counted)
    return _tell(table, column.null_count())


def _tell(table: pl.LazyFrame, question: pl.Expr) -> Any:
    return table.select(question).collect(engine="streaming").item()
