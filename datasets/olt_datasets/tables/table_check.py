"""Every cell of the file of a clip table, checked in one pass before anything relies on it.

The file is read in batches, so that many rows cost no memory. Polars keeps a text that many rows share once, and how
long texts are is looked at before they are laid out: a small file cannot unpack to far more.
"""

from collections.abc import Iterator
from pathlib import Path

import polars as pl

from olt_generator.errors import InputError
from olt_toolkit.clips.clip import check_clip_id
from olt_toolkit.clips.parquet_files import open_parquet
from olt_toolkit.clips.table_values import check_rows, longest_text

_ROWS_AT_ONCE = 32_768
# Bytes of the texts in one column of as many rows.
_MOST_TEXT = 1 << 29
_UUID = "^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$"


def check_table_file(path: Path) -> bool:
    """Check every cell of a Parquet file whose columns are those of a clip table; tell if its rows are sorted by id.

    Raises:
        InputError: names the file, the column, the value and the row (from 0), see `check_rows`; or an id is there
            twice, or that of no clip.
        polars.exceptions.PolarsError, PanicException: the file is damaged.
    """
    with open_parquet(path, str(path)) as file:
        if file.metadata.num_rows > path.stat().st_size:
            raise InputError(f"{path}: claims {file.metadata.num_rows} clips, more than its bytes can tell apart")
    is_sorted, last, wrong, first = True, "", [], 0
    for rows in _read_batches(path):
        for name in rows.columns:
            _check_lengths(name, rows[name], str(path), first)
        check_rows(rows.to_arrow(compat_level=pl.CompatLevel.oldest()), str(path), first)
        ids = rows["clip_id"]
        is_sorted = is_sorted and last < ids[0] and bool((ids[1:] > ids[:-1]).all())
        wrong += ids.filter(~ids.str.contains(_UUID)).sort()[:1].to_list()
        last, first = ids[-1], first + len(rows)
    if not is_sorted:
        _check_unique(path)
    if wrong:
        check_clip_id(min(wrong), f"{path}: column clip_id")
    return is_sorted


def _read_batches(path: Path) -> Iterator[pl.DataFrame]:
    table = pl.scan_parquet(path)
    for rows in table.collect_batches(chunk_size=_ROWS_AT_ONCE, maintain_order=True, engine="streaming"):
        yield from (each.rechunk() for each in rows.iter_slices(_ROWS_AT_ONCE))


def _check_lengths(name: str, values: pl.Series, where: str, first: int) -> None:
    """Refuse texts that are too long, or too many of them, in the rows from `first` on."""
    if values.null_count() == len(values):
        return
    if isinstance(values.dtype, pl.List):
        _check_lengths(name, values.explode(), where, first)
    elif isinstance(values.dtype, pl.Struct):
        for field in values.struct.fields:
            _check_lengths(f"{name}: {field}", values.struct.field(field), where, first)
    elif values.dtype in (pl.String, pl.Binary):
        sizes = values.str.len_bytes() if values.dtype == pl.String else values.bin.size()
        most, longest = longest_text(name), sizes.arg_max()
        if longest is not None and sizes[longest] > most:
            raise InputError(
                f"{where}: column {name} has {values[longest]!r:.80}; it has at most {most} bytes (after row {first})"
            )
        if sizes.sum() > _MOST_TEXT:
            raise InputError(
                f"{where}: column {name} holds more than {_MOST_TEXT} bytes in the {_ROWS_AT_ONCE} rows after row "
                f"{first}; no table here is as large"
            )


def _check_unique(path: Path) -> None:
    clip_ids = pl.scan_parquet(path).select("clip_id").collect()["clip_id"].sort()
    repeated = clip_ids.filter(clip_ids == clip_ids.shift(1))
    if len(repeated):
        raise InputError(f"{path}: column clip_id has {repeated[0]!r} more than once; each clip needs one row")
