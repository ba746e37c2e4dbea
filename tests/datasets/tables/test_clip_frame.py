import re

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from polars.testing import assert_frame_equal

from olt_datasets.tables.clip_frame import read_clip_tables, scan_clip_tables
from olt_generator.errors import InputError


def rewrite(store, change):
    """Change the table of a store behind the back of the toolkit."""
    path = store / "clips.parquet"
    pq.write_table(change(pq.read_table(path)), path)


def with_version(version):
    return lambda table: table.replace_schema_metadata({"table_version": version})


def with_column(name, values):
    def change(table):
        index = table.schema.get_field_index(name)
        return table.set_column(index, name, values)

    return change


def test_rows_of_all_stores_with_their_folder(write_store, make_clip):
    stores = [write_store(make_clip(1), make_clip(2), name="a"), write_store(make_clip(3, factors=("x",)), name="b")]
    table = read_clip_tables(stores)
    assert table["clip_id"].str.tail(1).to_list() == ["1", "2", "3"]
    assert table["store"].to_list() == [str(stores[0])] * 2 + [str(stores[1])]
    assert table["factors"].to_list() == [[], [], ["x"]]


def test_order_depends_neither_on_files_nor_on_stores(write_store, make_clip):
    clips = [make_clip(number, samples=number) for number in range(6)]
    a, b = write_store(*clips[:3], name="a"), write_store(*clips[3:], name="b")
    before = read_clip_tables([a, b])
    write_store(*reversed(clips[:3]), name="a")
    assert_frame_equal(read_clip_tables([b, a]), before)


def test_stores_and_indexed_tables_are_read_together(write_store, make_clip, tmp_path):
    store = write_store(make_clip(2), make_clip(4), name="built")
    indexed = (write_store(make_clip(3), make_clip(1)) / "clips.parquet").rename(tmp_path / "indexed.parquet")
    table = scan_clip_tables([store, indexed]).select("clip_id", "store").collect()
    assert table["clip_id"].str.tail(1).to_list() == ["1", "2", "3", "4"]
    assert table["store"].to_list() == [str(indexed), str(store)] * 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.drop_columns(["scene_id"]), "column scene_id is missing"),
        (with_version("4"), "table_version is 4, this release reads 5; build or index the clips again"),
        (with_version("6"), "table_version is 6, this release reads 5; install a newer release"),
        (lambda table: table.replace_schema_metadata(None), "table_version is None; this is no clip table"),
        (with_column("duration_us", pa.array([1.0, 2.0])), "column duration_us is Float64, not Int64"),
        (with_column("sample_t0_us", pa.array([["1"], ["2"]])), "column sample_t0_us is List(String)"),
        (with_column("source", pa.array(["a", None])), "column source has empty cells"),
        (with_column("factors", pa.array([["a", None], []], pa.list_(pa.string()))), "column factors has empty cells"),
        (with_column("factors", pa.array([None, []], pa.list_(pa.string()))), "column factors has empty cells"),
        (with_column("kind", pa.array(["GT", "gt"])), "column kind has 'gt'; it must be one of GT, Syn, front_only"),
        (with_column("end_us", pa.array([0, -1])), "column end_us is less than start_us"),
        (with_column("action_errors", pa.array([[1.0], [None]])), "column action_errors has empty"),
        (with_column("split", pa.array(["train", "dev"])), "column split has 'dev'"),
        (with_column("clip_id", pa.array(["a", "a"])), "column clip_id has 'a' more than once"),
    ],
)
def test_damaged_table_is_refused_by_file_and_column(write_store, make_clip, change, message):
    store = write_store(make_clip(1), make_clip(2))
    rewrite(store, change)
    with pytest.raises(InputError, match=re.escape(f"{store / 'clips.parquet'}: {message}")):
        read_clip_tables([store])


def test_folders_that_are_no_stores_are_refused(tmp_path, write_store, make_clip):
    with pytest.raises(InputError, match=r"clips\.parquet: no such file"):
        read_clip_tables([tmp_path / "nothing"])
    with pytest.raises(InputError, match="no clip table was given"):
        read_clip_tables([])
    store = write_store(make_clip(1))
    with pytest.raises(InputError, match="given twice"):
        read_clip_tables([store, store / ".." / store.name])
    (store / "clips.parquet").write_bytes(b"PAR1 but no more")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        read_clip_tables([store])


def test_same_clip_in_two_stores_is_kept_apart(write_store, make_clip):
    stores = [write_store(make_clip(1), name="gt"), write_store(make_clip(1, kind="Syn"), name="syn")]
    table = read_clip_tables(stores)
    assert table.select("kind", pl.col("store").str.split("/").list.last()).rows() == [("GT", "gt"), ("Syn", "syn")]
