"""The paper's rules for splits."""

import re

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_datasets.tables.clip_frame import read_clip_tables
from olt_datasets.tables.leaks import find_table_leaks
from olt_datasets.tables.splits import SplitRule, SplitSummary, Splitting, assign_splits, split_table
from olt_generator.errors import InputError
from olt_toolkit.clips.clip import ClipOrigin

MARGIN = 1_000_000


def rows(windows, source="a", split=None):
    """Clips of (scene, start, end) in seconds."""
    return pl.DataFrame(
        {
            "scene_id": [scene for scene, *_ in windows],
            "source": source,
            "start_us": [round(1e6 * start) for _, start, _ in windows],
            "end_us": [round(1e6 * end) for _, _, end in windows],
            "split": pl.Series([split] * len(windows), dtype=pl.String),
        }
    )


def splits(clips, rule, **options):
    return assign_splits(clips, Splitting(SplitRule(rule), **options)).to_list()


def test_seen_gives_the_latest_windows_of_each_scene_to_test():
    windows = [("x", start, start + 4) for start in (12.6, 0, 8.4, 4.2)] + [("y", 0, 4), ("z", 0, 4), ("z", 4.2, 8.2)]
    assert splits(rows(windows), "seen", test=0.25) == ["test", "train", "train", "train", "train", "train", "train"]
    assert splits(rows(windows), "seen", test=0.5)[-2:] == ["train", "test"]
    assert splits(rows(windows), "seen", val=0.25, test=0.25)[:4] == ["test", "train", "val", "train"]


def test_seen_leaves_out_what_is_too_close_to_a_later_split():
    windows = [("x", start, start + 4) for start in (0, 2, 4, 6, 8)]
    assert splits(rows(windows), "seen", test=0.2) == ["train", "train", None, None, "test"]
    assert splits(rows(windows), "seen", test=0.2, gap=3.0) == ["train", None, None, None, "test"]


@settings(max_examples=30)
@given(
    windows=st.lists(st.tuples(st.sampled_from("xyz"), st.integers(0, 60), st.integers(1, 6)), min_size=1, max_size=30),
    val=st.sampled_from([0.0, 0.2]),
    gap=st.sampled_from([0.0, 1.0]),
)
def test_seen_splits_are_apart_in_time(windows, val, gap):
    clips = rows([(scene, start, start + length) for scene, start, length in windows])
    clips = clips.with_columns(assign_splits(clips, Splitting(SplitRule.SEEN, val=val, test=0.3, gap=gap)))
    pairs = clips.join(clips, on="scene_id").filter(pl.col("split") < pl.col("split_right"))
    assert clips["split"].null_count() < len(clips)
    order = {"train": 0, "val": 1, "test": 2}
    for row in pairs.iter_rows(named=True):
        earlier, later = ("", "_right") if order[row["split"]] < order[row["split_right"]] else ("_right", "")
        assert row[f"end_us{earlier}"] + 1e6 * gap < row[f"start_us{later}"]


def test_unseen_keeps_scenes_whole_and_further_scenes_move_none():
    windows = [(f"scene {number % 500}", number, number + 1) for number in range(1000)]
    found = splits(rows(windows), "unseen", val=0.1, test=0.2)
    assert found[:500] == found[500:]
    assert 70 < found[:500].count("test") < 130
    assert 30 < found[:500].count("val") < 70
    assert splits(rows([("new", 0, 1), *windows]), "unseen", val=0.1, test=0.2)[1:] == found
    assert splits(rows(windows), "unseen", val=0.1, test=0.2, seed=1) != found


def test_rules_are_for_the_named_sources_only():
    clips = pl.concat([rows([("x", 0, 1)] * 2, source="nexar", split="train"), rows([("y", 0, 1)], split="val")])
    assert splits(clips, "external", sources=("nexar",)) == ["test", "test", "val"]
    assert splits(clips, "own") == ["train", "train", "val"]
    assert splits(clips, "unseen", sources=("a",), test=0.0) == ["train", "train", "train"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rule": "seen", "test": 1.0}, "sum to less than 1"),
        ({"rule": "seen", "val": -0.1}, "sum to less than 1"),
        ({"rule": "seen", "gap": -1.0}, "a gap of -1 s"),
        ({"rule": "external"}, "name the sources"),
        ({"rule": "external", "sources": ("waymo",)}, "no clip of source 'waymo'"),
        ({"rule": "own"}, "clips of a have no split of their own"),
    ],
)
def test_rules_that_cannot_be_applied_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        splits(rows([("x", 0, 1)]), **options)


def test_a_split_table_is_written_whole_and_has_no_leak(write_store, make_clip, tmp_path):
    clips = [
        make_clip(number, scene_id=f"s{number % 4}", origin=ClipOrigin("d", number * MARGIN, number * MARGIN + 900_000))
        for number in range(20)
    ]
    table = (write_store(*clips) / "clips.parquet").rename(tmp_path / "indexed.parquet")
    before = read_clip_tables([table])
    counts = split_table(table, Splitting(SplitRule.SEEN, test=0.4), tmp_path / "split.parquet")
    assert counts == SplitSummary({"train": 12, "test": 8}, {"train": 4, "test": 4}, {"train": 12, "test": 8})
    after = read_clip_tables([tmp_path / "split.parquet"])
    assert after.drop("split", "store").equals(before.drop("split", "store"))
    assert find_table_leaks(after.lazy()).leaks == ()
    assert split_table(table, Splitting(SplitRule.SEEN, test=0.4), table) == counts
    assert read_clip_tables([table]).drop("store").equals(after.drop("store"))


@pytest.mark.parametrize("rule", ["seen", "unseen"])
def test_parts_and_stretches_change_no_split(write_store, make_clip, tmp_path, monkeypatch, rule):
    clips = [
        make_clip(number, scene_id=f"s{number * 7 % 23}", origin=ClipOrigin("d", number * MARGIN, number * MARGIN + 9))
        for number in range(200)
    ]
    table = (write_store(*clips) / "clips.parquet").rename(tmp_path / "indexed.parquet")
    splitting = Splitting(SplitRule(rule), val=0.2, test=0.3)
    counts = split_table(table, splitting, tmp_path / "whole.parquet")
    monkeypatch.setattr("olt_datasets.tables.splits._ROWS_AT_ONCE", 13)
    monkeypatch.setattr("olt_datasets.tables.split_columns._ROWS_READ", 11)
    assert split_table(table, splitting, tmp_path / "parts.parquet") == counts
    whole, parts = (pl.read_parquet(tmp_path / f"{name}.parquet") for name in ("whole", "parts"))
    assert whole.equals(parts)


def test_splits_of_built_clips_stay(write_store, make_clip, tmp_path):
    store = write_store(make_clip(1))
    with pytest.raises(InputError, match=re.escape(f"{store}: splits are given in a .parquet table")):
        split_table(store, Splitting(SplitRule.SEEN), tmp_path / "out.parquet")


def scenes(*counts, samples=1):
    """Windows of 4 s, so many of each scene; `samples` of every window, or by window."""
    windows = [
        (f"s{scene}", 4.2 * number, 4.2 * number + 4) for scene, count in enumerate(counts) for number in range(count)
    ]
    return rows(windows).with_columns(
        samples=pl.Series([samples] * len(windows) if isinstance(samples, int) else samples)
    )


@pytest.mark.parametrize("count", range(1, 12))
@pytest.mark.parametrize(("val", "test"), [(0.0, 0.2), (0.1, 0.2), (0.05, 0.9), (0.2, 0.0), (0.0, 0.0)])
def test_few_scenes_fill_every_split_that_is_asked_for(count, val, test):
    for seed in range(5):
        found = splits(scenes(*[1] * count), "unseen", val=val, test=test, seed=seed)
        wanted = {"train"} | ({"val"} if val else set()) | ({"test"} if test else set())
        if count >= len(wanted):
            assert set(found) == wanted


def test_scenes_that_fill_a_split_are_nearest_to_its_share():
    """A scene that the shares alone put into a split stays there, so that of many scenes none is moved."""
    names = [f"s{number}" for number in range(200)]
    by_shares = dict(zip(names, splits(scenes(*[1] * 200), "unseen", val=0.1, test=0.2), strict=True))
    for start in range(0, 200, 10):
        found = splits(rows([(name, 0, 1) for name in names[start : start + 10]]), "unseen", val=0.1, test=0.2)
        before = [by_shares[name] for name in names[start : start + 10]]
        if set(before) == {"train", "val", "test"}:
            assert found == before
        moved = [(was, now) for was, now in zip(before, found, strict=True) if was != now]
        assert len(moved) <= 2


def test_unseen_fills_splits_with_scenes_that_give_samples():
    samples = [0] * 40 + [1, 1, 1]
    found = splits(scenes(*[1] * 43, samples=samples), "unseen", val=0.1, test=0.1)
    assert sorted(found[40:]) == ["test", "train", "val"]


def test_seen_asks_short_scenes_as_often_as_the_share_asks():
    found = splits(scenes(*[2] * 1000), "seen", test=0.2)
    by_scene = list(zip(found[::2], found[1::2], strict=True))
    assert set(by_scene) == {("train", "train"), ("train", "test")}
    assert 340 < by_scene.count(("train", "test")) < 460  # 40 % of the scenes, 20 % of the windows
    assert splits(scenes(3, *[2] * 999), "seen", test=0.2)[3:] == found[2:]


def test_seen_counts_windows_that_give_samples():
    """The last windows lack the future that a sample needs: they go where the last one is that has it."""
    samples = [0, 1, 1, 0, 1, 1, 0, 0]
    assert splits(scenes(8, samples=samples), "seen", test=0.25) == ["train"] * 5 + ["test"] * 3
    by_window = splits(scenes(8, samples=samples), "seen", val=0.25, test=0.25)
    assert by_window == ["train", "train", "train", "val", "val", "test", "test", "test"]


@pytest.mark.parametrize(("counts", "val", "test"), [((4,), 0.1, 0.1), ((1, 5, 1), 0.05, 0.05), ((2, 2), 0.0, 0.01)])
def test_seen_fills_every_split_if_a_scene_is_long_enough(counts, val, test):
    wanted = {"train", "test"} | ({"val"} if val else set())
    assert set(splits(scenes(*counts), "seen", val=val, test=test)) == wanted


@pytest.mark.parametrize(
    ("rule", "clips", "message"),
    [
        ("unseen", 2, r"would leave split val without a clip: .*index more drives"),
        ("unseen", 1, r"would leave split (train|test) without a clip"),
        (
            "seen",
            3,
            r"split test without a clip: it would give \{'train': 3\} clips, of \{'train': 3\} scenes",
        ),
    ],
)
def test_splits_that_would_be_empty_are_refused_with_the_counts(write_store, make_clip, tmp_path, rule, clips, message):
    store = write_store(*(make_clip(number) for number in range(clips)))
    table = (store / "clips.parquet").rename(tmp_path / "indexed.parquet")
    before = table.read_bytes()
    with pytest.raises(InputError, match=message):
        split_table(table, Splitting(SplitRule(rule), val=0.1 if clips == 2 else 0.0), table)
    assert table.read_bytes() == before


def test_a_split_without_a_sample_is_refused(write_store, make_clip, tmp_path):
    windows = [ClipOrigin("d", number * MARGIN, number * MARGIN + 900_000) for number in range(3)]
    clips = [make_clip(number, scene_id="s", origin=each, samples=number == 0) for number, each in enumerate(windows)]
    table = (write_store(*clips) / "clips.parquet").rename(tmp_path / "indexed.parquet")
    with pytest.raises(InputError, match=r"would leave split test without a clip: .* with {'train': 1} samples"):
        split_table(table, Splitting(SplitRule.SEEN, test=0.4), table)
    given = split_table(table, Splitting(SplitRule.EXTERNAL, ("world",)), table)
    assert given == SplitSummary({"test": 3}, {"test": 1}, {"test": 1})
