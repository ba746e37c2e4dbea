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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from olt_datasets.tables.choices import SplitRule
from olt_datasets.tables.clip_frame import TABLE_SUFFIX, replace_column, rewrite_rows, scan_clip_tables
from olt_generator.errors import InputError
from olt_generator.seeds import derive_seed

_SEED_RANGE = 2.0**63
_SPLIT = pl.Enum(["train", "val", "test"])
_WORDS = ("scene_id", "source")
_NO_SPLIT = 3
_NEVER = np.iinfo(np.int64).max
_ROWS_AT_ONCE = 1_000_000

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
    clips = _read_columns(table)
    splits = assign_splits(clips, splitting)
    _check_filled(_count(clips, splits, splitting.sources), splitting, table)

    def change(rows: pa.Table, start: int) -> pa.Table:
        return replace_column(rows, "split", splits.slice(start, len(rows)).cast(pl.String))

    rewrite_rows(table, out, change)
    return _count(clips, splits)


def _read_columns(table: Path) -> pl.DataFrame:
    """What `assign_splits` needs, in the order of the file, as small as it can be: some 30 bytes a clip."""
    columns: dict[str, list[pl.Series]] = {}
    with pq.ParquetFile(table) as file:
        for group in range(file.num_row_groups):
            rows = file.read_row_group(group, [*_WORDS, "start_us", "end_us", "split", "sample_t0_us"])
            small = pl.DataFrame(rows).select(
                pl.col(_WORDS).cast(pl.Categorical),
                "start_us",
                "end_us",
                pl.col("split").cast(_SPLIT),
                samples=pl.col("sample_t0_us").list.len(),
            )
            for column in small:
                columns.setdefault(column.name, []).append(column)
    # Column by column, so that no more than one is held twice.
    return pl.DataFrame([pl.concat(columns.pop(name), rechunk=True) for name in list(columns)])


def _count(clips: pl.DataFrame, splits: pl.Series, sources: Sequence[str] = ()) -> SplitSummary:
    scenes, samples = clips["scene_id"].to_physical().to_numpy(), clips["samples"].to_numpy()
    counted, chosen = {}, _from_sources(clips, sources)
    for name in (*_SPLIT.categories, "none"):
        inside = (splits.is_null() if name == "none" else splits == name).fill_null(False).to_numpy() & chosen
        if inside.any():
            counted[name] = inside.sum(), np.count_nonzero(np.bincount(scenes[inside])), samples[inside].sum()
    return SplitSummary(*({name: int(row[place]) for name, row in counted.items()} for place in range(3)))


def _from_sources(clips: pl.DataFrame, sources: Sequence[str]) -> NDArray[np.bool_]:
    """Which clips (n,) are of one of the sources; all where none is named."""
    if not sources:
        return np.ones(len(clips), bool)
    return clips["source"].is_in(pl.Series(sources, dtype=pl.Categorical).implode()).to_numpy()


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
    clips = clips.with_columns(pl.col(_WORDS).cast(pl.Categorical), pl.col("split").cast(_SPLIT))
    if "samples" not in clips.columns:
        clips = clips.with_columns(samples=pl.lit(1))
    absent = sorted(set(splitting.sources) - set(clips["source"].unique().cast(pl.String)))
    if absent:
        raise InputError(f"the table has no clip of source {absent[0]!r}; change the sources that the rule is for")
    by_rule = {
        SplitRule.SEEN: _by_time,
        SplitRule.UNSEEN: _by_scene,
        SplitRule.EXTERNAL: lambda rows, _: pl.repeat("test", len(rows), dtype=_SPLIT, eager=True),
        SplitRule.OWN: _by_own,
    }[splitting.rule]
    if not splitting.sources:
        return by_rule(clips, splitting).alias("split")
    places = np.flatnonzero(_from_sources(clips, splitting.sources))
    return clips["split"].scatter(places, by_rule(clips[places], splitting)).alias("split")


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


def _list_windows(clips: pl.DataFrame) -> Iterator[_Windows]:
    """All clips, some whole scenes at a time."""
    scenes, starts, samples = (clips[name].to_physical().to_numpy() for name in ("scene_id", "start_us", "samples"))
    sizes = np.cumsum(np.bincount(scenes)) // _ROWS_AT_ONCE
    edges = np.searchsorted(sizes, np.arange(sizes[-1] + 2))
    for low, high in pairwise(edges.tolist()):
        rows = np.flatnonzero((scenes >= low) & (scenes < high))
        if len(rows):
            rows = rows[np.lexsort((starts[rows], scenes[rows]))]
            yield _order_windows(rows, scenes[rows], starts[rows], samples[rows] > 0)


def _order_windows(rows: Counts, scenes: Counts, start: Counts, gives: NDArray[np.bool_]) -> _Windows:
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


def _by_time(clips: pl.DataFrame, splitting: Splitting) -> pl.Series:
    """Windows of a scene in the order of their times; those too close to a later split are in none."""
    count, first_rows = (
        np.concatenate(parts)
        for parts in zip(*((part.count, part.rows[part.firsts]) for part in _list_windows(clips)), strict=True)
    )
    held, test = _share_windows(count, clips["scene_id"].gather(first_rows), splitting)
    ends, codes, scenes = clips["end_us"].to_numpy(), np.empty(len(clips), np.uint8), 0
    for part in _list_windows(clips):
        these = slice(scenes, scenes := scenes + len(part.count))
        val_from, test_from = (part.count - later[these] for later in (held, test))
        rank = (part.place >= val_from[part.scene]).astype(np.uint8) + (part.place >= test_from[part.scene])
        # When a later split of the scene starts: each window must end before that.
        val_start, test_start = (
            np.minimum.reduceat(np.where(rank > each, part.start, _NEVER), part.firsts)[part.scene] for each in (0, 1)
        )
        next_start = np.select([rank == 0, rank == 1], [val_start, test_start], _NEVER)
        too_close = ends[part.rows] + round(1e6 * splitting.gap) >= next_start
        codes[part.rows] = np.where(too_close, _NO_SPLIT, rank)
    return _name(codes)


def _name(codes: NDArray[np.uint8]) -> pl.Series:
    return pl.Series([*_SPLIT.categories, None], dtype=_SPLIT).gather(codes)


def _share_windows(count: Counts, scenes: pl.Series, splitting: Splitting) -> tuple[Counts, Counts]:
    """How many of the windows (n,) of each scene are in validation and test, and in test; the first is in training."""
    chance = _draw_places(scenes, 0)
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


def _by_scene(clips: pl.DataFrame, splitting: Splitting) -> pl.Series:
    codes = clips["scene_id"].to_physical().to_numpy()
    row_of = np.zeros(int(codes.max()) + 1, np.int64)
    row_of[codes] = np.arange(len(codes))
    present = np.flatnonzero(np.bincount(codes))
    places = _draw_places(clips["scene_id"].gather(row_of[present]), splitting.seed)
    ranks = np.select([places < splitting.test, places < splitting.test + splitting.val], [2, 1], 0)
    # Scenes that give samples fill all splits, even where they are few.
    gives = np.bincount(codes[clips["samples"].to_numpy() > 0], minlength=len(row_of))[present] > 0
    among = np.flatnonzero(gives | ~gives.any())
    ranks[among] = _fill_splits(places[among], splitting)
    split_of = np.zeros(len(row_of), np.uint8)
    split_of[present] = ranks
    return _name(split_of[codes])


def _fill_splits(places: NDArray[np.float64], splitting: Splitting) -> Counts:
    """The split (n,), by number, of scenes at places (n,) in [0, 1): by shares, and one at least if scenes are enough."""
    least_test, least_val = int(splitting.test > 0.0), int(splitting.val > 0.0)
    test, held = (int((places < share).sum()) for share in (splitting.test, splitting.test + splitting.val))
    if len(places) > least_test + least_val:
        test = int(np.clip(test, least_test, len(places) - 1 - least_val))
        held = int(np.clip(held, test + least_val, len(places) - 1))
    rank = np.argsort(np.argsort(places))
    return np.select([rank < test, rank < held], [2, 1], 0)


def _draw_places(scenes: pl.Series, seed: int) -> NDArray[np.float64]:
    """A place (n,) in [0, 1) for each scene, by its id and the seed alone."""
    seeds = (derive_seed("split", seed, scene) for scene in scenes.cast(pl.String))
    return np.fromiter(seeds, np.float64, len(scenes)) / _SEED_RANGE


def _by_own(clips: pl.DataFrame, _: Splitting) -> pl.Series:
    without = sorted(clips.filter(pl.col("split").is_null())["source"].unique().cast(pl.String))
    if len(without):
        raise InputError(
            f"rule own: clips of {', '.join(without)} have no split of their own; split them by another rule"
        )
    return clips["split"].cast(_SPLIT)
