"""Rules that put the clips of a table into training, validation and test, as the paper does (its split protocol).

- seen: every scene gives its earliest windows to training and its latest to test, and windows of different splits never
  show the same moment. Shares are of the windows that give samples; those between them go with the next. A scene that
  is too short for its share of a split gives it a window as often as the share asks, by a hash of its id. Measures
  generalization in time.
- unseen: a scene is in one split as a whole. Which one is a hash of its id and the seed, so that further scenes move
  none that are there. Where so few scenes would leave a split empty, it gets the one whose hash is nearest to its
  share. Measures generalization to new places.
- external: a source is never trained on; all of it is test.
- own: the split that the data set itself gave, which is what an index begins with; rows without one are refused.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.tables.choices import SplitRule
from olt_datasets.tables.clip_frame import TABLE_SUFFIX, replace_column, rewrite_rows, scan_clip_tables
from olt_generator.errors import InputError
from olt_generator.seeds import derive_seed

_SEED_RANGE = 2.0**63
_SPLIT = pl.Enum(["train", "val", "test"])
_WORDS = ("scene_id", "source")
_NO_SPLIT = -1
_NEVER = np.iinfo(np.int64).max

Counts = NDArray[np.int64]


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


@dataclass(frozen=True)
class SplitSummary:
    """Number of clips, of their scenes and of their samples in each split, and under "none" of those in no split."""

    clips: dict[str, int]
    scenes: dict[str, int]
    samples: dict[str, int]


def split_table(table: Path, splitting: Splitting, out: Path) -> SplitSummary:
    """Write a table of indexed clips again with the splits of a rule; it appears whole and may replace the old one.

    Raises:
        InputError: the table cannot be read, has no clip of a named source, or the rule cannot be applied to it, also
            because a split that was asked for would have no clip, or no sample while others have some.
    """
    for path in (table, out):
        if path.suffix != TABLE_SUFFIX:
            raise InputError(
                f"{path}: splits are given in a {TABLE_SUFFIX} table of indexed clips; built clips keep theirs"
            )
    scan_clip_tables([table])
    # In the order of the file, not that of the clips: splits are written back row by row.
    samples = pl.col("sample_t0_us").list.len().alias("samples")
    columns = pl.scan_parquet(table).select(pl.col(_WORDS).cast(pl.Categorical), "start_us", "end_us", "split", samples)
    clips = columns.collect(engine="streaming")
    clips = clips.with_columns(assign_splits(clips, splitting))
    of_rule = clips.filter(pl.col("source").cast(pl.String).is_in(splitting.sources)) if splitting.sources else clips
    _check_filled(_count(of_rule), splitting, table)
    words = clips["split"].cast(pl.String)
    rewrite_rows(table, out, lambda rows, start: replace_column(rows, "split", words.slice(start, len(rows))))
    return _count(clips)


def _count(clips: pl.DataFrame) -> SplitSummary:
    counted = clips.group_by("split").agg(pl.len(), pl.col("scene_id").n_unique(), pl.col("samples").sum())
    by_name = {name or "none": rest for name, *rest in counted.rows()}
    found = {name: by_name[name] for name in (*_SPLIT.categories, "none") if name in by_name}
    return SplitSummary(*({name: int(row[place]) for name, row in found.items()} for place in range(3)))


def _check_filled(counts: SplitSummary, splitting: Splitting, table: Path) -> None:
    """Refuse splits by shares of which one that was asked for holds nothing."""
    if splitting.rule not in (SplitRule.SEEN, SplitRule.UNSEEN):
        return
    asked = {"train": 1.0 - splitting.val - splitting.test, "val": splitting.val, "test": splitting.test}
    for name in (name for name, share in asked.items() if share > 0.0):
        lacks = "sample" if counts.clips.get(name) else "clip"
        if counts.samples.get(name) or (lacks == "sample" and not sum(counts.samples.values())):
            continue
        if splitting.rule is SplitRule.UNSEEN:
            advice = "index more drives, give that split no share, or split by rule seen"
        else:
            advice = "cut shorter windows, ask for a larger share or a smaller gap, or split by rule unseen"
        raise InputError(
            f"{table}: rule {splitting.rule} would leave split {name} without a {lacks}: it would give {counts.clips} "
            f"clips, of {counts.scenes} scenes, with {counts.samples} samples; {advice}"
        )


def assign_splits(clips: pl.DataFrame, splitting: Splitting) -> pl.Series:
    """The split (n,) of each clip, None for clips that are in none.

    Clips have the columns scene_id, source, start_us, end_us and split of the clip table, and `samples`, how many each
    gives, unless all give some. No split is refused for being empty; otherwise InputError as `split_table`.
    """
    clips = clips.with_columns(pl.col(_WORDS).cast(pl.Categorical))
    if "samples" not in clips.columns:
        clips = clips.with_columns(samples=pl.lit(1))
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
    starts_window = is_first | (np.diff(start, prepend=start[:1]) != 0)
    window, first_of_window = np.cumsum(starts_window) - 1, np.flatnonzero(starts_window)
    scene_of_window = scene[first_of_window]
    gives = np.maximum.reduceat(clips["samples"].to_numpy()[order] > 0, first_of_window)
    counts = gives | (np.bincount(scene_of_window, gives) == 0)[scene_of_window]
    count = np.bincount(scene_of_window, counts).astype(np.int64)
    before = np.cumsum(counts) - counts
    place = before - before[window[firsts]][scene_of_window]
    place = np.minimum(place, count[scene_of_window] - 1)[window]
    held, test = _share_windows(count, clips["scene_id"].cast(pl.String).gather(order[firsts]), splitting)
    rank = (place >= (count - held)[scene]).astype(np.int8) + (place >= (count - test)[scene])

    # When a later split of the scene starts: each window must end before that.
    val_start, test_start = (np.minimum.reduceat(np.where(rank > each, start, _NEVER), firsts) for each in (0, 1))
    next_start = np.select([rank == 0, rank == 1], [val_start[scene], test_start[scene]], _NEVER)
    codes = np.where(end + round(1e6 * splitting.gap) >= next_start, _NO_SPLIT, rank)
    given = np.empty(len(codes), np.int8)
    given[order] = codes
    names = dict(enumerate(_SPLIT.categories))
    return pl.Series(given).replace_strict(names, default=None, return_dtype=_SPLIT)


def _share_windows(count: Counts, scenes: pl.Series, splitting: Splitting) -> tuple[Counts, Counts]:
    """How many of the windows (n,) of each scene are in validation and test, and in test; the first is in training."""
    chance = _draw_places(scenes, 0)
    shares = splitting.val + splitting.test, splitting.test
    held, test = (np.floor(share * count) + (chance < share * count % 1.0) for share in shares)
    held = np.minimum(held, count - 1).astype(np.int64)
    test = np.minimum(test, held).astype(np.int64)
    # Of few scenes none may give to a split: then the longest does, if it can.
    longest = int(np.argmax(count))
    if splitting.test > 0.0 and not test.any():
        test[longest] = min(1, count[longest] - 1)
    if splitting.val > 0.0 and not (held > test).any():
        held[longest] = test[longest] + 1
    held[longest] = np.clip(held[longest], test[longest], count[longest] - 1)
    return held, test


def _by_scene(clips: pl.DataFrame, splitting: Splitting) -> pl.Series:
    scenes = clips.group_by("scene_id").agg(pl.col("samples").sum())
    places = _draw_places(scenes["scene_id"].cast(pl.String), splitting.seed)
    names = np.select([places < splitting.test, places < splitting.test + splitting.val], ["test", "val"], "train")
    # Scenes that give samples fill all splits, even where they are few.
    gives = scenes["samples"].to_numpy() > 0
    among = np.flatnonzero(gives | ~gives.any())
    names[among] = _fill_splits(places[among], splitting)
    by_scene = scenes.select("scene_id", split=pl.Series(names, dtype=_SPLIT))
    return clips.select("scene_id").join(by_scene, on="scene_id", how="left", maintain_order="left")["split"]


def _fill_splits(places: NDArray[np.float64], splitting: Splitting) -> NDArray[np.str_]:
    """The split (n,) of scenes at places (n,) in [0, 1): by their shares, and one at least if scenes are enough."""
    least_test, least_val = int(splitting.test > 0.0), int(splitting.val > 0.0)
    test, held = (int((places < share).sum()) for share in (splitting.test, splitting.test + splitting.val))
    if len(places) > least_test + least_val:
        test = int(np.clip(test, least_test, len(places) - 1 - least_val))
        held = int(np.clip(held, test + least_val, len(places) - 1))
    rank = np.argsort(np.argsort(places))
    return np.select([rank < test, rank < held], ["test", "val"], "train")


def _draw_places(scenes: pl.Series, seed: int) -> NDArray[np.float64]:
    """A place (n,) in [0, 1) for each scene, by its id and the seed alone."""
    return np.array([derive_seed("split", seed, scene) for scene in scenes]) / _SEED_RANGE


def _by_own(clips: pl.DataFrame, _: Splitting) -> pl.Series:
    without = sorted(clips.filter(pl.col("split").is_null())["source"].unique().cast(pl.String))
    if len(without):
        raise InputError(
            f"rule own: clips of {', '.join(without)} have no split of their own; split them by another rule"
        )
    return clips["split"].cast(_SPLIT)
