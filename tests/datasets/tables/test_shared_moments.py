"""Overlaps of windows across splits are counted as by comparing every pair."""

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_datasets.tables import shared_moments
from olt_datasets.tables.shared_moments import COLUMNS, find_shared_moments

CLIPS = st.lists(
    st.tuples(
        st.sampled_from("xyz"),
        st.sampled_from(["GT", "Syn"]),
        st.sampled_from(["train", "val", "test"]),
        st.integers(-5, 12),
        st.integers(0, 4),
    ),
    max_size=12,
)


def frame(clips, prefix):
    rows = [
        (f"{prefix}{number}", scene, kind, split, f"/{prefix}", start, start + length)
        for number, (scene, kind, split, start, length) in enumerate(clips)
    ]
    words = dict.fromkeys(COLUMNS[:5], pl.String)
    return pl.LazyFrame(rows, schema={**words, "start_us": pl.Int64, "end_us": pl.Int64}, orient="row")


def pair_up(mine, theirs):
    """Number of pairs by scene, kinds and splits, and the moments that any of them shares."""
    pairs = {}
    for scene, kind, split, start, length in mine:
        for other_scene, other_kind, other_split, other_start, other_length in theirs:
            first, last = max(start, other_start), min(start + length, other_start + other_length)
            if scene == other_scene and split != other_split and first <= last:
                pairs.setdefault((scene, kind, split, other_kind, other_split), []).append((first, last))
    return pairs


@given(mine=CLIPS, theirs=CLIPS, rows_at_once=st.sampled_from([1, 3, 1_000_000]))
def test_counts_are_those_of_all_pairs(mine, theirs, rows_at_once):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shared_moments, "_ROWS_AT_ONCE", rows_at_once)
        found = list(find_shared_moments(frame(mine, "a"), frame(theirs, "b")))
    expected = pair_up(mine, theirs)
    rows = [row for part in found for row in part.iter_rows(named=True)]
    rows.sort(key=lambda row: [row[name] for name in ("scene_id", "kind", "split", "kind_other", "split_other")])
    groups = [tuple(row[name] for name in ("scene_id", "kind", "split", "kind_other", "split_other")) for row in rows]
    assert groups == sorted(expected)
    for group, row in zip(groups, rows, strict=True):
        assert row["pairs"] == len(expected[group])
        assert (row["from_us"], row["to_us"]) in expected[group]
        assert (row["store"], row["store_other"]) == ("/a", "/b")
        first, second = mine[int(row["clip_id"][1:])], theirs[int(row["clip_id_other"][1:])]
        assert (first[:3], second[:3]) == (group[:3], (group[0], *group[3:]))


def test_times_may_be_large_and_splits_missing():
    late = 2**62
    clips = pl.concat([frame([("x", "GT", "train", late, 5)], "a"), frame([("x", "GT", None, late, 5)], "n")])
    others = frame([("x", "GT", "test", late + 5, 1), ("x", "GT", "test", -late, 1)], "b")
    (found,) = find_shared_moments(clips, others)
    assert found.select("clip_id", "clip_id_other", "pairs").rows() == [("a0", "b0", 1)]
