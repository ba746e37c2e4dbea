"""What people know of clips and no data set tells: their category, scene factors and country, from a table of labels.

Labels are a CSV file with a column `scene_id` or `clip_id` and any of `category`, `factors` (separated by semicolons)
and `country` (two letters, ISO 3166). An empty cell leaves what the clip table says.
"""

import re
from pathlib import Path

import polars as pl
import pyarrow as pa

from olt_datasets.tables.clip_frame import TABLE_SUFFIX, replace_column, rewrite_rows, scan_clip_tables
from olt_generator.errors import InputError
from olt_generator.files import read_bounded

IDS = ("scene_id", "clip_id")
FIELDS = ("category", "factors", "country")
_WORD = re.compile(r"[a-z0-9]+(_[a-z0-9]+)*")
_COUNTRY = re.compile(r"[A-Z]{2}")
_SHOWN = 3
_MOST_BYTES = 1 << 30


def read_labels(path: Path) -> pl.DataFrame:
    """Read a CSV file of labels: `scene_id` or `clip_id`, each once, and those of `FIELDS` that the file has.

    Empty cells are null, `factors` are lists.

    Raises:
        InputError: the file cannot be read; names a column, row or word that is not as it should be.
    """
    try:
        table = pl.read_csv(read_bounded(path, "table of labels", _MOST_BYTES), infer_schema=False)
    except pl.exceptions.PolarsError as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"{path}: not a readable CSV file ({reason})") from error
    known = [name for name in IDS if name in table.columns]
    fields = [name for name in FIELDS if name in table.columns]
    unknown = sorted(set(table.columns) - {*IDS, *FIELDS})
    if len(known) != 1 or not fields or unknown:
        raise InputError(
            f"{path}: columns {', '.join(table.columns)}; give either {' or '.join(IDS)}, and any of "
            f"{', '.join(FIELDS)}"
        )
    ids = table[known[0]]
    if ids.null_count():
        raise InputError(f"{path}: row {int(ids.is_null().arg_true()[0]) + 1}: {ids.name} is empty")
    twice = ids.filter(ids.is_duplicated())
    if len(twice):
        raise InputError(f"{path}: {ids.name} {twice[0]!r} is there more than once; give each one row")
    if "factors" in fields:
        table = table.with_columns(pl.col("factors").str.split(";").list.eval(pl.element().str.strip_chars()))
    for name, pattern, form in (
        ("factors", _WORD, "a word in lower case, such as weak_markings"),
        ("category", _WORD, "a word in lower case, such as work_zone"),
        ("country", _COUNTRY, "two letters, such as DE"),
    ):
        if name in fields:
            words = table[name].explode() if name == "factors" else table[name]
            wrong = next((word for word in words.drop_nulls().unique().sort() if not pattern.fullmatch(word)), None)
            if wrong is not None:
                raise InputError(f"{path}: {name} {wrong!r}: write {form}")
    return table.select(known[0], *fields)


def label_table(table: Path, labels: pl.DataFrame, out: Path) -> int:
    """Write a table of indexed clips again with labels of `read_labels`; it appears whole and may replace the old one.

    Returns:
        The number of clips that labels were found for.

    Raises:
        InputError: the table cannot be read, or a label is for no clip in it.
    """
    for path in (table, out):
        if path.suffix != TABLE_SUFFIX:
            raise InputError(f"{path}: labels go into a {TABLE_SUFFIX} table of indexed clips, before clips are built")
    scan_clip_tables([table])
    (name, *fields), labelled = labels.columns, 0
    known = pl.scan_parquet(table).select(pl.col(name).unique())
    absent = labels.lazy().join(known, on=name, how="anti").select(name).collect()[name].sort()
    if len(absent):
        raise InputError(
            f"{table}: holds no clip of {name} {', '.join(absent.head(_SHOWN))}"
            f"{f' and {len(absent) - _SHOWN} more' if len(absent) > _SHOWN else ''}; remove these rows of the labels"
        )
    marked = labels.with_columns(labelled=True)

    def change(rows: pa.Table, _: int) -> pa.Table:
        nonlocal labelled
        ids = pl.DataFrame({name: pl.from_arrow(rows.column(name))})
        found = ids.join(marked, on=name, how="left", maintain_order="left")
        labelled += int(found["labelled"].sum())
        for field in fields:
            old = pl.Series(pl.from_arrow(rows.column(field)))
            rows = replace_column(rows, field, found[field].zip_with(found[field].is_not_null(), old))
        return rows

    rewrite_rows(table, out, change)
    return labelled
