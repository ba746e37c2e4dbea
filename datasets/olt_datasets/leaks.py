"""What must never be trained on: other splits, held-out scenes, and twins of clips that test another split."""

from collections.abc import Collection
from dataclasses import dataclass

import polars as pl

SHOWN = 3


@dataclass(frozen=True)
class Leak:
    """A scene of a mixture that breaks a rule.

    Attributes:
        rule: "split", "held out" or "twin".
        scene_id: the scene.
        detail: what was found, for people.
    """

    rule: str
    scene_id: str
    detail: str

    def __str__(self) -> str:
        return f"scene {self.scene_id}: {self.detail}"


def find_leaks(
    chosen: pl.DataFrame, table: pl.DataFrame, split: str = "train", held_out_scenes: Collection[str] = ()
) -> list[Leak]:
    """All leaks of a mixture, by scene.

    - split: a chosen clip is of another split than `split`.
    - held out: a chosen clip shows a held-out scene.
    - twin: a chosen clip has a clip of another kind (GT, Syn, front only) of its scene in another split, so that both
      splits hold the same drive.

    Args:
        chosen: the rows of the clip table that the mixture uses.
        table: the whole clip table, which holds the twins.
        split: the split that the mixture may use.
        held_out_scenes: scene ids that it may not use.
    """
    return [
        *_find_wrong_splits(chosen, split),
        *_find_held_out(chosen, held_out_scenes),
        *_find_twins(chosen, table),
    ]


def summarize_leaks(leaks: list[Leak]) -> str:
    """One line that names the first few leaks and counts the rest."""
    shown = "; ".join(map(str, leaks[:SHOWN]))
    return shown if len(leaks) <= SHOWN else f"{shown}; and {len(leaks) - SHOWN} more"


def _find_wrong_splits(chosen: pl.DataFrame, split: str) -> list[Leak]:
    wrong = chosen.filter(pl.col("split") != split).sort("scene_id", "clip_id")
    return [
        Leak("split", scene_id, f"clip {clip_id} is of split {found}, the mixture of split {split}")
        for scene_id, clip_id, found in wrong.select("scene_id", "clip_id", "split").iter_rows()
    ]


def _find_held_out(chosen: pl.DataFrame, held_out_scenes: Collection[str]) -> list[Leak]:
    held_out = chosen.filter(pl.col("scene_id").is_in(list(held_out_scenes))).sort("scene_id", "clip_id")
    return [
        Leak("held out", scene_id, f"clip {clip_id} shows a held-out scene")
        for scene_id, clip_id in held_out.select("scene_id", "clip_id").iter_rows()
    ]


def _find_twins(chosen: pl.DataFrame, table: pl.DataFrame) -> list[Leak]:
    groups = table.select("scene_id", "kind", "split").unique()
    twins = (
        chosen.select("scene_id", "kind", "split")
        .unique()
        .join(groups, on="scene_id", suffix="_twin")
        .filter((pl.col("kind") != pl.col("kind_twin")) & (pl.col("split") != pl.col("split_twin")))
        .sort("scene_id", "kind", "split", "kind_twin", "split_twin")
    )
    return [
        Leak("twin", scene_id, f"its {kind} clips are in split {split}, its {other_kind} clips in {other_split}")
        for scene_id, kind, split, other_kind, other_split in twins.iter_rows()
    ]
