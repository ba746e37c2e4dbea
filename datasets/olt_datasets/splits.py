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
import pyarrow as pa
import pyarrow.parquet as pq

from olt_datasets.choices import SplitRule
from olt_datasets.clip_table import TABLE_SUFFIX, scan_clip_tables
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.seeds import derive_seed

_SEED_RANGE = 2.0**63
_SPLIT = pl.Enum(["train", "val", "test"])


@dataclass(frozen=True)
class Splitting:
    """A rule and what it needs to know.

    Attributes:
        rule: the rule.
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
    columns = ("scene_id", "source", "start_us", "end_us", "split")
    # The order of the file, not that of the clips: splits are written back row by row.
    scan_clip_tables([table])
    clips = pl.scan_parquet(table).select(columns).collect()
    splits = assign_splits(clips, splitting)
    _write_splits(table, splits, out)
    return {name or "none": count for name, count in splits.value_counts(sort=True).rows()}


def assign_splits(clips: pl.DataFrame, splitting: Splitting) -> pl.Series:
    """The split (n,) of each clip, None for clips that are in none.

    Args:
        clips: columns scene_id, source, start_us, end_us and split of the clip table.
        splitting: the rule.

    Raises:
        InputError: no clip is of a named source, or the rule is `own` and a clip has no split of its own.
    """
    absent = sorted(set(splitting.sources) - set(clips["source"].unique()))
    if absent:
        raise InputError(f"the table has no clip of source {absent[0]!r}; change the sources that the rule is for")
    chosen = pl.col("source").is_in(splitting.sources) if splitting.sources else pl.lit(True)
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
    start, end, scene = pl.col("start_us"), pl.col("end_us") + round(1e6 * splitting.gap), "scene_id"
    place, count = start.rank("dense").over(scene) - 1, start.n_unique().over(scene)
    test_from = count - (splitting.test * count).round()
    val_from = test_from - (splitting.val * count).round()
    numbered = clips.select(
        scene, start, end.alias("end_us"), is_test=place >= test_from, is_val=(place >= val_from) & (place < test_from)
    )
    test_start = start.filter(pl.col("is_test")).min().over(scene)
    val_start = start.filter(pl.col("is_val")).min().over(scene)
    later_start = pl.when(pl.col("is_val")).then(test_start).otherwise(pl.min_horizontal(val_start, test_start))
    name = pl.when("is_test").then(pl.lit("test")).when("is_val").then(pl.lit("val")).otherwise(pl.lit("train"))
    too_close = ~pl.col("is_test") & (pl.col("end_us") >= later_start).fill_null(value=False)
    return numbered.select(pl.when(~too_close).then(name).cast(_SPLIT).alias("split"))["split"]


def _by_scene(clips: pl.DataFrame, splitting: Splitting) -> pl.Series:
    scenes = clips["scene_id"].unique()
    places = np.array([derive_seed("split", splitting.seed, scene) for scene in scenes]) / _SEED_RANGE
    names = np.select([places < splitting.test, places < splitting.test + splitting.val], ["test", "val"], "train")
    return clips["scene_id"].replace_strict(scenes, pl.Series(names, dtype=_SPLIT), return_dtype=_SPLIT)


def _by_own(clips: pl.DataFrame, _: Splitting) -> pl.Series:
    without = clips.filter(pl.col("split").is_null())["source"].unique().sort()
    if len(without):
        raise InputError(
            f"rule own: clips of {', '.join(without)} have no split of their own; split them by another rule"
        )
    return clips["split"].cast(_SPLIT)


def _write_splits(table: Path, splits: pl.Series, out: Path) -> None:
    with pq.ParquetFile(table) as file, write_whole(out) as temporary:
        index, start = file.schema_arrow.get_field_index("split"), 0
        with pq.ParquetWriter(temporary, file.schema_arrow, compression="zstd") as writer:
            for group in range(file.num_row_groups):
                rows = file.read_row_group(group)
                new = splits.slice(start, len(rows)).cast(pl.String).to_arrow(compat_level=pl.CompatLevel.oldest())
                writer.write_table(rows.set_column(index, file.schema_arrow.field(index), new.cast(pa.string())))
                start += len(rows)
