"""Clip tables, read together: one row per clip of clip stores and of tables of indexed clips, checked where it enters.

Ten million rows are no trouble: a table is scanned, and only the columns that a question needs are read. The order of
rows is a property of the clips: it depends neither on the order of rows in a file nor on the order in which tables are
given, so that everything drawn from a table by row number is reproducible.
"""

import os
from collections.abc import Callable, Sequence
from functools import partial, reduce
from itertools import pairwise
from pathlib import Path

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from olt_datasets.tables.table_check import check_table_file
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_toolkit.clips.parquet_files import open_parquet
from olt_toolkit.clips.table import CLIP_TABLE, VERSION_KEY, check_table_version
from olt_toolkit.clips.table import SCHEMA as STORED_SCHEMA

_STORED = pl.DataFrame(STORED_SCHEMA.empty_table()).schema
# Checksums of files and the provenance of views stay in the store; of the latter here are the shares of pixels over all
# views of a clip: null where it is only indexed.
SHARES = ("observed_share", "invented_share")
SCHEMA = pl.Schema(
    {name: dtype for name, dtype in _STORED.items() if name not in ("views", "file_checksums")}
    | dict.fromkeys(SHARES, pl.Float64)
)
TABLE_SUFFIX = ".parquet"
_UUID = "^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$"


def scan_clip_tables(paths: Sequence[Path]) -> pl.LazyFrame:
    """The clips of all tables, by clip id: the columns of `SCHEMA` and `store`.

    `store` is the resolved path that was given: the folder of a clip store, or the file of a table of indexed clips. A
    clip that two tables hold comes once from each, in the order of their paths.

    Raises:
        InputError: a table is missing, damaged, of another version, or holds a column or value that is not known.
    """
    resolved = sorted(Path(os.path.realpath(path)) for path in paths)  # a link to itself is no file, and no loop
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


def check_table_name(path: Path) -> None:
    """InputError unless a path can be that of a table, of indexed clips or of leaks."""
    if path.suffix != TABLE_SUFFIX:
        raise InputError(f"{path}: a table is written as Parquet; give a name that ends in {TABLE_SUFFIX}")


def rewrite_rows(table: Path, out: Path, change: Callable[[pa.Table, int], pa.Table]) -> None:
    """Write a table of indexed clips, checked before, again; it appears whole and may replace the old.

    `change` gives the new rows of a row group for the old ones and the number of the first of them: as many rows of
    the same columns.
    """
    with (
        open_parquet(table, str(table)) as file,
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


def _scan_clip_table(path: Path) -> pl.LazyFrame:
    file = path if path.suffix == TABLE_SUFFIX else path / CLIP_TABLE
    if not file.is_file():
        raise InputError(
            f"{file}: no such file; give the folder of a clip store, or the {TABLE_SUFFIX} file of indexed clips"
        )
    try:
        check_table_version(pl.read_parquet_metadata(file).get(VERSION_KEY.decode()), file)
        found = pl.read_parquet_schema(file)
        for name, dtype in _STORED.items():
            if name not in found:
                raise InputError(f"{file}: column {name} is missing; build the clips again")
            if found[name] != dtype:
                raise InputError(f"{file}: column {name} is {found[name]}, not {dtype}; build the clips again")
        shares = [pl.col("views").list.eval(pl.element().struct.field(name).mean()).list.first() for name in SHARES]
        table = pl.scan_parquet(file).with_columns(
            *(each.alias(name) for each, name in zip(shares, SHARES, strict=True))
        )
        table = table.select(SCHEMA.names())
        is_sorted = check_table_file(file)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"{file}: not a readable Parquet file ({reason}); build or index the clips again") from error
    ordered = table.set_sorted("clip_id") if is_sorted else table.sort("clip_id")
    return ordered.with_columns(store=pl.lit(str(path)))
