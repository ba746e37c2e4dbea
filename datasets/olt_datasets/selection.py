"""Which clips of a table each component of a recipe may use, and how many samples it is asked for."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import polars as pl

from olt_datasets.batches import epoch_counts
from olt_datasets.recipe import Component, Filter, Recipe
from olt_generator.errors import InputError


@dataclass(frozen=True)
class Selection:
    """The clips that one component may use.

    Attributes:
        component: the component of the recipe.
        clips: rows of the clip table, in its order.
        available: number of samples that the clips give.
    """

    component: Component
    clips: pl.DataFrame
    available: int

    @property
    def capacity(self) -> int:
        """The most items that the component can give to one epoch."""
        return self.available * self.component.repeats


def select_clips(recipe: Recipe, table: pl.DataFrame) -> list[Selection]:
    """Apply the filters of a recipe to the clips of its split.

    Raises:
        InputError: two components select the same clip, which would give it to an epoch twice.
    """
    held_out = pl.col("scene_id").is_in(recipe.held_out_scenes)
    table = table.with_row_index("row").filter((pl.col("split") == recipe.split) & ~held_out)
    selections = [_select(component, table) for component in recipe.components]
    _refuse_shared_clips(selections)
    return selections


def plan_counts(recipe: Recipe, selections: Sequence[Selection]) -> list[int]:
    """Items per epoch that each component is asked for.

    Shares without a number of samples give the largest epoch that no component is too small for.
    """
    counts = [component.count for component in recipe.components if component.count is not None]
    if counts:
        return counts
    shares = exact_shares(recipe)
    samples = recipe.samples
    if samples is None:
        room = (math.floor(selection.capacity / share) for selection, share in zip(selections, shares, strict=True))
        samples = min(room)
    return epoch_counts(shares, samples)


def exact_shares(recipe: Recipe) -> list[Fraction]:
    """The shares as the decimal fractions that the recipe says, summing to exactly 1."""
    shares = [Fraction(str(component.share)) for component in recipe.components]
    return [share / sum(shares) for share in shares]


def find_shortages(recipe: Recipe, table: pl.DataFrame, selections: Sequence[Selection]) -> list[str]:
    """One line for each component that cannot give what it is asked for, or is asked for nothing by its share."""
    counts = plan_counts(recipe, selections)
    shortages = []
    for selection, count in zip(selections, counts, strict=True):
        if count > selection.capacity or not selection.available:
            shortages.append(_describe_shortage(selection, count, recipe, table))
        elif count == 0 and all(other.available for other in selections):
            shortages.append(
                f"recipe {recipe.name}: share {selection.component.share:g} of {sum(counts)} samples per epoch gives "
                f"component {selection.component.name!r} none; ask for more samples or a larger share"
            )
    return shortages


def find_absent_words(recipe: Recipe, table: pl.DataFrame) -> list[str]:
    """One line for each source, category or factor that a filter names and no clip of the table has."""
    present = {
        "source": set(table["source"].unique()),
        "category": set(table["category"].unique()),
        "factors": set(table["factors"].explode(empty_as_null=False).unique()),
    }
    return [
        f"component {component.name!r}: where.{field}: no clip has {word!r}"
        for component in recipe.components
        for field, words in component.where.model_dump(exclude={"kind"}).items()
        for word in words
        if word not in present[field.partition("_")[0]]
    ]


def _select(component: Component, table: pl.DataFrame) -> Selection:
    clips = table.filter(_condition(component.where))
    if component.prefer is not None:
        preferred = pl.col("kind") == component.prefer
        clips = clips.filter(preferred | ~preferred.any().over("scene_id"))
    return Selection(component, clips, int(clips["sample_t0_us"].list.len().sum()))


def _condition(where: Filter) -> pl.Expr:
    kinds = ("GT", "Syn") if where.kind == "any" else (where.kind,)
    conditions = [pl.col("kind").is_in(kinds)]
    if where.source:
        conditions.append(pl.col("source").is_in(where.source))
    if where.category:
        conditions.append(pl.col("category").is_in(where.category))
    if where.category_not:
        conditions.append(~pl.col("category").is_in(where.category_not))
    if where.factors_any:
        conditions.append(pl.any_horizontal(_has_factor(name) for name in where.factors_any))
    if where.factors_none:
        conditions.append(~pl.any_horizontal(_has_factor(name) for name in where.factors_none))
    conditions.extend(_has_factor(name) for name in where.factors_all)
    return pl.all_horizontal(conditions)


def _has_factor(name: str) -> pl.Expr:
    return pl.col("factors").list.contains(name)


def _refuse_shared_clips(selections: Sequence[Selection]) -> None:
    rows = np.concatenate([selection.clips["row"].to_numpy() for selection in selections])
    unique, uses = np.unique(rows, return_counts=True)
    if not (uses > 1).any():
        return
    row = int(unique[uses > 1][0])
    both = [selection for selection in selections if row in selection.clips["row"]][:2]
    clip_id = both[0].clips.filter(pl.col("row") == row)["clip_id"].item()
    first, second = (selection.component for selection in both)
    raise InputError(
        f"clip {clip_id} is in component {first.name!r} {first.where} and in {second.name!r} {second.where}; "
        "change the filters so that no clip is in both"
    )


def _describe_shortage(selection: Selection, count: int, recipe: Recipe, table: pl.DataFrame) -> str:
    component = selection.component
    found = f"{len(selection.clips)} clips with {selection.available} samples"
    asked = f"{count} samples" if count else "samples"
    return (
        f"recipe {recipe.name}: component {component.name!r} {component.where} asks for {asked} per epoch, but matches "
        f"{found} (repeats {component.repeats}); split {recipe.split} holds {_summarize(recipe, table)}; "
        "change the filter, ask for fewer or allow more repeats"
    )


def _summarize(recipe: Recipe, table: pl.DataFrame) -> str:
    clips = table.filter(pl.col("split") == recipe.split)
    if clips.is_empty():
        return "no clips"
    groups = clips.group_by("kind", "category", "source").len().sort("kind", "category", "source")
    return ", ".join(f"{size} {kind} {category} from {source}" for kind, category, source, size in groups.iter_rows())
