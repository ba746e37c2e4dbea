"""What must never be trained on: other splits, scenes and sources that are held out, and what another split shows."""

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.tables.fingerprints import Search, is_telling, search_near_duplicates
from olt_datasets.tables.leak_listing import PLACE, LeakListing, Write, write_leaks
from olt_datasets.tables.leak_report import (
    NO_FINGERPRINT,
    NOTHING_TO_SEE,
    TOO_MANY_ALIKE,
    Comparison,
    LeakReport,
    join_reports,
)
from olt_datasets.tables.shared_moments import find_shared_moments

_ROWS_AT_ONCE = 100_000
_PAIRS_AT_ONCE = 1_000_000


def find_leaks(
    chosen: pl.DataFrame | pl.LazyFrame,
    table: pl.DataFrame | pl.LazyFrame,
    split: str = "train",
    held_out_scenes: Collection[str] = (),
    external_sources: Collection[str] = (),
    write: Write | None = None,
) -> LeakReport:
    """All leaks of a mixture, by rule and scene, and what was compared for each rule.

    - split: a chosen clip is of another split than `split`, or of none.
    - held out: a chosen clip shows a held-out scene.
    - external: a chosen clip is from a source that is never trained on.
    - twin: a clip of another kind (GT, Syn, front only) in another split shows the same moments as a chosen one.
    - overlap: a clip of the same kind in another split shows some of the same moments. Windows of one scene that do
      not overlap may be in different splits: that is the paper's seen-scenario split.
    - near-duplicate: a clip of another scene looks like a chosen one (`tables.fingerprints`), and is in another split,
      of a held-out scene, or from an external source. Clips without a fingerprint, and those whose images show too
      little, cannot be compared, which the report says.

    Chosen are the rows that the mixture uses; the whole clip table is only scanned. Clips in no split are compared with
    nothing, but for those of held-out scenes and external sources. All leaks are counted and the first of each rule
    told; `write` is given all of them.
    """
    clips, everything = chosen.lazy(), table.lazy()
    others = everything.filter(pl.col("split") != split)
    never = pl.col("scene_id").is_in(list(held_out_scenes)) | pl.col("source").is_in(list(external_sources))
    guarded = everything.filter((pl.col("split") != split) | never)
    splits = count_splits(everything)
    mine, theirs = _count(clips), _count(others)
    listing = LeakListing(split, write)
    listing.add(_find_clips(clips.filter(pl.col("split").ne_missing(split))), "split")
    listing.add(_find_clips(clips.filter(pl.col("scene_id").is_in(list(held_out_scenes)))), "held out")
    listing.add([_find_sources(clips.filter(pl.col("source").is_in(list(external_sources))))], "external")
    rule = pl.when(pl.col("kind") == pl.col("kind_other")).then(pl.lit("overlap")).otherwise(pl.lit("twin"))
    listing.add(find_shared_moments(clips, others), rule)
    seen, guard = (frame.select(*PLACE, "fingerprint", never=never) for frame in (clips, guarded))
    search = search_near_duplicates(seen, guard)
    listing.add(_find_near_duplicates(seen, guard, search), "near-duplicate")
    comparisons = [
        Comparison("split", "clips with the split of the mixture", mine),
        _compare_names("held out", "clips with the {} held-out scenes", mine, held_out_scenes),
        _compare_names("external", "clips with the {} external sources", mine, external_sources),
        Comparison("twin and overlap", "pairs of clips of different splits", mine * theirs),
        _count_comparable(seen, guard, len(search.crowded)),
    ]
    empty = None if theirs else f"no clip is in another split than {split}"
    return LeakReport(listing.leaks(), dict(listing.counts), tuple(comparisons), splits, empty)


def find_table_leaks(
    table: pl.LazyFrame,
    held_out_scenes: Collection[str] = (),
    external_sources: Collection[str] = (),
    out: Path | None = None,
) -> LeakReport:
    """All leaks between the splits of a table; only training may use neither held-out scenes nor external sources.

    They are written to the Parquet file `out`, if it is given.
    """
    split, splits = pl.col("split"), count_splits(table)
    with write_leaks(out) as write:
        reports = [
            find_leaks(table.filter(split == "train"), table, "train", held_out_scenes, external_sources, write),
            find_leaks(table.filter(split == "val"), table.filter(split.is_in(["val", "test"])), "val", write=write),
        ]
    used = [name for name in splits if name != "none"]
    empty = None
    if len(used) < 2:
        empty = f"all clips are in split {used[0]}" if used else "no clip is in a split"
    joined = join_reports(reports, splits, empty)
    # Clips were chosen by their splits.
    return replace(joined, comparisons=tuple(each for each in joined.comparisons if each.rule != "split"))


def count_splits(table: pl.LazyFrame) -> dict[str, int]:
    """The number of clips in each split that has some, and under "none" of those in no split."""
    counts = table.group_by("split").agg(pl.len()).collect(engine="streaming")
    by_name = {name or "none": count for name, count in counts.rows()}
    return {name: by_name[name] for name in ("train", "val", "test", "none") if name in by_name}


def _compare_names(rule: str, what: str, clips: int, names: Collection[str]) -> Comparison:
    return Comparison(rule, what.format(len(names)) if names else None, clips if names else 0)


def _find_clips(wrong: pl.LazyFrame) -> Iterator[pl.DataFrame]:
    """Chosen clips that may not be chosen."""
    return wrong.select(PLACE).collect_batches(chunk_size=_ROWS_AT_ONCE, maintain_order=True, engine="streaming")


def _find_sources(wrong: pl.LazyFrame) -> pl.DataFrame:
    """One leak for each scene and source, with its first clip."""
    first = pl.struct("clip_id", "split", "store").min_by("clip_id").alias("first")
    groups = wrong.group_by("scene_id", "source").agg(pl.len().alias("pairs"), first)
    return groups.collect(engine="streaming").unnest("first").sort("scene_id", "source")


def _find_near_duplicates(mine: pl.LazyFrame, theirs: pl.LazyFrame, search: Search) -> Iterator[pl.DataFrame]:
    """Pairs of clips of two tables that look alike and may not, and how alike they are."""
    for start in range(0, len(search.pairs), _PAIRS_AT_ONCE):
        part, matches = search.pairs[start : start + _PAIRS_AT_ONCE], search.matches.slice(start, _PAIRS_AT_ONCE)
        here, there = (_take(frame, part[:, side]) for side, frame in enumerate((mine, theirs)))
        alike = here.hstack(there.select(pl.all().name.suffix("_other"))).hstack(matches)
        yield alike.filter(pl.col("split").ne_missing(pl.col("split_other")) | pl.col("never_other"))


def _take(frame: pl.LazyFrame, places: NDArray[np.int64]) -> pl.DataFrame:
    """The rows at places (m,), which may repeat, without their fingerprints."""
    wanted = pl.LazyFrame({"place": places}, schema={"place": pl.UInt32})
    numbered = frame.drop("fingerprint").with_row_index("place")
    rows = numbered.join(wanted, on="place", how="semi").collect(engine="streaming")
    return wanted.collect().join(rows, on="place", how="left", maintain_order="left").drop("place")


def _count_comparable(first: pl.LazyFrame, second: pl.LazyFrame, crowded: int) -> Comparison:
    """Pairs of clips of two tables that could be compared, and those that could not, `crowded` clips of the first."""
    (clips, have, telling), (others, others_have, others_telling) = map(_count_fingerprints, (first, second))
    compared = (telling - crowded) * others_telling
    missed = {
        NO_FINGERPRINT: (clips * others - have * others_have, clips + others - have - others_have),
        NOTHING_TO_SEE: (have * others_have - telling * others_telling, have + others_have - telling - others_telling),
        TOO_MANY_ALIKE: (crowded * others_telling, crowded),
    }
    missed = {why: counts for why, counts in missed.items() if counts[0]}
    pairs, of_clips = ({why: counts[place] for why, counts in missed.items()} for place in (0, 1))
    return Comparison("near-duplicate", "pairs of clips by their fingerprints", compared, pairs, of_clips)


def _count_fingerprints(frame: pl.LazyFrame) -> tuple[int, int, int]:
    """The number of clips, of those with a fingerprint, and of those whose fingerprint can be compared."""
    clips = have = telling = 0
    for rows in frame.select("fingerprint").collect_batches(chunk_size=_ROWS_AT_ONCE, engine="streaming"):
        clips += len(rows)
        have += len(rows) - rows["fingerprint"].null_count()
        telling += int(is_telling(rows["fingerprint"]).sum())
    return clips, have, telling


def _count(frame: pl.LazyFrame) -> int:
    return frame.select(pl.len()).collect(engine="streaming").item()
