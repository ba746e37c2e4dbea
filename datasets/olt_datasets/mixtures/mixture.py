"""Mixtures: the exact samples of every batch of every epoch.

A mixture is a pure function of (recipe, clip table, seed), and a batch of it of (epoch, batch size, rank, world size)
besides. Random draws are seeded by the names of components, not of recipes: components of one name and filter give
the same samples in every recipe with the same seed, and a larger count keeps the samples of a smaller one, so that
training runs differ in nothing but what their recipes say.
"""

import hashlib
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypedDict

import numpy as np
import polars as pl

from olt_datasets.mixtures.epoch_batches import EpochBatches
from olt_datasets.mixtures.epoch_order import Draw, EpochOrder, Rows
from olt_datasets.mixtures.epoch_plan import EpochPlan
from olt_datasets.mixtures.quality import SAMPLE_QUALITIES, describe_quality
from olt_datasets.mixtures.recipe import Component, Recipe
from olt_datasets.mixtures.selection import (
    AbsentValue,
    ClipTable,
    Shortage,
    find_absent_values,
    find_shortages,
    most_items,
    samples_per_epoch,
    select_clips,
    word_shortage,
)
from olt_datasets.tables.clip_frame import SCHEMA
from olt_datasets.tables.leak_report import LeakReport, summarize_leaks
from olt_datasets.tables.leaks import count_splits, find_leaks
from olt_generator.errors import InputError
from olt_generator.seeds import derive_seed, make_generator
from olt_toolkit.policy.sample import SampleKey

KEY_COLUMNS = ("store", "clip_id", "t0_us")
GROUPS = ("source", "kind", "category", "factors", "country")
SAMPLE_SCHEMA = pl.Schema(
    {"store": pl.String, "clip_id": pl.String, "t0_us": pl.Int64}
    | {name: SCHEMA[name] for name in GROUPS}
    | dict.fromkeys(SAMPLE_QUALITIES, pl.Float64)
)
LEAK_COLUMNS = ("clip_id", "scene_id", "source", "kind", "split", "store", "start_us", "end_us", "fingerprint")
NOT_TOLD = "not told"
"""The country of a clip whose country nobody told."""


@dataclass(frozen=True)
class MixtureComponent:
    """The distinct samples (columns of `SAMPLE_SCHEMA`) that one component gives, of so many available.

    `not_measured` clips lack a number that it asks for, and were left out or taken as its filter says.
    """

    component: Component
    available: int
    not_measured: int
    samples: pl.DataFrame

    def word_weights(self) -> str | None:
        """What the weights of the component chose; None where it has none."""
        if not self.component.weight_by:
            return None
        if len(self.samples) == self.available:
            return f"nothing: all {self.available} samples are drawn; ask for fewer"
        return f"{len(self.samples)} of {self.available} samples"

    def permute(self, index: int, seed: int, epoch: int) -> Rows:
        """All rows of `samples` in the order of one pass through them."""
        return make_generator("mixture pass", seed, self.component.name, epoch, index).permutation(len(self.samples))


@dataclass(frozen=True, eq=False)
class Mixture:
    """A recipe applied to a clip table, which gives so many items per epoch; see `compose_mixture`."""

    recipe: Recipe
    seed: int
    items: int
    components: tuple[MixtureComponent, ...]

    def __len__(self) -> int:
        """Items per epoch."""
        return self.items

    def counts(self, epoch: int = 0) -> list[int]:
        """Items of each component in an epoch: over all epochs to this, its exact share rounded down or up."""
        if not self.recipe.named_epochs:
            return [component.count or 0 for component in self.recipe.components]
        return self._plan.counts(epoch)

    def epoch(
        self, epoch: int, batch_size: int, rank: int = 0, world_size: int = 1, start_batch: int = 0
    ) -> EpochBatches:
        """The batches of one rank in one epoch.

        Every global batch holds each component within one item of its share of the epoch's items. The last one is kept
        when it is partial, as Hugging Face's Trainer keeps it; nothing is repeated to fill it. Rank r takes items r,
        r + world_size, ... of each global batch, so ranks are disjoint and give the same global batches at every world
        size; in a partial batch some ranks have one item fewer, which may be none.

        No batch is built before it is asked for, and none of those before it: to start anywhere takes the same time.

        Args:
            epoch: from 0.
            batch_size: items in a global batch, that is over all ranks and accumulation steps.
            rank, world_size: which part of every global batch is wanted; `world_size` divides `batch_size`.
            start_batch: number of batches to leave out at the start, to resume within an epoch.

        Raises:
            InputError: the arguments do not fit together, or the mixture has no samples.
        """
        if batch_size < 1 or world_size < 1 or batch_size % world_size:
            raise InputError(f"global batch size {batch_size} must be a multiple of the world size {world_size}")
        if not 0 <= rank < world_size:
            raise InputError(f"rank {rank} must be 0 to {world_size - 1}, as the world size is {world_size}")
        if epoch < 0 or start_batch < 0:
            raise InputError(f"epoch {epoch} and start batch {start_batch} must not be negative")
        if not self.items:
            raise InputError(
                f"recipe {self.recipe.name} has no samples to train on: it stands for a model that is used as it is"
            )
        draws = [
            Draw(items, len(part.samples), partial(part.permute, seed=self.seed, epoch=epoch))
            for part, items in zip(self.components, self.counts(epoch), strict=True)
        ]
        order = EpochOrder(draws, batch_size, derive_seed("mixture order", self.seed, epoch, batch_size))
        return EpochBatches(order, self.keys, slice(rank, None, world_size), start_batch)

    def keys(self, rows: Rows | list[int]) -> list[SampleKey]:
        """The keys of rows of `samples`."""
        return list(map(SampleKey, *(self.samples[name].gather(rows).to_list() for name in KEY_COLUMNS)))

    def describe(self, epoch: int = 0) -> dict[str, Any]:
        """What was asked and what was got in an epoch, by component and in all by each of `GROUPS`.

        `got` counts items, `distinct` the samples that they are drawn from, `repeats` the most uses of one sample,
        `quality` what is known of their pixels and labels (`describe_quality`). `weights` tells what weights chose. A
        sample counts once for each of its factors, so that these may add up to more or less than all items.
        """
        counts = self.counts(epoch)
        shares = self.recipe.shares(epoch) if self.recipe.named_epochs else [None] * len(counts)
        uses = [self._count_uses(part, count, epoch) for part, count in zip(self.components, counts, strict=True)]
        all_uses = np.concatenate([np.empty(0, np.int64), *uses])
        return {
            "recipe": self.recipe.name,
            "split": self.recipe.split,
            "seed": self.seed,
            "checksum": self.checksum,
            "epoch": epoch,
            "samples_per_epoch": self.items,
            "distinct_samples": len(self.samples),
            "components": [
                {
                    "name": part.component.name,
                    "where": part.component.where.model_dump(mode="json", exclude_defaults=True),
                    "share": None if share is None else float(share),
                    "asked": float(count if share is None else share * self.items),
                    "got": count,
                    "available": part.available,
                    "distinct": len(part.samples),
                    "repeats": math.ceil(count / len(part.samples)),
                    "not_measured": part.not_measured,
                    "weights": part.word_weights(),
                    "quality": describe_quality(part.samples, used),
                }
                for part, share, count, used in zip(self.components, shares, counts, uses, strict=True)
            ],
            "items_by_epoch": {str(named): self.counts(named) for named in self.recipe.named_epochs},
            "quality": describe_quality(self.samples, all_uses),
            **{f"by_{group}": _sum_uses(self.samples[group], all_uses) for group in GROUPS},
        }

    @cached_property
    def samples(self) -> pl.DataFrame:
        """The distinct samples of all components, one after the other, with the columns of `SAMPLE_SCHEMA`."""
        return pl.concat([SAMPLE_SCHEMA.to_frame(), *(part.samples for part in self.components)])

    @cached_property
    def checksum(self) -> str:
        """BLAKE2b (16 bytes, hexadecimal) of the samples of every component; moving a store does not change it."""
        digest = hashlib.blake2b(digest_size=16)
        for part in self.components:
            lines = part.samples.select(pl.concat_str("clip_id", "t0_us", separator=" ")).to_series()
            digest.update("\n".join([part.component.name, *lines, ""]).encode())
        return digest.hexdigest()

    @cached_property
    def _plan(self) -> EpochPlan:
        return EpochPlan(self.recipe.shares, self.recipe.named_epochs[-1], self.items)

    def _count_uses(self, part: MixtureComponent, items: int, epoch: int) -> Rows:
        """How often each sample of a component is used in an epoch: in every whole pass, and maybe in the last."""
        passes, rest = divmod(items, len(part.samples))
        uses = np.full(len(part.samples), passes)
        uses[part.permute(passes, self.seed, epoch)[:rest]] += 1
        return uses


def compose_mixture(
    recipe: Recipe,
    table: ClipTable,
    seed: int,
    held_out_scenes: Collection[str] = (),
    allow_uncompared: bool = False,
) -> Mixture:
    """Choose the samples of every component; see `compose_and_check`, which also tells what was compared."""
    return compose_and_check(recipe, table, seed, held_out_scenes, allow_uncompared)[0]


def compose_and_check(
    recipe: Recipe,
    table: ClipTable,
    seed: int,
    held_out_scenes: Collection[str] = (),
    allow_uncompared: bool = False,
) -> tuple[Mixture, LeakReport]:
    """Choose the samples of every component, and tell what of them was compared with what to find leaks.

    Scenes that the recipe holds out are left out; scenes in `held_out_scenes` (those of a test, say) must not occur.

    Args:
        table: clips to choose from, such as `scan_clip_tables` gives.
        seed: seed of the choice and of every order.
        allow_uncompared: whether clips of other splits may be in the table with which some of the mixture cannot be
            compared, because either has no fingerprint or shows too little.

    Raises:
        InputError: a component has too few samples, two components share a clip, or the mixture leaks, or may leak.
    """
    selections = select_clips(recipe, table)
    shortages = find_shortages(recipe, table, selections)
    if shortages:
        raise InputError(word_shortage(shortages[0]))
    items = samples_per_epoch(recipe, selections)
    columns = [name for name in dict.fromkeys([*SAMPLE_SCHEMA, *LEAK_COLUMNS]) if name not in ("t0_us", "action_error")]
    drawn = [
        selection.draw(most, seed, columns)
        for selection, most in zip(selections, most_items(recipe, items), strict=True)
    ]
    report = _find_leaks(
        # In one order: clips that look alike are found by their places, and told in a second pass.
        [samples.lazy().unique(["store", "clip_id"], maintain_order=True) for samples in drawn],
        table,
        recipe,
        held_out_scenes,
    )
    if report.leaks:
        raise InputError(
            f"recipe {recipe.name} leaks: {summarize_leaks(report)}; add these scenes to the recipe's held_out_scenes"
        )
    if report.not_compared and not allow_uncompared:
        raise InputError(
            f"recipe {recipe.name} may leak: {'; '.join(report.not_compared)}; index these clips again for their "
            "fingerprints, or allow what cannot be compared (--allow-uncompared)"
        )
    components = [
        MixtureComponent(
            selection.component, selection.available, selection.not_measured, samples.select(SAMPLE_SCHEMA.names())
        )
        for selection, samples in zip(selections, drawn, strict=True)
    ]
    return Mixture(recipe, seed, items, tuple(components)), report


class Findings(TypedDict):
    """What `check_recipe` found."""

    shortages: list[Shortage]
    leaks: LeakReport
    absent: list[AbsentValue]


def check_recipe(recipe: Recipe, table: ClipTable, held_out_scenes: Collection[str] = ()) -> Findings:
    """Why `compose_mixture` would refuse (`shortages`, `leaks` and what was not compared); `absent` values of filters.

    Absent is what a filter names and no clip has.

    Leaks are looked for in all clips that the recipe may use, whichever of them a seed draws.

    Raises:
        InputError: two components select the same clip.
    """
    selections = select_clips(recipe, table)
    clips = [selection.clips for selection in selections]
    return {
        "shortages": find_shortages(recipe, table, selections),
        "leaks": _find_leaks(clips, table, recipe, held_out_scenes),
        "absent": find_absent_values(recipe, table),
    }


def _find_leaks(
    clips: Sequence[pl.LazyFrame], table: ClipTable, recipe: Recipe, held_out_scenes: Collection[str]
) -> LeakReport:
    if not clips:
        return LeakReport((), {}, (), count_splits(table.lazy()), "the recipe takes no clip")
    used = pl.concat([part.select(LEAK_COLUMNS) for part in clips])
    return find_leaks(used, table, recipe.split, [*recipe.held_out_scenes, *held_out_scenes])


def _sum_uses(values: pl.Series, uses: Rows) -> dict[str, dict[str, int]]:
    """For each value, the uses (samples,) of samples that have it, and the number of these samples."""
    table = pl.DataFrame({"value": values, "got": uses})
    if values.dtype == pl.List:
        table = table.explode("value", empty_as_null=False)
    groups = table.group_by(pl.col("value").fill_null(NOT_TOLD)).agg(pl.col("got").sum(), distinct=pl.len())
    return {value: {"got": got, "distinct": distinct} for value, got, distinct in groups.sort("value").iter_rows()}
