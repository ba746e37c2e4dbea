import polars as pl
import pytest

from olt_datasets.leaks import find_leaks, summarize_leaks


def rules(leaks):
    return [(leak.rule, leak.scene_id) for leak in leaks]


@pytest.fixture(scope="module")
def table(make_clip, make_table):
    return make_table(
        make_clip(1, scene_id="a"),
        make_clip(2, scene_id="a", kind="Syn"),
        make_clip(3, scene_id="b"),
        make_clip(4, scene_id="b", kind="Syn", split="val"),
        make_clip(5, scene_id="c", split="test"),
        make_clip(6, scene_id="d"),
        make_clip(7, scene_id="d", split="test"),
        make_clip(8, scene_id="e"),
        make_clip(9, scene_id="e", kind="front_only", split="test"),
    )


def choose(table, *scenes, split="train"):
    return table.filter(pl.col("scene_id").is_in(scenes) & (pl.col("split") == split))


def test_twins_in_one_split_and_windows_of_one_kind_are_no_leak(table):
    assert find_leaks(choose(table, "a", "d"), table) == []


def test_clips_of_another_split(table):
    chosen = table.filter(pl.col("scene_id").is_in(["a", "c"]))
    assert rules(find_leaks(chosen, table)) == [("split", "c")]
    assert find_leaks(choose(table, "c", split="test"), table, split="test") == []


def test_held_out_scenes(table):
    leaks = find_leaks(choose(table, "a", "d"), table, held_out_scenes={"d", "elsewhere"})
    assert rules(leaks) == [("held out", "d")]


def test_twins_in_different_splits(table):
    assert rules(find_leaks(choose(table, "a", "b", "e"), table)) == [("twin", "b"), ("twin", "e")]
    assert rules(find_leaks(choose(table, "b", split="val"), table, split="val")) == [("twin", "b")]


def test_summary_counts_what_it_does_not_show(table):
    leaks = find_leaks(choose(table, "a", "b", "d", "e"), table, held_out_scenes={"a", "b", "d"})
    assert len(leaks) == 6
    assert summarize_leaks(leaks).endswith("; and 3 more")
