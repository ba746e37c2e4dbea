"""The clip table: one row per clip of one or more clip stores, checked where it is read.

The order of rows is a property of the clips: it depends neither on the order of rows in a file nor on the order in
which stores are given, so that everything drawn from a table by row number is reproducible.
"""

import hashlib
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import get_args

import polars as pl

from olt_generator.errors import InputError
from olt_toolkit.clip import ClipKind, Split
from olt_toolkit.clip_table import CLIP_TABLE, OPTIONAL_COLUMNS, VERSION_KEY, check_table_version
from olt_toolkit.clip_table import SCHEMA as STORED_SCHEMA

# The provenance of every view stays in the store; no mixture depends on it.
SCHEMA = pl.DataFrame(STORED_SCHEMA.empty_table()).drop("views").schema

# What decides which samples a mixture holds; the checksum of a table is taken over these.
DECIDING_COLUMNS = ("clip_id", "scene_id", "source", "kind", "category", "factors", "split", "sample_t0_us")


def read_clip_tables(stores: Sequence[Path]) -> pl.DataFrame:
    """The clips of all stores: the columns of `SCHEMA` and `store`, the resolved folder of the clip's store.

    Raises:
        InputError: a table is missing, damaged, of another version, or holds a column or value that is not known.
    """
    folders = sorted(store.resolve() for store in stores)
    twice = next((first for first, second in pairwise(folders) if first == second), None)
    if twice is not None:
        raise InputError(f"store {twice} was given twice; give each store once")
    if not folders:
        raise InputError(f"no clip store was given; give at least one folder that holds {CLIP_TABLE}")
    return pl.concat([_read_clip_table(folder) for folder in folders]).sort("clip_id", "kind", "source", "store")


def explode_samples(table: pl.DataFrame) -> pl.DataFrame:
    """One row per sample: the columns of the table with `t0_us` (int64) in place of `sample_t0_us`.

    Clips that give no sample disappear.
    """
    has_sample = pl.col("sample_t0_us").list.len() > 0
    return table.filter(has_sample).explode("sample_t0_us").rename({"sample_t0_us": "t0_us"})


def table_checksum(table: pl.DataFrame) -> str:
    """BLAKE2b (16 bytes, hexadecimal) of what decides a mixture; moving a store does not change it."""
    digest = hashlib.blake2b(digest_size=16)
    row = pl.concat_str([_as_text(name) for name in DECIDING_COLUMNS], separator="\x1f")
    for part in table.iter_slices(100_000):
        digest.update("".join(f"{text}\n" for text in part.select(row).to_series()).encode())
    return digest.hexdigest()


def _as_text(name: str) -> pl.Expr:
    column = pl.col(name)
    return column.cast(pl.List(pl.String)).list.join("\x1e") if isinstance(SCHEMA[name], pl.List) else column


def _read_clip_table(folder: Path) -> pl.DataFrame:
    path = folder / CLIP_TABLE
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the folder of a clip store, as `olt clip build` makes one")
    try:
        _check_schema(path)
        table = pl.read_parquet(path, columns=SCHEMA.names())
    except (pl.exceptions.PolarsError, OSError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"{path}: not a readable Parquet file ({reason}); build the clips again") from error
    _check_values(table, path)
    return table.with_columns(store=pl.lit(str(folder)))


def _check_schema(path: Path) -> None:
    check_table_version(pl.read_parquet_metadata(path).get(VERSION_KEY.decode()), path)
    found = pl.read_parquet_schema(path)
    for name, dtype in SCHEMA.items():
        if name not in found:
            raise InputError(f"{path}: column {name} is missing; build the clips again")
        if found[name] != dtype:
            raise InputError(f"{path}: column {name} is {found[name]}, not {dtype}; build the clips again")


def _check_values(table: pl.DataFrame, path: Path) -> None:
    for name, dtype in SCHEMA.items():
        if name not in OPTIONAL_COLUMNS and _has_empty_cells(table[name], dtype):
            raise InputError(f"{path}: column {name} has empty cells; every clip needs a value")
    _check_words(table["kind"], get_args(ClipKind), path)
    _check_words(table["split"], get_args(Split), path)
    clip_ids = table["clip_id"]
    if clip_ids.n_unique() < len(clip_ids):
        twice = clip_ids.filter(clip_ids.is_duplicated()).min()
        raise InputError(f"{path}: column clip_id has {twice!r} more than once; each clip needs one row")


def _has_empty_cells(values: pl.Series, dtype: pl.DataType) -> bool:
    cells = values.list.eval(pl.element().is_null()).list.any() if isinstance(dtype, pl.List) else values.is_null()
    return values.has_nulls() or bool(cells.any())


def _check_words(values: pl.Series, allowed: Sequence[str], path: Path) -> None:
    unknown = sorted(set(values.unique()) - set(allowed))
    if unknown:
        raise InputError(f"{path}: column {values.name} has {unknown[0]!r}; it must be one of {', '.join(allowed)}")
