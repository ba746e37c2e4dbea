"""Fake clip tables of any size, to try recipes, splits and checks on."""

from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from olt_datasets.tables.clip_frame import check_table_name
from olt_generator.files import write_whole
from olt_generator.seeds import make_generator
from olt_toolkit.clips.fingerprint import RECORD
from olt_toolkit.clips.table import SCHEMA

ROWS_AT_ONCE = 100_000
LONG_TAIL = ("cyclists", "work_zone", "uncommon_vehicle", "animal")
SAMPLE_TIMES_US = (1_700_000, 5_100_000, 8_500_000, 11_900_000)


def write_fake_table(path: Path, clips: int, with_fingerprints: bool = True) -> None:
    """A table of indexed clips in order of their ids: two kinds, four long-tail categories, four times t0 a clip.

    Fingerprints are drawn by chance, so that no clip looks like another; or there are none.
    """
    check_table_name(path)
    with write_whole(path) as temporary, pq.ParquetWriter(temporary, SCHEMA) as writer:
        for start in range(0, clips, ROWS_AT_ONCE):
            writer.write_table(_rows(start, min(ROWS_AT_ONCE, clips - start), with_fingerprints))


def _draw_fingerprints(random: np.random.Generator, count: int) -> pa.Array:
    """Fingerprints of one image each, by chance and like no other."""
    images = np.zeros(count, RECORD)
    images["signs"] = random.integers(256, size=images["signs"].shape, dtype=np.uint8)
    return pa.FixedSizeBinaryArray.from_buffers(pa.binary(RECORD.itemsize), count, [None, pa.py_buffer(images)])


def _rows(start: int, count: int, with_fingerprints: bool) -> pa.Table:
    random = make_generator("made-up clip table", start)
    number = pl.int_range(start, start + count, dtype=pl.Int64)

    def digits(length: int) -> pl.Series:
        return pl.Series(random.integers(10**length, size=count)).cast(pl.String).str.zfill(length)

    def word(*words: str) -> pl.Series:
        return pl.Series(words).gather(random.integers(len(words), size=count))

    clip_id = pl.format(
        "{}-{}-5{}-8{}-{}", number.cast(pl.String).str.zfill(8), digits(4), digits(3), digits(3), digits(12)
    )
    frame = pl.select(
        clip_id=clip_id,
        name=pl.format("drive {}", number),
        scene_id=pl.format("pav/{}", number // 4),
        source=word("pav", "pav", "pav", "waymo_e2e"),
        recording=pl.format("recording {}", number // 4),
        start_us=number % 4 * 20_000_000,
        end_us=number % 4 * 20_000_000 + 20_000_000,
        country=word("US", "DE", "JP"),
        licence=pl.lit("made up"),
        kind=word("GT", "Syn"),
        category=word(*["nominal"] * 6, *LONG_TAIL),
        factors=pl.when(number % 5 == 0).then(pl.lit(["cone_delineated"])).otherwise(pl.lit([], pl.List(pl.String))),
        split=pl.when(number // 4 % 10 == 0).then(pl.lit("test")).otherwise(pl.lit("train")),
        duration_us=pl.lit(20_000_000),
        sample_t0_us=pl.lit(list(SAMPLE_TIMES_US)),
        created_with=pl.lit("made up"),
        checksum=digits(18) + digits(14),
    )
    columns = {name: frame[name].to_arrow() for name in frame.columns}
    if with_fingerprints:
        columns["fingerprint"] = _draw_fingerprints(random, count)
    columns["views"] = pa.ListArray.from_arrays(
        np.zeros(count + 1, np.int32), pa.array([], SCHEMA.field("views").type.value_type)
    )
    arrays = [
        columns[field.name].cast(field.type) if field.name in columns else pa.nulls(count, field.type)
        for field in SCHEMA
    ]
    return pa.table(arrays, schema=SCHEMA)
