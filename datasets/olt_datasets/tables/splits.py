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

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from olt_datasets.tables.choices import SplitRule
from olt_datasets.tables.clip_frame import TABLE_SUFFIX, replace_column, rewrite_rows, scan_clip_tables
from olt_datasets.tables.split_columns import (
    NO_SPLIT,
    NUMBERS,
    Counts,
    SplitColumns,
    gather_columns,
    name_splits,
    read_columns,
)
from olt_generator.errors import InputError

_NEVER = np.iinfo(np.int64).max
_ROWS_AT_ONCE = 500_000


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

    @property
    def seed_of_scenes(self) -> int:
        """The seed of what is drawn for each scene: by rule seen, which seed is given changes nothing."""
        return self.seed if self.rule is SplitRule.UNSEEN else 0


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
    with pq.ParquetFile(table, pre_buffer=False) as file:
        clips = gather_columns(partial(read_columns, file), file.metadata.num_rows, splitting.seed_of_scenes)
    codes = _assign(clips, splitting)
    _check_filled(_count(clips, codes, _from_sources(clips, splitting)), splitting, table)

    def change(rows: pa.Table, start: int) -> pa.Table:
        return replace_column(rows, "split", name_splits(codes[start : start + len(rows)]).cast(pl.String))

    rewrite_rows(table, out, change)
    return _count(clips, codes, np.ones(len(codes), bool))


def _count(clips: SplitColumns, codes: NDArray[np.uint8], chosen: NDArray[np.bool_]) -> SplitSummary:
    counted = {}
    for name, number in NUMBERS.items():
        inside = (codes == number) & chosen
        if inside.any():
            scenes = np.count_nonzero(np.bincount(clips.scene[inside]))
            counted[name or "none"] = inside.sum(), scenes, clips.samples[inside].sum()
    return SplitSummary(*({name: int(row[place]) for name, row in counted.items()} for place in range(3)))


def _from_sources(clips: SplitColumns, splitting: Splitting) -> NDArray[np.bool_]:
    """Which clips (n,) the rule is for; InputError where a source has none."""
    absent = sorted(set(splitting.sources) - set(clips.sources))
    if absent:
        raise InputError(f"the table has no clip of source {absent[0]!r}; change the sources that the rule is for")
    named = [clips.sources.index(name) for name in splitting.sources or clips.sources]
    return np.isin(clips.source, named)


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
    if "samples" not in clips.columns:
        clips = clips.with_columns(samples=pl.lit(1))
    return name_splits(
        _assign(gather_columns(lambda _: [clips], len(clips), splitting.seed_of_scenes), splitting)
    ).alias("split")


def _assign(clips: SplitColumns, splitting: Splitting) -> NDArray[np.uint8]:
    by_rule = {
        SplitRule.SEEN: _by_time,
        SplitRule.UNSEEN: _by_scene,
        SplitRule.EXTERNAL: lambda rows, _: np.full(len(rows.scene), NUMBERS["test"], np.uint8),
        SplitRule.OWN: _by_own,
    }[splitting.rule]
    chosen = _from_sources(clips, splitting)
    if chosen.all():
        return by_rule(clips, splitting)
    codes = clips.split.copy()
    codes[chosen] = by_rule(clips.take(np.flatnonzero(chosen)), splitting)
    return codes


@dataclass(frozen=True)
class _Windows:
    """The clips of some whole scenes in the order of their scenes and times.

    Attributes:
        rows: (n,) their rows; scene: (n,) the number of each one's scene among these; firsts: the first clip of each.
        start: (n,) where each starts, in microseconds.
        place: (n,) how many windows of its scene that give samples are before each. Clips of one start (GT and Syn of
            one window) have one place.
        count: (scenes,) windows of each scene that give samples; all of them where none does.
    """

    rows: Counts
    scene: Counts
    firsts: Counts
    start: Counts
    place: Counts
    count: Counts


def _list_windows(clips: SplitColumns) -> Iterator[_Windows]:
    """All clips, some whole scenes at a time, in the order of the scenes."""
    stretches = np.cumsum(np.bincount(clips.scene)) // _ROWS_AT_ONCE
    edges = np.searchsorted(stretches, np.arange(stretches[-1] + 2))
    for low, high in pairwise(edges.tolist()):
        rows = np.flatnonzero((clips.scene >= low) & (clips.scene < high))
        if len(rows):
            rows = rows[np.lexsort((clips.start_us[rows], clips.scene[rows]))]
            yield _order_windows(rows, clips.scene[rows], clips.start_us[rows], clips.samples[rows] > 0)


def _order_windows(rows: Counts, scenes: NDArray[np.uint32], start: Counts, gives: NDArray[np.bool_]) -> _Windows:
    is_first = np.diff(scenes.astype(np.int64), prepend=-1) != 0
    firsts, scene = np.flatnonzero(is_first), np.cumsum(is_first) - 1
    starts_window = is_first | (np.diff(start, prepend=start[:1]) != 0)
    window, first_of_window = np.cumsum(starts_window) - 1, np.flatnonzero(starts_window)
    scene_of_window = scene[first_of_window]
    gives = np.maximum.reduceat(gives, first_of_window)
    counts = gives | (np.bincount(scene_of_window, gives) == 0)[scene_of_window]
    count = np.bincount(scene_of_window, counts).astype(np.int64)
    before = np.cumsum(counts) - counts
    place = before - before[window[firsts]][scene_of_window]
    place = np.minimum(place, count[scene_of_window] - 1)[window]
    return _Windows(rows, scene, firsts, start, place, count)


def _by_time(clips: SplitColumns, splitting: Splitting) -> NDArray[np.uint8]:
    """Windows of a scene in the order of their times; those too close to a later split are in none."""
    count = np.concatenate([part.count for part in _list_windows(clips)])
    held, test = _share_windows(count, clips.place, splitting)
    codes, scenes = np.empty(len(clips.scene), np.uint8), 0
    for part in _list_windows(clips):
        these = slice(scenes, scenes := scenes + len(part.count))
        val_from, test_from = (part.count - later[these] for later in (held, test))
        rank = (part.place >= val_from[part.scene]).astype(np.uint8) + (part.place >= test_from[part.scene])
        # When a later split of the scene starts: each window must end before that.
        val_start, test_start = (
            np.minimum.reduceat(np.where(rank > each, part.start, _NEVER), part.firsts)[part.scene] for each in (0, 1)
        )
        next_start = np.select([rank == 0, rank == 1], [val_start, test_start], _NEVER)
        too_close = clips.end_us[part.rows] + round(1e6 * splitting.gap) >= next_start
        codes[part.rows] = np.where(too_close, NO_SPLIT, rank)
    return codes


def _share_windows(count: Counts, chance: NDArray[np.float64], splitting: Splitting) -> tuple[Counts, Counts]:
    """How many of the windows (n,) of each scene are in validation and test, and in test; the first is in training."""
    shares = splitting.val + splitting.test, splitting.test
    held, test = (np.floor(share * count) + (chance < share * count % 1.0) for share in shares)
    held = np.minimum(held, count - 1).astype(np.int64)
    test = np.minimum(test, held).astype(np.int64)
    # Of few scenes none may give to a split: then the longest does, if it can.
    longest = int(np.lexsort((chance, -count))[0])
    if splitting.test > 0.0 and not test.any():
        test[longest] = min(1, count[longest] - 1)
    if splitting.val > 0.0 and not (held > test).any():
        held[longest] = test[longest] + 1
    held[longest] = np.clip(held[longest], test[longest], count[longest] - 1)
    return held, test


def _by_scene(clips: SplitColumns, splitting: Splitting) -> NDArray[np.uint8]:
    ranks = np.select([clips.place < splitting.test, clips.place < splitting.test + splitting.val], [2, 1], 0)
    # Scenes that give samples fill all splits, even where they are few.
    gives = np.bincount(clips.scene[clips.samples > 0], minlength=len(ranks)) > 0
    among = np.flatnonzero(gives | ~gives.any())
    ranks[among] = _fill_splits(clips.place[among], splitting)
    return ranks.astype(np.uint8)[clips.scene]


def _fill_splits(places: NDArray[np.float64], splitting: Splitting) -> Counts:
    """Numbers (n,) of the splits of scenes at places (n,) in [0, 1): by shares, each filled if scenes are enough."""
    least_test, least_val = int(splitting.test > 0.0), int(splitting.val > 0.0)
    test, held = (int((places < share).sum()) for share in (splitting.test, splitting.test + splitting.val))
    if len(places) > least_test + least_val:
        test = int(np.clip(test, least_test, len(places) - 1 - least_val))
        held = int(np.clip(held, test + least_val, len(places) - 1))
    rank = np.argsort(np.argsort(places))
    return np.select([rank < test, rank < held], [2, 1], 0)


def _by_own(clips: SplitColumns, _: Splitting) -> NDArray[np.uint8]:
    without = sorted(clips.sources[number] for number in np.unique(clips.source[clips.split == NO_SPLIT]))
    if without:
        raise InputError(
            f"rule own: clips of {', '.join(without)} have no split of their own; split them by another rule"
        )
    return clips.split
