"""Mixtures: the exact samples of every batch of every epoch.

A mixture is a pure function of (recipe, clip table, seed), and a batch of it of (epoch, batch size, rank, world size)
besides. Random draws are seeded by the names of components, not of recipes: components of one name and filter give
the same samples in every recipe with the same seed, and a larger count keeps the samples of a smaller one, so that
training runs differ in nothing but what their recipes say.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.batches import batch_counts
from olt_datasets.clip_table import explode_samples, table_checksum
from olt_datasets.leaks import Leak, find_leaks, summarize_leaks
from olt_datasets.recipe import Component, Recipe
from olt_datasets.selection import (
    Selection,
    exact_shares,
    find_absent_words,
    find_shortages,
    plan_counts,
    select_clips,
)
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator
from olt_toolkit.sample import SampleKey

KEY_COLUMNS = ("store", "clip_id", "t0_us")
GROUPS = ("kind", "category", "source")

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class MixtureComponent:
    """The samples that one component gives.

    Attributes:
        component: the component of the recipe.
        asked: items per epoch that the recipe asks for; not whole where a share of the epoch is not.
        got: items per epoch.
        available: samples that the component's filter matches.
        samples: the distinct samples that are used, with the columns `KEY_COLUMNS` and `GROUPS`.
    """

    component: Component
    asked: float
    got: int
    available: int
    samples: pl.DataFrame

    def draw(self, seed: int, epoch: int) -> Rows:
        """Rows of `samples` (got,) in the order of their use: pass after pass, each a new permutation of all rows."""
        passes = range(math.ceil(self.got / len(self.samples)))
        name, rows = self.component.name, len(self.samples)
        drawn = [make_generator("mixture pass", seed, name, epoch, index).permutation(rows) for index in passes]
        return np.concatenate(drawn)[: self.got]


@dataclass(frozen=True, eq=False)
class Mixture:
    """A recipe applied to a clip table; see `compose_mixture`.

    Attributes:
        recipe: the recipe.
        seed: seed of every draw.
        table_checksum: checksum of the clip table.
        components: what each component gives, in the order of the recipe.
    """

    recipe: Recipe
    seed: int
    table_checksum: str
    components: tuple[MixtureComponent, ...]

    @property
    def counts(self) -> list[int]:
        """Items of each component per epoch."""
        return [component.got for component in self.components]

    def __len__(self) -> int:
        """Items per epoch."""
        return sum(self.counts)

    def epoch(
        self, epoch: int, batch_size: int, rank: int = 0, world_size: int = 1, start_batch: int = 0
    ) -> list[list[SampleKey]]:
        """The batches of one rank in one epoch.

        Every global batch holds each component within one item of its share of the mixture. The last one is kept when
        it is partial, as Hugging Face's Trainer keeps it; nothing is repeated to fill it. Rank r takes items r,
        r + world_size, ... of each global batch, so ranks are disjoint and give the same global batches at every world
        size; in a partial batch some ranks have one item fewer, which may be none.

        Args:
            epoch: number of the epoch, from 0.
            batch_size: items in a global batch, that is over all ranks and accumulation steps.
            rank, world_size: which part of every global batch is wanted; `world_size` divides `batch_size`.
            start_batch: number of batches to leave out at the start, to resume within an epoch.

        Raises:
            InputError: the arguments do not fit together.
        """
        _check_slice(epoch, batch_size, rank, world_size, start_batch)
        rows = self._epoch_rows(epoch, batch_size)
        starts = range(start_batch * batch_size, len(rows), batch_size)
        slices = [rows[start : start + batch_size][rank::world_size] for start in starts]
        keys = iter(self._keys(np.concatenate(slices))) if slices else iter(())
        return [[next(keys) for _ in part] for part in slices]

    def describe(self) -> dict[str, Any]:
        """What was asked and what was got, by component and in all by kind, category and source.

        `got` counts items of epoch 0, `distinct` the samples that they are drawn from, `repeats` the most uses of one
        sample in an epoch.
        """
        samples, uses = self._samples, self._uses(epoch=0)
        return {
            "recipe": self.recipe.name,
            "split": self.recipe.split,
            "seed": self.seed,
            "table_checksum": self.table_checksum,
            "samples_per_epoch": len(self),
            "distinct_samples": len(samples),
            "components": [_describe_component(component) for component in self.components],
            **{f"by_{group}": _describe_group(samples[group], uses) for group in GROUPS},
        }

    @cached_property
    def _samples(self) -> pl.DataFrame:
        return pl.concat([component.samples for component in self.components])

    @cached_property
    def _offsets(self) -> list[int]:
        sizes = [len(component.samples) for component in self.components]
        return np.cumsum([0, *sizes]).tolist()

    def _component_rows(self, index: int, epoch: int) -> Rows:
        return self._offsets[index] + self.components[index].draw(self.seed, epoch)

    def _epoch_rows(self, epoch: int, batch_size: int) -> Rows:
        """Rows of `_samples` (items,) in the order of training."""
        counts = batch_counts(self.counts, batch_size)
        owners = np.repeat(np.tile(np.arange(counts.shape[1]), len(counts)), counts.ravel())
        batches = np.repeat(np.arange(len(counts)), counts.sum(axis=1))
        shuffle = make_generator("mixture order", self.seed, epoch, batch_size).random(len(owners))
        owners = owners[np.lexsort((shuffle, batches))]
        rows = np.empty(len(owners), np.int64)
        for index in range(len(self.components)):
            rows[owners == index] = self._component_rows(index, epoch)
        return rows

    def _uses(self, epoch: int) -> Rows:
        drawn = [self._component_rows(index, epoch) for index in range(len(self.components))]
        return np.bincount(np.concatenate(drawn), minlength=len(self._samples))

    def _keys(self, rows: Rows) -> list[SampleKey]:
        columns = (self._samples[name].gather(rows).to_list() for name in KEY_COLUMNS)
        return [SampleKey(*key) for key in zip(*columns, strict=True)]


def compose_mixture(recipe: Recipe, table: pl.DataFrame, seed: int, held_out_scenes: Collection[str] = ()) -> Mixture:
    """Choose the samples of every component.

    Scenes that the recipe holds out are left out; scenes in `held_out_scenes` (those of a test, say) must not occur.

    Args:
        recipe: what to choose.
        table: clips to choose from (`olt_datasets.clip_table.read_clip_tables`).
        seed: seed of the choice and of every order.
        held_out_scenes: scene ids that the mixture is checked against.

    Raises:
        InputError: a component has too few samples, two components share a clip, or the mixture leaks.
    """
    selections = select_clips(recipe, table)
    shortages = find_shortages(recipe, table, selections)
    if shortages:
        raise InputError(shortages[0])
    leaks = _find_leaks(recipe, table, selections, held_out_scenes)
    if leaks:
        raise InputError(
            f"recipe {recipe.name} leaks: {summarize_leaks(leaks)}; add these scenes to the recipe's held_out_scenes"
        )
    counts = plan_counts(recipe, selections)
    components = [
        _draw_samples(selection, asked, got, seed)
        for selection, asked, got in zip(selections, _asked(recipe, counts), counts, strict=True)
    ]
    return Mixture(recipe, seed, table_checksum(table), tuple(components))


def check_recipe(recipe: Recipe, table: pl.DataFrame, held_out_scenes: Collection[str] = ()) -> dict[str, list[str]]:
    """Why `compose_mixture` would refuse (`shortages`, `leaks`), and words in filters that no clip has (`absent`).

    Raises:
        InputError: two components select the same clip.
    """
    selections = select_clips(recipe, table)
    return {
        "shortages": find_shortages(recipe, table, selections),
        "leaks": [str(leak) for leak in _find_leaks(recipe, table, selections, held_out_scenes)],
        "absent": find_absent_words(recipe, table),
    }


@dataclass(frozen=True)
class TrainingArithmetic:
    """Steps of a training run, counted as Hugging Face's Trainer does with `drop_last` off.

    Attributes:
        samples: samples of the mixture.
        global_batch: samples per optimizer step.
        steps_per_epoch, total_steps: optimizer steps.
        samples_per_epoch: samples that the steps of an epoch have room for.
        padded_samples: the part of that room which the mixture does not fill.
    """

    samples: int
    global_batch: int
    steps_per_epoch: int
    total_steps: int
    samples_per_epoch: int
    padded_samples: int

    def to_dict(self) -> dict[str, int]:
        """The attributes by name."""
        return asdict(self)


def training_arithmetic(
    samples: int, devices: int, per_device_batch: int, accumulation: int, epochs: int
) -> TrainingArithmetic:
    """Steps and samples of a training run (facts sheet paper_notes, section SFT arithmetic).

    Args:
        samples: samples of the mixture.
        devices: number of processes that train.
        per_device_batch: samples per device and forward pass.
        accumulation: forward passes per optimizer step.
        epochs: passes over the mixture.
    """
    global_batch = devices * per_device_batch * accumulation
    steps = math.ceil(samples / global_batch)
    room = steps * global_batch
    return TrainingArithmetic(samples, global_batch, steps, epochs * steps, room, room - samples)


def _find_leaks(
    recipe: Recipe, table: pl.DataFrame, selections: Sequence[Selection], held_out_scenes: Collection[str]
) -> list[Leak]:
    chosen = pl.concat([selection.clips for selection in selections])
    return find_leaks(chosen, table, recipe.split, [*recipe.held_out_scenes, *held_out_scenes])


def _asked(recipe: Recipe, counts: Sequence[int]) -> list[float]:
    if recipe.components[0].share is None:
        return [float(count) for count in counts]
    return [float(share * sum(counts)) for share in exact_shares(recipe)]


def _draw_samples(selection: Selection, asked: float, got: int, seed: int) -> MixtureComponent:
    clips = selection.clips
    samples = explode_samples(clips.select(pl.int_range(pl.len()).alias("clip"), "sample_t0_us"))
    order = make_generator("mixture samples", seed, selection.component.name).permutation(len(samples))
    samples = samples[np.sort(order[:got])]
    chosen = clips.select("store", "clip_id", *GROUPS)[samples["clip"]]
    chosen = chosen.with_columns(samples["t0_us"]).select(*KEY_COLUMNS, *GROUPS)
    return MixtureComponent(selection.component, asked, got, selection.available, chosen)


def _check_slice(epoch: int, batch_size: int, rank: int, world_size: int, start_batch: int) -> None:
    if batch_size < 1 or world_size < 1 or batch_size % world_size:
        raise InputError(f"global batch size {batch_size} must be a multiple of the world size {world_size}")
    if not 0 <= rank < world_size:
        raise InputError(f"rank {rank} must be 0 to {world_size - 1}, as the world size is {world_size}")
    if epoch < 0 or start_batch < 0:
        raise InputError(f"epoch {epoch} and start batch {start_batch} must not be negative")


def _describe_component(part: MixtureComponent) -> dict[str, Any]:
    return {
        "name": part.component.name,
        "where": part.component.where.model_dump(mode="json", exclude_defaults=True),
        "share": part.component.share,
        "asked": part.asked,
        "got": part.got,
        "available": part.available,
        "distinct": len(part.samples),
        "repeats": math.ceil(part.got / len(part.samples)),
    }


def _describe_group(values: pl.Series, uses: Rows) -> dict[str, dict[str, int]]:
    table = pl.DataFrame({"value": values, "got": uses}).group_by("value").agg(pl.col("got").sum(), distinct=pl.len())
    return {value: {"got": got, "distinct": distinct} for value, got, distinct in table.sort("value").iter_rows()}
