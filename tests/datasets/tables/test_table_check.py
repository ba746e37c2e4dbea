"""Tables with broken cells: the check of whole columns finds what a look at one row after the other finds."""

import math
import unicodedata
from dataclasses import replace
from typing import get_args

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_datasets.tables.table_check import check_table_file
from olt_generator.errors import InputError
from olt_toolkit.clips.clip import ClipKind, NoiseBasis, Split, ViewKind, ViewProvenance
from olt_toolkit.clips.table import SCHEMA, read_clip_table, write_clip_table

OPTIONAL = {"split", "doubts", "scale_sigma", "acceleration_noise", "acceleration_noise_basis", "no_sample_reason"}
OPTIONAL |= {"country", "licence", "fingerprint", "action_errors", "build_options", "file_checksums"}
WORDS = {"kind": ClipKind, "split": Split, "views: kind": ViewKind, "acceleration_noise_basis": NoiseBasis}
TEXTS = ["a", "", "x/y", "..", ".", "a\n", "\x7f", "\x85b", "é", "b" * 201, "\ud7ff", "GT", "train", "stated", "warped"]
CELLS = {
    pa.string(): TEXTS,
    pa.int64(): [-1, 0, 7, 4_000_000, 4_000_001, 2**53, 2**53 + 1, -(2**63)],
    pa.float64(): [-0.1, 0.0, 0.5, 1.0, 1.1, float("nan"), float("inf")],
    pa.binary(): [b"", b"\x00", bytes(1 << 20), bytes((1 << 20) + 1)],
}


@pytest.fixture(scope="module")
def rows(make_clip, tmp_path_factory):
    path = tmp_path_factory.mktemp("rows") / "clips.parquet"
    views = {name: ViewProvenance("warped", "e", "1", None, 0.5, 0.5, 0.2) for name in ("left", "right")}
    clips = [replace(make_clip(number, samples=2), views=views, action_errors=(0.1, 0.2)) for number in (1, 2, 3)]
    write_clip_table(path, clips)
    return pq.read_table(path).to_pylist()


def cells(kind):
    """Values of a type, seldom none."""
    if pa.types.is_list(kind):
        return st.lists(cells(kind.value_type), max_size=3)
    if pa.types.is_struct(kind):
        return st.fixed_dictionaries({field.name: cells(field.type) for field in kind})
    return st.sampled_from([*CELLS[kind], None])


@st.composite
def changes(draw):
    field = draw(st.sampled_from([field for field in SCHEMA if field.name != "clip_id"]))
    return draw(st.integers(0, 2)), field.name, draw(st.one_of(cells(field.type), st.none()))


@given(changed=st.lists(changes(), max_size=3), group=st.sampled_from([1, 3]))
def test_broken_cells_are_found_as_by_a_look_at_each(rows, tmp_path_factory, changed, group):
    broken = [dict(row) for row in rows]
    for row, name, cell in changed:
        broken[row][name] = cell
    path = tmp_path_factory.getbasetemp() / "broken.parquet"
    pq.write_table(pa.Table.from_pylist(broken, schema=SCHEMA), path, row_group_size=group)
    wrong = {name for row in broken for name in wrong_columns(row)}
    for read in (check_table_file, read_clip_table):
        if wrong:
            with pytest.raises(InputError) as refused:
                read(path)
            column = str(refused.value).partition(": column ")[2].split()[0].rstrip(":")
            assert column in wrong
        else:
            assert read(path)


def wrong_columns(row):
    """The columns of a row that hold what they may not, by a look at each cell."""
    for name, cell in row.items():
        if cell is None:
            if name not in OPTIONAL:
                yield name
        elif isinstance(cell, list):
            if any(is_wrong(name, each) for each in cell):
                yield name
        elif is_wrong(name, cell):
            yield name
    numbers = (row["start_us"], row["end_us"], row["duration_us"])
    if None not in numbers and numbers[1] < numbers[0]:
        yield "end_us"
    if None not in numbers and numbers[2] < 0:
        yield "duration_us"
    times = row["sample_t0_us"]
    known = times is not None and None not in (*times, numbers[2])
    if known and (times != sorted(set(times)) or not all(0 <= time <= numbers[2] for time in times)):
        yield "sample_t0_us"
    if times is not None and row["action_errors"] is not None and len(times) != len(row["action_errors"]):
        yield "action_errors"
    cameras = [view["camera"] for view in row["views"] or () if view is not None]
    if len(set(cameras)) < len(cameras):
        yield "views"


def is_wrong(name, value):
    if value is None:
        return True
    if isinstance(value, dict):
        shares = [value.get(f"{part}_share") for part in ("observed", "invented", "other_times")]
        if any(field != "seed" and is_wrong(f"{name}: {field}", each) for field, each in value.items()):
            return True
        observed, invented, other = shares
        if name != "views":
            return False
        above = max(*shares, observed + invented) > 1.0 + 1e-9
        return above or other > observed + 1e-9
    if isinstance(value, float):
        return not math.isfinite(value) or value < 0.0
    if isinstance(value, int):
        return name.endswith("_us") and abs(value) > 2**53
    if isinstance(value, bytes):
        return len(value) > 1 << 20
    return is_wrong_text(name, value)


def is_wrong_text(name, text):
    if name in WORDS and text not in get_args(WORDS[name]):
        return True
    if name != "build_options" and any(unicodedata.category(each) == "Cc" for each in text):
        return True
    if name in ("name", "scene_id", "source", "category") and not text:
        return True
    is_file = name != "name" or (len(text.encode()) <= 200 and text not in (".", "..") and not set(text) & set("/\\"))
    return not is_file
