"""Rules that put the clips of a table into training, validation and test, as the paper does (its split protocol).

- seen: every scene gives to all splits, its earliest windows to training and its latest to test, and windows of
  different splits never show the same moment. Measures generalization in time.
- unseen: a scene is in one split as a whole. Which one is a hash of its id and the seed, so that further scenes move
  none that are there. Measures generalization to new places.
- external: a source is never trained on; all of it is test.
- own: the split that the data set itself gave, which is what an index begins with; rows without one are refused.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from olt_datasets.tables.choices import SplitRule
from olt_datasets.tables.clip_frame import TABLE_SUFFIX, replace_column, rewrite_rows, scan_clip_tables
from olt_generator.errors import InputError
from olt_generator.seeds import derive_seed

_SEED_RANGE = 2.0**63
_SPLIT = pl.Enum(["train", "val", "test"])
_WORDS = ("scene_id", "source")
_NO_SPLIT = -1
_NEVER = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Splitting:
    """A rule and what it needs to know.

    Attributes:
        sources: the sources whose clips it is for; other clips keep their split. Empty for all.
        val, test: shares of validation and test: of the windows of each scene (seen), or of all scenes (unseen).
        gap: seconds that windows of different splits are apart at least (seen).
        seed: which scenes are held out (unseen).

    Raises:
        InputError: the shares leave nothing to train on, the gap is negative, or no external source is named.
    """

    rule: SplitRule
    sources: tuple[str, ...] = ()
    val: float = 0.0
    test: float = 0.2
    gap: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not (self.val >= 0.0 and self.test >= 0.0 and self.val + self.test < 1.0):
            raise InputError(f"shares val {self.val:g} and test {self.test:g}: give two that sum to less than 1")
        if not self.gap >= 0.0:
            raise InputError(f"a gap of {self.gap:g} s between splits: give 0 or more")
        if self.rule is SplitRule.EXTERNAL and not self.sources:
            raise InputError("rule external: name the sources that are never trained on")


def split_table(table: Path, splitting: Splitting, out: Path) -> dict[str, int]:
    """Write a table of indexed clips again with the splits of a rule; it appears whole and may replace the old one.

    Returns:
        The number of clips in each split, and under "none" of those in no split.

    Raises:
        InputError: the table cannot be read, has no clip of a named source, or the rule cannot be applied to it.
    """
    for path in (table, out):
        if path.suffix != TABLE_SUFFIX:
            raise InputError(
                f"{path}: splits are given in a {TABLE_SUFFIX} table of indexed clips; built clips keep theirs"
            )
    scan_clip_tables([table])
    # In the order of the file, not that of the clips: splits are written back row by row.
    columns = pl.scan_parquet(table).select(pl.col(_WORDS).cast(pl.Categorical), "start_us", "end_us", "split")
    splits = assign_splits(columns.collect(engine="streaming"), splitting)
    words = splits.cast(pl.String)
    rewrite_rows(table, out, lambda rows, start: replace_column(rows, "split", words.slice(start, len(rows))))
    return {name or "none": count for name, count in splits.value_counts(sort=True).rows()}


def assign_splits(clips: pl.DataFrame, splitting: Splitting) -> pl.Series:
    """The split (n,) of each clip, None for clips that are in none.

    Clips have the columns scene_id, source, start_us, end_us and split of the clip table; InputError as `split_table`.
    """
    clips = clips.with_columns(pl.col(_WORDS).cast(pl.Categorical))
    absent = sorted(set(splitting.sources) - set(clips["source"].unique().cast(pl.String)))
    if absent:
        raise InputError(f"the table has no clip of source {absent[0]!r}; change the sources that the rule is for")
    named = pl.Series(splitting.sources, dtype=pl.Categorical)
    chosen = pl.col("source").is_in(named.implode()) if splitting.sources else pl.lit(True)
    by_rule = {
        SplitRule.SEEN: _by_time,
        SplitRule.UNSEEN: _by_scene,
        SplitRule.EXTERNAL: lambda rows, _: pl.repeat("test", len(rows), dtype=_SPLIT, eager=True),
        SplitRule.OWN: _by_own,
    }[splitting.rule]
    places = clips.with_row_index("row").filter(chosen)["row"]
    splits = clips["split"].cast(_SPLIT)
    return splits.scatter(places, by_rule(clips[places], splitting)).alias("split")


def _by_time(clips: pl.DataFrame, splitting: Splitting) -> pl.Series:
    """Windows of a scene in the order of their times; those too close to a later split are in none."""
    scenes = clips["scene_id"].to_physical().to_numpy()
    order = np.lexsort((clips["start_us"].to_numpy(), scenes))
    start, end = (clips[name].to_numpy()[order] for name in ("start_us", "end_us"))
    is_first = np.diff(scenes[order], prepend=-1) != 0
    firsts, scene = np.flatnonzero(is_first), np.cumsum(is_first) - 1

    # Clips of the same start (GT and Syn of one window) have the same place in their scene.
    window = np.cumsum(is_first | (np.diff(start, prepend=start[:1]) != 0))
    place = window - window[firsts][scene]
    count = np.maximum.reduceat(place, firsts) + 1
    test_from = count - np.rint(splitting.test * count)
    val_from = test_from - np.rint(splitting.val * count)
    rank = (place >= val_from[scene]).astype(np.int8) + (place >= test_from[scene])

    # When a later split of the scene starts: each window must end before that.
    val_start, test_start = (np.minimum.reduceat(np.where(rank > each, start, _NEVER), firsts) for each in (0, 1))
    next_start = np.select([rank == 0, rank == 1], [val_start[scene], test_start[scene]], _NEVER)
    codes = np.where(end + round(1e6 * splitting.gap) >= next_start, _NO_SPLIT, rank)
    given = np.empty(len(codes), np.int8)
    given[order] = codes
    names = dict(enumerate(_SPLIT.categories))
    return pl.Series(given).replace_strict(names, default=None, return_dtype=_SPLIT)


def _by_scene(clips: pl.DataFrame, splitting: Splitting) -> pl.Series:
    scenes = clips.select(pl.col("scene_id").unique())
    ids = scenes["scene_id"].cast(pl.String)
    places = np.array([derive_seed("split", splitting.seed, scene) for scene in ids]) / _SEED_RANGE
    names = np.select([places < splitting.test, places < splitting.test + splitting.val], ["test", "val"], "train")
    by_scene = scenes.with_columns(split=pl.Series(names, dtype=_SPLIT))
    return clips.select("scene_id").join(by_scene, on="scene_id", how="left", maintain_order="left")["split"]


def _by_own(clips: pl.DataFrame, _: Splitting) -> pl.Series:
    without = sorted(clips.filter(pl.col("split").is_null())["source"].unique().cast(pl.String))
    if len(without):
        raise InputError(
            f"rule own: clips of {', '.join(without)} have no split of their own; split them by another rule"
        )
    return clips["split"].cast(_SPLIT)
