"""A planted leak of each kind is found, and a clean table has none."""

import re

import numpy as np
import polars as pl
import pytest

from olt_datasets.mixtures.mixture import compose_mixture
from olt_datasets.mixtures.recipe import parse_recipe
from olt_datasets.tables.leak_report import summarize_leaks
from olt_datasets.tables.leaks import find_leaks, find_table_leaks
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator
from olt_toolkit.clips.clip import ClipOrigin
from olt_toolkit.clips.fingerprint import RECORD


def rules(report):
    return [(leak.rule, leak.scene_id) for leak in report.leaks]


def seconds(start, end):
    return ClipOrigin("drive", int(1e6 * start), int(1e6 * end))


def draw_look(name):
    """A fingerprint by chance: of one name the same, of two like no other."""
    images = np.zeros(8, RECORD)
    images["time_ms"] = 2500 * np.arange(8)
    images["signs"] = make_generator("look", name).integers(256, size=images["signs"].shape, dtype=np.uint8)
    return images.tobytes()


@pytest.fixture(scope="module")
def table(make_clip, make_table):
    return make_table(
        make_clip(1, scene_id="a"),
        make_clip(2, scene_id="a", kind="Syn"),
        make_clip(3, scene_id="b"),
        make_clip(4, scene_id="b", kind="Syn", split="val"),
        make_clip(5, scene_id="c", split="test"),
        make_clip(6, scene_id="d", origin=seconds(0, 4)),
        make_clip(7, scene_id="d", origin=seconds(4.1, 8.1), split="test"),
        make_clip(8, scene_id="e"),
        make_clip(9, scene_id="e", kind="front_only", split="test"),
    )


def choose(table, *scenes, split="train"):
    return table.filter(pl.col("scene_id").is_in(scenes) & (pl.col("split") == split))


def test_twins_in_one_split_and_windows_apart_are_no_leak(table):
    assert rules(find_leaks(choose(table, "a", "d"), table)) == []
    assert rules(find_leaks(choose(table, "a", "d").lazy(), table.lazy())) == []


def test_clips_of_another_split(table, make_clip, make_table):
    chosen = table.filter(pl.col("scene_id").is_in(["a", "c"]))
    assert rules(find_leaks(chosen, table)) == [("split", "c")]
    assert rules(find_leaks(choose(table, "c", split="test"), table, split="test")) == []
    unsplit = make_table(make_clip(1, split=None))
    assert rules(find_leaks(unsplit, unsplit)) == [("split", "scene_1")]


def test_held_out_scenes(table):
    leaks = find_leaks(choose(table, "a", "d"), table, held_out_scenes={"d", "elsewhere"})
    assert rules(leaks) == [("held out", "d")]


def test_external_sources(make_clip, make_table):
    table = make_table(make_clip(1, source="nexar"), make_clip(2, source="pav"), make_clip(3, source="nexar"))
    leaks = find_leaks(table, table, external_sources=["nexar", "waymo_e2e"])
    assert rules(leaks) == [("external", "scene_1"), ("external", "scene_3")]


def test_twins_in_different_splits(table):
    assert rules(find_leaks(choose(table, "a", "b", "e"), table)) == [("twin", "b"), ("twin", "e")]
    assert rules(find_leaks(choose(table, "b", split="val"), table, split="val")) == [("twin", "b")]


@pytest.mark.parametrize(
    ("start", "end", "leaks"), [(3.9, 8, True), (4, 8, True), (4.01, 8, False), (1, 2, True), (-3, 9, True)]
)
def test_windows_that_share_a_moment_across_splits(make_clip, make_table, start, end, leaks):
    table = make_table(
        make_clip(1, scene_id="a", origin=seconds(0, 4)),
        make_clip(2, scene_id="a", origin=seconds(start, end), split="test"),
        make_clip(3, scene_id="b", origin=seconds(start, end), split="test"),
    )
    assert rules(find_leaks(table[:1], table)) == [("overlap", "a")] * leaks


@pytest.mark.parametrize(
    ("fingerprint", "leaks"), [(draw_look("street"), True), (draw_look("field"), False), (None, False), (b"", False)]
)
def test_near_duplicates_of_another_scene_in_another_split(make_clip, make_table, fingerprint, leaks):
    table = make_table(
        make_clip(1, fingerprint=draw_look("street")),
        make_clip(2, fingerprint=fingerprint, split="test"),
        make_clip(3, fingerprint=draw_look("street")),
        make_clip(4, fingerprint=None),
    )
    chosen = table.filter(pl.col("split") == "train")
    assert rules(find_leaks(chosen, table)) == [("near-duplicate", "scene_1"), ("near-duplicate", "scene_3")] * leaks


def test_a_mixture_is_refused_for_the_clips_that_look_alike_and_for_no_other(make_clip, make_table):
    """Among many: which rows a search found is asked of the table a second time."""
    clips = [make_clip(number, fingerprint=draw_look(number)) for number in range(300)]
    copies = [make_clip(300 + number, fingerprint=draw_look(number), split="val") for number in (7, 150)]
    recipe = {"name": "all", "description": "", "version": 1}
    component = {"name": "all", "where": {"kind": "GT"}, "count": 300}
    with pytest.raises(InputError) as refused:
        compose_mixture(parse_recipe({**recipe, "components": [component]}, "all"), make_table(*clips, *copies), 0)
    told = re.findall(r"scene (\S+) in split train .*? looks like clip \S+ of scene (\S+) ", str(refused.value))
    assert sorted(told) == [("scene_150", "scene_450"), ("scene_7", "scene_307")]


def test_a_whole_table_is_checked_between_all_splits(make_clip, make_table):
    clean = [
        make_clip(1, fingerprint=draw_look(1)),
        make_clip(2, fingerprint=draw_look(2), split="val"),
        make_clip(3, fingerprint=draw_look(3), split="test", source="nexar"),
        make_clip(4, scene_id="scene_1", origin=seconds(21, 30), split="test"),
        make_clip(5, split=None, scene_id="scene_1"),
    ]
    assert rules(find_table_leaks(make_table(*clean).lazy(), {"scene_3"}, {"nexar"})) == []
    planted = {
        "overlap": make_clip(6, scene_id="scene_2", split="test"),
        "twin": make_clip(7, scene_id="scene_1", kind="Syn", split="val"),
        "near-duplicate": make_clip(8, fingerprint=draw_look(1), split="val"),
        "held out": make_clip(9, scene_id="held"),
        "external": make_clip(10, source="nexar"),
    }
    for rule, clip in planted.items():
        leaks = find_table_leaks(make_table(*clean, clip).lazy(), {"held"}, {"nexar"})
        assert {leak.rule for leak in leaks.leaks} == {rule}


def test_summary_counts_what_it_does_not_show(table):
    leaks = find_leaks(choose(table, "a", "b", "d", "e"), table, held_out_scenes={"a", "b", "d"})
    assert len(leaks.leaks) == 6
    assert summarize_leaks(leaks).endswith("; and 3 more (`olt data check --leaks FILE` lists them)")


def comparison(report, rule):
    return next(each for each in report.comparisons if each.rule == rule)


def test_what_could_not_be_compared_is_counted(make_clip, make_table):
    table = make_table(
        make_clip(1, fingerprint=draw_look(1)),
        make_clip(2, fingerprint=draw_look(2)),
        make_clip(3, fingerprint=b""),
        make_clip(4, fingerprint=None),
        make_clip(5, fingerprint=draw_look(5), split="test"),
        make_clip(6, fingerprint=None, split="test"),
        make_clip(7, split=None),
    )
    report = find_table_leaks(table.lazy(), held_out_scenes=["scene_9"])
    assert (report.leaks, report.is_complete, report.empty) == ((), False, None)
    assert report.splits == {"train": 4, "test": 2, "none": 1}
    near = comparison(report, "near-duplicate")
    assert near.compared == 2 * 1
    assert list(near.not_compared.values()) == [4 * 2 - 3 * 1, 3 * 1 - 2 * 1]
    assert list(near.clips.values()) == [2, 1]
    assert comparison(report, "twin and overlap").compared == 4 * 2
    assert str(comparison(report, "held out")) == "held out: 4 clips with the 1 held-out scenes compared"
    assert str(comparison(report, "external")) == "external: none was named"
    assert report.to_dict()["clean"] is False
    of_mixture = find_leaks(table.filter(pl.col("scene_id") == "scene_1"), table)
    assert comparison(of_mixture, "near-duplicate").compared == 1
    assert comparison(of_mixture, "near-duplicate").not_compared == {"no fingerprint": 1}


@pytest.mark.parametrize(
    ("splits", "empty"),
    [
        (["train", "train"], "all clips are in split train"),
        ([None, None], "no clip is in a split"),
        (["test", None], "all clips are in split test"),
        (["val", "test"], None),
    ],
)
def test_nothing_to_compare_is_not_clean(make_clip, make_table, splits, empty):
    clips = [make_clip(number, split=split, fingerprint=draw_look(number)) for number, split in enumerate(splits)]
    report = find_table_leaks(make_table(*clips).lazy())
    assert report.empty == empty
    assert report.is_complete is report.to_dict()["clean"] is (empty is None)
    assert sum(each.compared for each in report.comparisons) == (0 if empty else 2)


def test_clips_like_those_that_are_never_trained_on(make_clip, make_table):
    """A copy of a held-out scene under another name, and of a clip from an external source, wherever these stand."""
    table = make_table(
        make_clip(1, fingerprint=draw_look("held")),
        make_clip(2, fingerprint=draw_look("outside")),
        make_clip(3, fingerprint=draw_look("held"), scene_id="held"),
        make_clip(4, fingerprint=draw_look("outside"), source="nexar", split=None),
        make_clip(5, fingerprint=draw_look("held"), split=None),
    )
    chosen = table.filter(pl.col("scene_id").is_in(["scene_1", "scene_2"]))
    report = find_leaks(chosen, table, held_out_scenes=["held"], external_sources=["nexar"])
    assert rules(report) == [("near-duplicate", "scene_1"), ("near-duplicate", "scene_2")]
    assert [leak.clips[1].scene_id for leak in report.leaks] == ["held", "scene_4"]
    assert rules(find_leaks(chosen, table)) == []


def test_both_clips_and_their_stores_are_told(make_clip, make_table):
    table = pl.concat(
        [
            make_table(make_clip(1, fingerprint=draw_look("street")), store="/gt"),
            make_table(make_clip(2, fingerprint=draw_look("street"), split="test"), store="/syn"),
            make_table(make_clip(3, scene_id="scene_1", split="test"), store="/later"),
        ]
    )
    twin, near = find_table_leaks(table.lazy()).leaks
    assert [(place.scene_id, place.split, place.store) for place in twin.clips] == [
        ("scene_1", "train", "/gt"),
        ("scene_1", "test", "/later"),
    ]
    assert [place.store for place in near.clips] == ["/gt", "/syn"]
    for word in ("scene_1", "scene_2", "/gt", "/syn", "split test"):
        assert word in str(near)
