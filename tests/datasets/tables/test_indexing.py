"""Tables of indexed clips: whole, the same at any number of workers, and kept where nothing changed."""

from dataclasses import replace

import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest

import olt_datasets.tables.indexing as indexing
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_datasets.tables.cutting import Cutting
from olt_datasets.tables.fingerprints import is_telling
from olt_datasets.tables.indexing import index_dataset
from olt_datasets.tables.splits import SplitRule, Splitting, split_table
from olt_datasets.tables.window_fingerprints import choose_moments
from olt_generator.errors import InputError
from olt_toolkit.clips.fingerprint import fingerprint_images
from olt_toolkit.recordings.drives import DatasetPlace

from ..toy_drives import ToyDataset, film, make_drive


@pytest.fixture
def toy(open_toy):
    return open_toy(
        ToyDataset({"a": make_drive("a", 200), "b": make_drive("b", 90, split="test"), "c": make_drive("c", 20)})
    )


def index(place, path, workers=1, **options):
    return index_dataset(place, path, Cutting(), workers, **options)


def test_a_row_for_each_window(toy, tmp_path):
    place, _ = toy
    summary = index(place, tmp_path / "clips.parquet")
    assert (summary.source, summary.drives, summary.clips, summary.kept) == ("toy", 3, 6, 0)
    assert (summary.without_clips, summary.failed) == (["c"], {})
    table = read_clip_tables([tmp_path / "clips.parquet"])
    assert table["clip_id"].is_sorted()
    assert dict(table["recording"].value_counts().rows()) == {"a": 4, "b": 2}
    assert table.filter(recording="b")["split"].to_list() == ["test", "test"]
    assert summary.samples == table["sample_t0_us"].list.len().sum()
    assert summary.clips_with_samples == table["no_sample_reason"].null_count()


def test_unchanged_rows_keep_their_split_and_others_are_new(toy, tmp_path):
    place, dataset = toy
    path = tmp_path / "clips.parquet"
    index(place, path)
    split_table(path, Splitting(SplitRule.EXTERNAL, ("toy",)), path)
    dataset.drives["d"] = make_drive("d", 60)
    dataset.drives["b"] = replace(dataset.drives["b"], notes=("The clock was wrong.",))
    del dataset.drives["c"]
    summary = index(place, path)
    assert (summary.clips, summary.kept) == (7, 4)
    splits = read_clip_tables([path]).group_by("recording").agg(pl.col("split").unique()).sort("recording")
    assert splits.rows() == [("a", ["test"]), ("b", ["test"]), ("d", [None])]
    del dataset.drives["a"]
    assert index(place, path).clips == 3


def test_every_window_gets_a_fingerprint_of_its_own_images(toy, tmp_path):
    place, dataset = toy
    dataset.looks = {"b": None}
    summary = index(place, tmp_path / "clips.parquet")
    assert (summary.fingerprints, summary.unreadable) == (6, {})
    table = read_clip_tables([tmp_path / "clips.parquet"])
    assert is_telling(table["fingerprint"]).to_list() == (table["recording"] == "a").to_list()
    for row in table.iter_rows(named=True):
        inside = dataset.drives[row["recording"]].front_us
        inside = inside[(inside >= row["start_us"]) & (inside <= row["end_us"])]
        wanted = choose_moments((row["start_us"], row["end_us"]))
        shown = inside[np.abs(inside[:, None] - wanted).argmin(axis=0)]
        look = dataset.looks.get(row["recording"], row["recording"])
        assert row["fingerprint"] == fingerprint_images(film(look, shown), shown - row["start_us"])
    # One look at each drive.
    assert [key for key, _ in dataset.peeked] == ["a", "b"]


def test_fingerprints_are_made_once(toy, tmp_path):
    place, dataset = toy
    path = tmp_path / "clips.parquet"
    assert index(place, path, with_fingerprints=False).fingerprints == 0
    assert dataset.peeked == []
    without = read_clip_tables([path])
    assert index(place, path).fingerprints == 6
    table = read_clip_tables([path])
    assert table.drop("fingerprint").equals(without.drop("fingerprint"))
    dataset.peeked.clear()
    assert index(place, path, with_fingerprints=False).fingerprints == 6
    assert index(place, path).fingerprints == 6
    assert dataset.peeked == []
    assert read_clip_tables([path]).equals(table)
    dataset.drives["b"] = replace(dataset.drives["b"], notes=("The clock was wrong.",))
    dataset.drives["d"] = make_drive("d", 60)
    index(place, path)
    assert sorted(key for key, _ in dataset.peeked) == ["b", "d"]
    index(place, tmp_path / "at_once.parquet")
    assert read_clip_tables([path]).drop("store").equals(read_clip_tables([tmp_path / "at_once.parquet"]).drop("store"))


def test_windows_whose_images_are_damaged_have_no_fingerprint(toy, tmp_path):
    place, dataset = toy
    wanted = choose_moments((4_200_000, 8_200_000))[0]
    damaged_us = int(dataset.drives["a"].front_us[np.abs(dataset.drives["a"].front_us - wanted).argmin()])
    dataset.damaged_us = {"a": damaged_us}
    summary = index(place, tmp_path / "clips.parquet")
    table = read_clip_tables([tmp_path / "clips.parquet"]).filter(recording="a").sort("start_us")
    assert table["fingerprint"].is_null().to_list() == [False, True, False, False]
    assert summary.unreadable == {"a": f"1 of 4 clips: a: the image at {damaged_us} us is damaged"}
    assert summary.fingerprints == 5


def test_ranges_and_parts_change_no_row(toy, tmp_path, monkeypatch):
    place, _ = toy
    index(place, tmp_path / "once.parquet")
    monkeypatch.setattr(indexing, "_ROWS_AT_ONCE", 2)
    monkeypatch.setattr(indexing, "_PARTS", 1)
    index(place, tmp_path / "ranges.parquet")
    assert pq.read_table(tmp_path / "ranges.parquet").equals(pq.read_table(tmp_path / "once.parquet"))


def test_drives_that_fail_are_told_or_stop_everything(toy, tmp_path):
    place, dataset = toy
    dataset.broken = ("bad",)
    with pytest.raises(InputError, match="bad: poses are missing"):
        index(place, tmp_path / "clips.parquet")
    assert list(tmp_path.iterdir()) == []
    summary = index(place, tmp_path / "clips.parquet", keep_going=True)
    assert summary.failed == {"bad": "bad: poses are missing"}
    assert summary.clips == 6


def test_what_cannot_be_indexed_is_refused(toy, tmp_path, open_toy):
    place, _ = toy
    with pytest.raises(InputError, match=r"ends in \.parquet"):
        index(place, tmp_path / "clips.csv")
    (tmp_path / "old.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        index(place, tmp_path / "old.parquet")
    with pytest.raises(InputError, match="has no drive"):
        index(open_toy(ToyDataset({}))[0], tmp_path / "clips.parquet")


def test_a_recording_that_is_there_twice_is_listed_and_cut_once(open_toy, tmp_path, monkeypatch):
    first = make_drive("day/one", 200, scene_id="toy/same")
    drives = {"day/one": first, "copy": replace(first, key="copy"), "other": make_drive("other", 100)}
    place, _ = open_toy(ToyDataset(drives))
    summary = index(place, tmp_path / "once.parquet")
    assert (summary.drives, summary.clips, summary.copies) == (3, 6, {"day/one": "copy"})
    table = read_clip_tables([tmp_path / "once.parquet"])
    assert set(table["recording"]) == {"copy", "other"}
    assert table["clip_id"].is_unique().all()
    monkeypatch.setattr(indexing, "_ROWS_AT_ONCE", 2)
    monkeypatch.setattr(indexing, "_PARTS", 1)
    assert index(place, tmp_path / "ranges.parquet").copies == {"day/one": "copy"}
    assert pq.read_table(tmp_path / "ranges.parquet").equals(pq.read_table(tmp_path / "once.parquet"))


def test_rows_of_a_renamed_drive_stay_and_tell_its_new_place(toy, tmp_path):
    place, dataset = toy
    path = tmp_path / "clips.parquet"
    index(place, path)
    split_table(path, Splitting(SplitRule.EXTERNAL, ("toy",)), path)
    dataset.drives["z"] = replace(dataset.drives.pop("a"), key="z")
    summary = index(place, path)
    assert (summary.clips, summary.kept) == (6, 6)
    table = read_clip_tables([path])
    assert set(table["recording"]) == {"b", "z"}
    assert set(table["split"]) == {"test"}
    assert "z_000000_004000" in table["name"].to_list()


def test_two_drives_whose_keys_look_alike_are_two(open_toy, tmp_path):
    place, _ = open_toy(ToyDataset({"a/b": make_drive("a/b"), "a-b": make_drive("a-b")}))
    summary = index(place, tmp_path / "clips.parquet")
    assert (summary.clips, summary.copies) == (4, {})
    assert len(set(read_clip_tables([tmp_path / "clips.parquet"])["name"])) == 2


def test_the_number_of_workers_changes_no_byte(tmp_path, shared_real):
    place = DatasetPlace(shared_real, tmp_path, "kitti_raw")
    cutting = Cutting(frames=20, stride=10)
    for workers in (1, 2):
        index_dataset(place, tmp_path / f"{workers}.parquet", cutting, workers)
    assert (tmp_path / "1.parquet").read_bytes() == (tmp_path / "2.parquet").read_bytes()
