import re
from dataclasses import replace

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from polars.testing import assert_frame_equal

from olt_datasets.tables.clip_frame import read_clip_tables, scan_clip_tables
from olt_datasets.tables.fake_table import write_fake_table
from olt_datasets.tables.table_check import check_table_file
from olt_generator.errors import InputError
from olt_toolkit.clips.table import read_clip_table, write_clip_table


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
        (with_column("clip_id", pa.array(["a", "../b"])), "column clip_id: clip id '../b' is not a UUID"),
        (with_column("sample_t0_us", pa.array([[5], [7, -1]])), "column sample_t0_us has -1; a sample lies within"),
        (with_column("sample_t0_us", pa.array([[5], [20_000_001]])), "column sample_t0_us has 20000001; a sample lies"),
        (
            with_column("sample_t0_us", pa.array([[5], [7, 6]])),
            "column sample_t0_us has 6; the times of a clip increase",
        ),
        (
            with_column("sample_t0_us", pa.array([[5], [7, 7]])),
            "column sample_t0_us has 7; the times of a clip increase",
        ),
        (with_column("sample_t0_us", pa.array([[5], [None]], pa.list_(pa.int64()))), "column sample_t0_us has empty"),
        (with_column("duration_us", pa.array([1, -1])), "column duration_us has -1; a clip does not last less"),
        (with_column("start_us", pa.array([0, -(2**63)])), "column start_us has -9223372036854775808; times in"),
        (
            with_column("end_us", pa.array([1, 2**63 - 1])),
            "column end_us has 9223372036854775807; times in microseconds",
        ),
        (with_column("name", pa.array(["a", "b/c"])), "column name has 'b/c'; it becomes the name of a file"),
        (with_column("name", pa.array(["a", "b\\c"])), "column name has 'b\\\\c'; it becomes the name of a file"),
        (with_column("name", pa.array(["a", ".."])), "column name has '..'; it becomes the name of a file"),
        (with_column("name", pa.array(["a", ""])), "column name has ''; it is not empty"),
        (with_column("name", pa.array(["a", "ä" * 101])), f"column name has '{'ä' * 79}; it has at most 200 bytes"),
        (with_column("scene_id", pa.array(["a", "b\n"])), "column scene_id has 'b\\n'; it holds no line breaks"),
        (with_column("source", pa.array(["a", "b\x00"])), "column source has 'b\\x00'; it holds no line breaks"),
        (with_column("licence", pa.array([None, "b\x85"])), "column licence has 'b\\x85'; it holds no line breaks"),
        (
            with_column("factors", pa.array([["a"], ["b", "\x1b"]])),
            "column factors has '\\x1b'; it holds no line breaks",
        ),
        (with_column("scale_sigma", pa.array([0.1, -0.1])), "column scale_sigma has -0.1; it is finite and at least 0"),
        (with_column("scale_sigma", pa.array([None, float("inf")])), "column scale_sigma has inf; it is finite"),
        (with_column("acceleration_noise", pa.array([0.1, float("nan")])), "column acceleration_noise has nan; it is"),
        (with_column("action_errors", pa.array([[0.1], [-0.1]])), "column action_errors has -0.1; it is finite"),
        (with_column("action_errors", pa.array([[0.1], [0.1, 0.2]])), "column action_errors has 2; values must be as"),
        (
            with_column("name", pa.array(["a", b"\xff"], pa.binary()).view(pa.string())),
            "not a readable Parquet file (",
        ),
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


VIEW = {"camera": "camera_front_wide_120fov", "kind": "warped", "engine": "e", "version": "1", "seed": None}
VIEW |= {"observed_share": 0.5, "invented_share": 0.5, "other_times_share": 0.2}


@pytest.mark.parametrize(
    ("views", "message"),
    [
        ([VIEW | {"observed_share": 1.2}], "column views: observed_share has 1.2; a share is from 0 to 1 (row 1)"),
        ([VIEW | {"invented_share": -0.1}], "column views: invented_share has -0.1; it is finite and at least 0"),
        ([VIEW | {"invented_share": float("nan")}], "column views: invented_share has nan; it is finite"),
        ([VIEW | {"invented_share": 0.6}], "column views: observed_share has 1.1; with the invented above 1"),
        ([VIEW | {"other_times_share": 0.6}], "column views: other_times_share has 0.6; it is a part of"),
        ([VIEW | {"kind": "seen"}], "column views: kind has 'seen'; it must be one of observed, cropped"),
        ([VIEW | {"engine": None}], "column views: engine has empty cells"),
        ([None], "column views has empty cells within its lists"),
        ([VIEW, VIEW], "column views: camera has 'camera_front_wide_120fov'; each camera is there once (row 1)"),
    ],
)
def test_wrong_views_are_refused(write_store, make_clip, views, message):
    store = write_store(make_clip(1), make_clip(2))
    rewrite(store, lambda table: with_column("views", pa.array([[], views], table.schema.field("views").type))(table))
    for read in (read_clip_table, lambda path: scan_clip_tables([path.parent])):
        with pytest.raises(InputError, match=re.escape(f"{store / 'clips.parquet'}: {message}")):
            read(store / "clips.parquet")


def test_a_table_that_could_not_be_read_again_is_not_written(make_clip, tmp_path):
    with pytest.raises(InputError, match=r"column name has 'drive\\n'"):
        write_clip_table(tmp_path / "clips.parquet", [replace(make_clip(1), name="drive\n")])
    assert not list(tmp_path.iterdir())


def test_a_clip_that_is_there_twice_is_refused_by_stores_too(write_store, make_clip):
    store = write_store(make_clip(1), make_clip(1))
    with pytest.raises(InputError, match=r"clips\.parquet: column clip_id has '0.*1' more than once"):
        read_clip_table(store / "clips.parquet")


def test_the_row_is_told_in_any_batch(make_clip, tmp_path):
    path = tmp_path / "many.parquet"
    write_fake_table(path, 150_000)
    table = pq.read_table(path)
    durations = table["duration_us"].to_numpy().copy()
    durations[140_123] = -5
    pq.write_table(with_column("duration_us", pa.array(durations))(table), path)
    with pytest.raises(InputError, match=r"duration_us has -5; .*\(row 140123\)"):
        scan_clip_tables([path])


def test_a_table_that_unpacks_to_far_more_than_its_file_is_refused(write_store, make_clip, tmp_path):
    clip = pq.read_table(write_store(make_clip(1)) / "clips.parquet")
    rows = clip.take(np.zeros(20_000, int)).combine_chunks()
    bomb = tmp_path / "bomb.parquet"
    long = pa.DictionaryArray.from_arrays(pa.array(np.zeros(len(rows), np.int32)), ["x" * 100_000])
    place = rows.schema.get_field_index("scene_id")
    fields = rows.schema.set(place, pa.field("scene_id", long.type))
    rows = rows.set_column(place, fields.field(place), long).replace_schema_metadata(clip.schema.metadata)
    pq.write_table(rows, bomb, compression="zstd", store_schema=False)
    assert bomb.stat().st_size < 100_000
    with pytest.raises(InputError, match=r"column scene_id has 'x+; it has at most 4096 bytes|more than its bytes"):
        check_table_file(bomb)
    with pytest.raises(InputError, match="unpacks to more than"):
        read_clip_table(bomb)
