"""What must never be trained on: other splits, scenes and sources that are held out, and what another split shows."""

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.tables.fingerprints import is_telling, search_near_duplicates
from olt_datasets.tables.leak_report import (
    NO_FINGERPRINT,
    NOTHING_TO_SEE,
    TOO_MANY_ALIKE,
    ClipPlace,
    Comparison,
    Leak,
    LeakReport,
    join_reports,
)
from olt_datasets.tables.shared_moments import find_shared_moments

_PLACE = ("clip_id", "scene_id", "split", "store")
_ROWS_AT_ONCE = 100_000


def find_leaks(
    chosen: pl.DataFrame | pl.LazyFrame,
    table: pl.DataFrame | pl.LazyFrame,
    split: str = "train",
    held_out_scenes: Collection[str] = (),
    external_sources: Collection[str] = (),
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
    nothing, but for those of held-out scenes and external sources.
    """
    clips, everything = chosen.lazy(), table.lazy()
    others = everything.filter(pl.col("split") != split)
    never = pl.col("scene_id").is_in(list(held_out_scenes)) | pl.col("source").is_in(list(external_sources))
    guarded = everything.filter((pl.col("split") != split) | never)
    splits = count_splits(everything)
    mine, theirs = _count(clips), _count(others)
    shared = find_shared_moments(clips, others)
    alike, near_duplicates = _find_near_duplicates(clips, guarded, never)
    leaks = [
        *_find_clips(clips.filter(pl.col("split").ne_missing(split)), "split", split),
        *_find_clips(clips.filter(pl.col("scene_id").is_in(list(held_out_scenes))), "held out", split),
        *_find_sources(clips.filter(pl.col("source").is_in(list(external_sources)))),
        *map(_word_shared, shared.iter_rows(named=True)),
        *alike,
    ]
    comparisons = [
        Comparison("split", "clips with the split of the mixture", mine),
        _compare_names("held out", "clips with the {} held-out scenes", mine, held_out_scenes),
        _compare_names("external", "clips with the {} external sources", mine, external_sources),
        Comparison("twin and overlap", "pairs of clips of different splits", mine * theirs),
        near_duplicates,
    ]
    empty = None if theirs else f"no clip is in another split than {split}"
    return LeakReport(tuple(leaks), tuple(comparisons), splits, empty)


def find_table_leaks(
    table: pl.LazyFrame, held_out_scenes: Collection[str] = (), external_sources: Collection[str] = ()
) -> LeakReport:
    """All leaks between the splits of a table; only training may use neither held-out scenes nor external sources."""
    split, splits = pl.col("split"), count_splits(table)
    reports = [
        find_leaks(table.filter(split == "train"), table, "train", held_out_scenes, external_sources),
        find_leaks(table.filter(split == "val"), table.filter(split.is_in(["val", "test"])), "val"),
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


def _find_clips(wrong: pl.LazyFrame, rule: str, split: str) -> list[Leak]:
    """Chosen clips that may not be chosen."""
    return [
        Leak(
            rule,
            place.scene_id,
            f"clip {place.clip_id} is of split {place.split or 'none'}, the mixture of split {split}"
            if rule == "split"
            else f"clip {place.clip_id} shows a held-out scene",
            (place,),
        )
        for place in _places(wrong)
    ]


def _find_sources(wrong: pl.LazyFrame) -> list[Leak]:
    """One leak for each scene and source."""
    groups = wrong.group_by("scene_id", "source").agg(pl.len(), pl.struct(_PLACE).min_by("clip_id"))
    found = groups.collect(engine="streaming").sort("scene_id", "source").iter_rows(named=True)
    return [
        Leak(
            "external",
            row["scene_id"],
            f"source {row['source']} is external: it is never trained on",
            (ClipPlace(**row["clip_id"]),),
            row["len"],
        )
        for row in found
    ]


def _word_shared(row: dict[str, Any]) -> Leak:
    kind, other_kind = row["kind"], row["kind_other"]
    return Leak(
        "overlap" if kind == other_kind else "twin",
        row["scene_id"],
        f"its {kind} clips in split {row['split']} and its {other_kind} clips in {row['split_other']} both show "
        f"moments from {row['from_us'] / 1e6:.6g} to {row['to_us'] / 1e6:.6g} s",
        (_place(row), _place(row | {"scene_id_other": row["scene_id"]}, "_other")),
        row["pairs"],
    )


def _find_near_duplicates(clips: pl.LazyFrame, guarded: pl.LazyFrame, never: pl.Expr) -> tuple[list[Leak], Comparison]:
    mine, theirs = (frame.select(*_PLACE, "fingerprint", never=never) for frame in (clips, guarded))
    search = search_near_duplicates(mine, theirs)
    comparison = _count_comparable(mine, theirs, len(search.crowded))
    here, there = (_take(frame, search.pairs[:, side]) for side, frame in enumerate((mine, theirs)))
    alike = here.hstack(there.select(pl.all().name.suffix("_other"))).with_row_index("pair")
    found = alike.filter(pl.col("split").ne_missing(pl.col("split_other")) | pl.col("never_other"))
    leaks = []
    for row in found.sort("scene_id", "clip_id", "scene_id_other", "clip_id_other").iter_rows(named=True):
        place, other, match = _place(row), _place(row, "_other"), search.matches[row["pair"]]
        detail = f"{place} looks like {other}: {match}"
        leaks.append(Leak("near-duplicate", place.scene_id, detail, (place, other), match=match))
    return leaks, comparison


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


def _places(frame: pl.LazyFrame) -> list[ClipPlace]:
    rows = frame.select(_PLACE).collect(engine="streaming").sort("scene_id", "clip_id", "store")
    return [ClipPlace(**row) for row in rows.iter_rows(named=True)]


def _place(row: dict[str, Any], suffix: str = "") -> ClipPlace:
    return ClipPlace(**{name: row[name + suffix] for name in _PLACE})
