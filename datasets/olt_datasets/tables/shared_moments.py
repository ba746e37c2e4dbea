"""Clips of one scene whose windows overlap although they are in different splits.

Windows are counted and not paired, so that a scene of ten thousand windows is no more trouble than as many scenes: of
those that begin before a window ends, the ones that have ended before it begins do not overlap it. A table of ten
million rows is looked at some scenes at a time.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np
import polars as pl
from numpy.typing import NDArray

COLUMNS = ("clip_id", "scene_id", "kind", "split", "store", "start_us", "end_us")
_ROWS_AT_ONCE = 1_000_000
_GROUP = ("scene_id", "kind", "split", "kind_other", "split_other")

Numbers = NDArray[np.int64]


def find_shared_moments(clips: pl.LazyFrame, others: pl.LazyFrame) -> Iterator[pl.DataFrame]:
    """Where clips and others of the same scene and of different splits show the same moments, some scenes at a time.

    Both have the columns `COLUMNS`.

    Yields:
        A row for each scene, pair of kinds and pair of splits: those columns (`_other` after those of the other clip),
        `pairs`, the number of pairs of clips, and of the first pair `clip_id`, `store` and `from_us` to `to_us`, the
        moments that both show.
    """
    rows = sum(frame.select(pl.len()).collect(engine="streaming").item() for frame in (clips, others))
    parts = -(-rows // _ROWS_AT_ONCE)
    for part in range(parts):
        in_part = pl.col("scene_id").hash() % parts == part
        mine = clips.filter(in_part).select(COLUMNS).collect(engine="streaming")
        scenes = mine.lazy().select("scene_id").unique()
        theirs = others.filter(in_part).select(COLUMNS).join(scenes, on="scene_id", how="semi")
        yield from _compare_kinds(mine, theirs.collect(engine="streaming"))


def _compare_kinds(mine: pl.DataFrame, theirs: pl.DataFrame) -> Iterator[pl.DataFrame]:
    """The rows for some scenes, one frame for each kind and split of the others."""
    for kind, split in product(theirs["kind"].unique().sort(), theirs["split"].unique().sort()):
        first = mine.filter(pl.col("split") != split)
        second = theirs.filter((pl.col("kind") == kind) & (pl.col("split") == split))
        yield _compare(first, second).with_columns(scene_id_other="scene_id")


def _compare(mine: pl.DataFrame, theirs: pl.DataFrame) -> pl.DataFrame:
    (start, end), (other_start, other_end) = _number_moments(mine, theirs)
    begun = np.searchsorted(np.sort(other_start), end, side="right")
    ended = np.searchsorted(np.sort(other_end), start, side="left")
    # Scenes are numbered on, so what lies in earlier scenes is counted in both.
    overlapping = mine.with_columns(pairs=pl.Series(begun - ended, dtype=pl.Int64)).filter(pl.col("pairs") > 0)
    groups = overlapping.group_by("scene_id", "kind", "split").agg(
        pl.col("pairs").sum(), pl.col("clip_id", "store", "start_us", "end_us").sort_by("start_us", "clip_id").first()
    )
    # One clip of each group, so few pairs.
    pairs = groups.join(theirs, on="scene_id", suffix="_other").filter(
        (pl.col("start_us") <= pl.col("end_us_other")) & (pl.col("start_us_other") <= pl.col("end_us"))
    )
    return (
        pairs.sort("start_us_other", "clip_id_other")
        .unique(_GROUP, keep="first", maintain_order=True)
        .with_columns(
            pl.max_horizontal("start_us", "start_us_other").alias("from_us"),
            pl.min_horizontal("end_us", "end_us_other").alias("to_us"),
        )
        .drop("start_us", "end_us", "start_us_other", "end_us_other")
    )


def _number_moments(*frames: pl.DataFrame) -> list[tuple[Numbers, Numbers]]:
    """Starts and ends (n,) of each frame as whole numbers that tell scenes apart, and keep the order within each."""
    scenes = pl.concat([frame["scene_id"] for frame in frames]).rank("dense").cast(pl.Int64).to_numpy()
    times = pl.concat([frame[name] for frame in frames for name in ("start_us", "end_us")])
    ranks = times.rank("dense").cast(pl.Int64).to_numpy()
    step = int(ranks.max(initial=0)) + 1
    numbered, place, time_place = [], 0, 0
    for frame in frames:
        count = len(frame)
        scene = scenes[place : place + count] * step
        start, end = np.split(ranks[time_place : time_place + 2 * count], 2)
        numbered.append((scene + start, scene + end))
        place, time_place = place + count, time_place + 2 * count
    return numbered
