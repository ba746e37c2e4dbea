"""What must never be trained on: other splits, scenes and sources that are held out, and what another split shows."""

from collections.abc import Collection
from dataclasses import dataclass

import polars as pl

from olt_datasets.tables.fingerprints import find_near_duplicates

SHOWN = 3


@dataclass(frozen=True)
class Leak:
    """A scene of a mixture that breaks a rule of `find_leaks`, and what was found, for people."""

    rule: str
    scene_id: str
    detail: str

    def __str__(self) -> str:
        return f"scene {self.scene_id}: {self.detail}"


def find_leaks(
    chosen: pl.DataFrame | pl.LazyFrame,
    table: pl.DataFrame | pl.LazyFrame,
    split: str = "train",
    held_out_scenes: Collection[str] = (),
    external_sources: Collection[str] = (),
) -> list[Leak]:
    """All leaks of a mixture, by rule and scene.

    - split: a chosen clip is of another split than `split`, or of none.
    - held out: a chosen clip shows a held-out scene.
    - external: a chosen clip is from a source that is never trained on.
    - twin: a clip of another kind (GT, Syn, front only) in another split shows the same moments as a chosen one.
    - overlap: a clip of the same kind in another split shows some of the same moments. Windows of one scene that do
      not overlap may be in different splits: that is the paper's seen-scenario split.
    - near-duplicate: a clip of another scene in another split looks like a chosen one (`tables.fingerprints`).

    Chosen are the rows that the mixture uses; the whole clip table is only scanned.
    """
    clips, others = chosen.lazy(), table.lazy().filter(pl.col("split") != split)
    wrong = clips.filter(pl.col("split").ne_missing(split)).select("scene_id", "clip_id", "split")
    held_out = clips.filter(pl.col("scene_id").is_in(list(held_out_scenes))).select("scene_id", "clip_id")
    external = clips.filter(pl.col("source").is_in(list(external_sources))).select("scene_id", "source").unique()
    return [
        *(
            Leak("split", scene, f"clip {clip_id} is of split {found or 'none'}, the mixture of split {split}")
            for scene, clip_id, found in _rows(wrong)
        ),
        *(Leak("held out", scene, f"clip {clip_id} shows a held-out scene") for scene, clip_id in _rows(held_out)),
        *(
            Leak("external", scene, f"source {source} is external: it is never trained on")
            for scene, source in _rows(external)
        ),
        *_find_shared_moments(clips, others),
        *_find_near_duplicates(clips, others),
    ]


def find_table_leaks(
    table: pl.LazyFrame, held_out_scenes: Collection[str] = (), external_sources: Collection[str] = ()
) -> list[Leak]:
    """All leaks between the splits of a table; only training may use neither held-out scenes nor external sources."""
    split = pl.col("split")
    of_training = find_leaks(table.filter(split == "train"), table, "train", held_out_scenes, external_sources)
    return of_training + find_leaks(table.filter(split == "val"), table.filter(split == "test"), "val")


def summarize_leaks(leaks: list[Leak]) -> str:
    """One line that names the first few leaks and counts the rest."""
    shown = "; ".join(map(str, leaks[:SHOWN]))
    return shown if len(leaks) <= SHOWN else f"{shown}; and {len(leaks) - SHOWN} more"


def _find_shared_moments(clips: pl.LazyFrame, others: pl.LazyFrame) -> list[Leak]:
    """Clips of one scene whose windows overlap across splits: one line a scene, pair of kinds and split."""
    columns = ("scene_id", "kind", "split", "start_us", "end_us")
    mine = clips.select(columns).collect(engine="streaming")
    theirs = others.select(columns).join(mine.lazy().select("scene_id").unique(), on="scene_id", how="semi")
    overlapping = (pl.col("start_us") <= pl.col("end_us_other")) & (pl.col("start_us_other") <= pl.col("end_us"))
    different = pl.col("split") != pl.col("split_other")
    shared = (
        mine.lazy()
        .join(theirs, on="scene_id", suffix="_other")
        .filter(overlapping & different)
        .group_by("scene_id", "kind", "split", "kind_other", "split_other")
        .agg(
            pl.max_horizontal("start_us", "start_us_other").min().alias("from_us"),
            pl.min_horizontal("end_us", "end_us_other").max().alias("to_us"),
        )
    )
    return [
        Leak(
            "overlap" if kind == other_kind else "twin",
            scene_id,
            f"its {kind} clips in split {split} and its {other_kind} clips in {other_split} both show moments from "
            f"{start_us / 1e6:.6g} to {end_us / 1e6:.6g} s",
        )
        for scene_id, kind, split, other_kind, other_split, start_us, end_us in _rows(shared)
    ]


def _find_near_duplicates(clips: pl.LazyFrame, others: pl.LazyFrame) -> list[Leak]:
    columns = ("scene_id", "clip_id", "split", "fingerprint")
    mine, theirs = (
        frame.select(columns).filter(pl.col("fingerprint").is_not_null()).collect(engine="streaming")
        for frame in (clips, others)
    )
    pairs = find_near_duplicates(mine["fingerprint"], theirs["fingerprint"])
    here, there = (frame.drop("fingerprint")[place] for frame, place in ((mine, pairs[:, 0]), (theirs, pairs[:, 1])))
    alike = here.hstack(there.select(pl.all().name.suffix("_other")))
    leaks = alike.filter((pl.col("scene_id") != pl.col("scene_id_other")) & (pl.col("split") != pl.col("split_other")))
    return [
        Leak(
            "near-duplicate",
            scene_id,
            f"clip {clip_id} looks like clip {other_id} of scene {other} in split {split}",
        )
        for scene_id, clip_id, _, other, other_id, split in _rows(leaks.lazy())
    ]


def _rows(found: pl.LazyFrame) -> list[tuple]:
    return found.collect(engine="streaming").sort(pl.all()).rows()
