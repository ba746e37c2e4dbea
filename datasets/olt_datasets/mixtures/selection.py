"""Which clips of a table each component of a recipe may use, and how many samples it is asked for.

Tables are scanned, never held: what is kept of ten million rows are counts.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import polars as pl

from olt_datasets.mixtures.draws import PRIORITY, draw_samples, sample_count
from olt_datasets.mixtures.quality import is_weighable, lacks_number, within_limits
from olt_datasets.mixtures.recipe import MOST_ITEMS, Component, Filter, Recipe
from olt_datasets.tables.scenes import refuse_unknown_scenes
from olt_generator.errors import InputError

ClipTable = pl.DataFrame | pl.LazyFrame

# Clips that agree in these show the same moments of the same scene, whatever their kind.
PAIR_COLUMNS = ("scene_id", "start_us", "end_us")

_IN_DOUBT = pl.col("doubts").list.len().fill_null(0) > 0


@dataclass(frozen=True)
class Selection:
    """The clips that one component may use, not yet read, and their number.

    They give so many samples in each capped category, before the cap, and so many in all others. `not_measured` counts
    clips that lack a number by which the component limits or weighs, and which its filter leaves out or takes for that.
    """

    component: Component
    clips: pl.LazyFrame
    clip_count: int
    capped_samples: dict[str, int]
    other_samples: int
    not_measured: int

    @property
    def available(self) -> int:
        """The most distinct samples that the component can give."""
        capped = (min(count, self.component.caps[category]) for category, count in self.capped_samples.items())
        return self.other_samples + sum(capped)

    @property
    def capacity(self) -> int:
        """The most items that the component can give to one epoch."""
        return self.available * self.component.repeats

    def draw(self, most: int, seed: int, columns: Collection[str]) -> pl.DataFrame:
        """The samples, if it gives at most so many items to an epoch: `columns` of the clips and `t0_us`, by clip."""
        count = min(most, self.available)
        category = pl.col("category")
        others = self.clips.filter(~category.is_in(list(self.component.caps)))
        pools = [(others, self.other_samples, count)] + [
            (self.clips.filter(category == name), available, min(count, self.component.caps[name]))
            for name, available in self.capped_samples.items()
        ]
        drawn = [
            draw_samples(clips, self.component, available, min(wanted, available), seed, tuple(columns))
            for clips, available, wanted in pools
        ]
        first = pl.concat(drawn).sort(PRIORITY, "clip_id", "t0_us", maintain_order=True).head(count)
        return first.sort("clip_id", "kind", "source", "store", "t0_us").drop(PRIORITY)


@dataclass(frozen=True)
class Shortage:
    """A component that cannot give what its recipe asks for, or whose share rounds to nothing.

    Its filter `where` matches clips with so many samples available, each of which may be used `repeats` times an epoch.

    Attributes:
        samples_per_epoch: items of all components together.
        asked: the most items that an epoch may ask of this one; 0 with clips available is a share that is always less
            than half an item.
        split_holds: number of clips of each kind, category and source in the split.
        doubtful: clips that its filter would match if it took those in doubt.
        not_measured: clips that it would match, but of which a number that it asks for was not measured.
    """

    recipe: str
    component: str
    where: str
    samples_per_epoch: int
    asked: int
    clips: int
    available: int
    repeats: int
    split: str
    split_holds: list[dict[str, Any]]
    doubtful: int
    not_measured: int


class AbsentValue(NamedTuple):
    """A value that a field of a component's filter, such as "category_not", names and no clip of the table has."""

    component: str
    field: str
    value: str


def select_clips(recipe: Recipe, table: ClipTable) -> list[Selection]:
    """The clips of its split that a recipe's filters match.

    Raises:
        InputError: two components would use the same clip, or the recipe holds out a scene that no clip shows.
    """
    refuse_unknown_scenes(table, recipe.held_out_scenes, f"recipe {recipe.name}: held_out_scenes")
    held_out = pl.col("scene_id").is_in(recipe.held_out_scenes)
    usable = table.lazy().filter((pl.col("split") == recipe.split) & ~held_out)
    marked = usable
    for component in recipe.components:
        marked = _mark(marked, component)
    used = [_used_by(component) for component in recipe.components]
    counts = [
        pl.concat_list(_counts(component)).alias(name) for component, name in zip(recipe.components, used, strict=True)
    ]
    shared = pl.sum_horizontal(pl.lit(0), *used) > 1
    *counted, first_shared = (
        marked.select(*counts, pl.col("clip_id").filter(shared).min()).collect(engine="streaming").row(0)
    )
    if first_shared is not None:
        both = marked.filter((pl.col("clip_id") == first_shared) & shared).select(used).collect().row(0)
        first, second = [component for component, uses in zip(recipe.components, both, strict=True) if uses][:2]
        raise InputError(
            f"clip {first_shared} is in component {first.name!r} {first.where} and in {second.name!r} {second.where}; "
            "change the filters so that no clip is in both"
        )
    return [
        Selection(
            component,
            clips=_mark(usable, component).filter(name).drop(name),
            clip_count=clip_count,
            capped_samples=dict(zip(component.caps, capped, strict=True)),
            other_samples=other_samples,
            not_measured=not_measured,
        )
        for component, name, (clip_count, other_samples, not_measured, *capped) in zip(
            recipe.components, used, counted, strict=True
        )
    ]


def samples_per_epoch(recipe: Recipe, selections: Sequence[Selection]) -> int:
    """Items of an epoch: as the recipe says, else the most for which no component is too small in any epoch.

    InputError where they are more than `MOST_ITEMS`.
    """
    if not recipe.named_epochs:
        items = sum(component.count or 0 for component in recipe.components)
    elif recipe.samples is not None:
        items = recipe.samples
    else:
        items = _most_in_every_epoch(recipe, selections)
    if items > MOST_ITEMS:
        raise InputError(
            f"recipe {recipe.name}: an epoch would have {items} samples, more than {MOST_ITEMS}; give 'samples', or "
            "smaller counts or repeats"
        )
    return items


def _most_in_every_epoch(recipe: Recipe, selections: Sequence[Selection]) -> int:
    peaks = [(selection.capacity, share) for selection, share in zip(selections, _peak_shares(recipe), strict=True)]
    most = min(math.floor(capacity / share) for capacity, share in peaks)
    if all(asked <= capacity for asked, (capacity, _) in zip(most_items(recipe, most), peaks, strict=True)):
        return most
    # Room for what a component is owed from other epochs.
    return max(0, min(math.floor((capacity - 1) / share) for capacity, share in peaks))


def most_items(recipe: Recipe, samples: int) -> list[int]:
    """A bound of the items that each component gives to any epoch (see `EpochPlan`)."""
    if not recipe.named_epochs:
        return [component.count or 0 for component in recipe.components]
    # Between two named epochs shares only grow or only shrink.
    epochs = recipe.named_epochs if recipe.between_epochs == "steps" else range(recipe.named_epochs[-1] + 1)
    owes_fractions = any(samples * share % 1 for epoch in epochs for share in recipe.shares(epoch))
    carried = int(owes_fractions and len(recipe.components) > 2)
    return [math.ceil(samples * share) + carried for share in _peak_shares(recipe)]


def find_shortages(recipe: Recipe, table: ClipTable, selections: Sequence[Selection]) -> list[Shortage]:
    """Every component that cannot give what it is asked for, or is asked for nothing by its share."""
    samples = samples_per_epoch(recipe, selections)
    short = [
        (selection, count)
        for selection, count in zip(selections, _asked_items(recipe, samples), strict=True)
        if count > selection.capacity
        or not selection.available
        or (count == 0 and all(other.available for other in selections))
    ]
    if not short:
        return []
    columns = ("kind", "category", "source")
    clips = table.lazy().filter(pl.col("split") == recipe.split)
    groups = clips.group_by(columns).agg(clips=pl.len()).sort(columns).collect(engine="streaming").to_dicts()
    return [
        Shortage(
            recipe=recipe.name,
            component=selection.component.name,
            where=str(selection.component.where),
            samples_per_epoch=samples,
            asked=count,
            clips=selection.clip_count,
            available=selection.available,
            repeats=selection.component.repeats,
            split=recipe.split,
            split_holds=groups,
            doubtful=_count_doubtful(clips, selection.component.where),
            not_measured=selection.not_measured if selection.component.where.not_measured == "leave_out" else 0,
        )
        for selection, count in short
    ]


def word_shortage(shortage: Shortage) -> str:
    """One line for people."""
    start = f"recipe {shortage.recipe}: "
    if shortage.available and not shortage.asked:
        return (
            f"{start}the share of component {shortage.component!r} of {shortage.samples_per_epoch} samples per epoch "
            "gives it none in most epochs; ask for more samples or a larger share"
        )
    asked = f"{shortage.asked} samples" if shortage.asked else "samples"
    groups = [
        f"{group['clips']} {group['kind']} {group['category']} from {group['source']}" for group in shortage.split_holds
    ]
    left_out = f"; {shortage.doubtful} more match and are in doubt, `doubts: any` takes them"
    doubtful = left_out if shortage.doubtful else ""
    if shortage.not_measured:
        doubtful += (
            f"; of {shortage.not_measured} more a number that it asks for was not measured, `not_measured: take` takes "
            "them"
        )
    return (
        f"{start}component {shortage.component!r} {shortage.where} asks for {asked} per epoch, but matches "
        f"{shortage.clips} clips with {shortage.available} samples (repeats {shortage.repeats}); split "
        f"{shortage.split} holds {', '.join(groups) or 'no clips'}{doubtful}; change the filter, ask for fewer "
        "or allow more repeats"
    )


def find_absent_values(recipe: Recipe, table: ClipTable) -> list[AbsentValue]:
    """Every source, country, category or factor that a filter names and no clip of the table has."""
    columns = {name: pl.col(name) for name in ("source", "country", "category")}
    columns["factors"] = pl.col("factors").explode(empty_as_null=False)
    values = pl.collect_all([table.lazy().select(column.unique()) for column in columns.values()])
    present = {name: set(found.to_series()) for name, found in zip(columns, values, strict=True)}
    return [
        AbsentValue(component.name, field, value)
        for component in recipe.components
        for field, named in component.where.model_dump().items()
        if isinstance(named, tuple)
        for value in named
        if value not in present[field.partition("_")[0]]
    ]


def matches(where: Filter) -> pl.Expr:
    """Whether a clip satisfies a filter."""
    kinds = ("GT", "Syn") if where.kind == "any" else (where.kind,)
    conditions = [pl.col("kind").is_in(kinds)]
    for name in ("source", "country", "category"):
        if wanted := getattr(where, name):
            conditions.append(pl.col(name).is_in(wanted).fill_null(False))
    if where.category_not:
        conditions.append(~pl.col("category").is_in(where.category_not))
    if where.doubts == "none":
        conditions.append(~_IN_DOUBT)
    conditions.append(within_limits(where))
    has_factor = pl.col("factors").list.contains
    if where.factors_any:
        conditions.append(pl.any_horizontal(map(has_factor, where.factors_any)))
    return pl.all_horizontal(
        *conditions, *map(has_factor, where.factors_all), *(~has_factor(name) for name in where.factors_none)
    )


def _peak_shares(recipe: Recipe) -> list[Fraction]:
    """The largest share that each component has in any epoch."""
    return [max(shares) for shares in zip(*map(recipe.shares, recipe.named_epochs), strict=True)]


def _asked_items(recipe: Recipe, samples: int) -> list[int]:
    """The most items that each component is asked for, 0 where its share is always less than half an item."""
    asked = most_items(recipe, samples)
    if not recipe.named_epochs:
        return asked
    peaks = (samples * share for share in _peak_shares(recipe))
    return [count if 2 * peak >= 1 else 0 for count, peak in zip(asked, peaks, strict=True)]


def _mark(clips: pl.LazyFrame, component: Component) -> pl.LazyFrame:
    """Add a column that tells whether the component may use a clip."""
    matching, name = matches(component.where) & is_weighable(component), _used_by(component)
    if component.prefer is None:
        return clips.with_columns(matching.alias(name))
    preferred = pl.col("kind") == component.prefer
    pairs = clips.filter(matching & preferred).select(PAIR_COLUMNS).unique().with_columns(pl.lit(True).alias(name))
    paired = clips.join(pairs, on=PAIR_COLUMNS, how="left", maintain_order="left")
    return paired.with_columns((matching & (preferred | pl.col(name).is_null())).alias(name))


def _count_doubtful(clips: pl.LazyFrame, where: Filter) -> int:
    if where.doubts == "any":
        return 0
    all_that_match = matches(where.model_copy(update={"doubts": "any"}))
    return clips.filter(all_that_match & _IN_DOUBT).select(pl.len()).collect(engine="streaming").item()


def _used_by(component: Component) -> str:
    return f"used by {component.name}"


def _counts(component: Component) -> list[pl.Expr]:
    """Number of its clips, of their samples in categories without a cap, of clips that lack a number, and of samples in
    each capped category."""
    samples, category, used = sample_count(component), pl.col("category"), pl.col(_used_by(component))
    uncapped = ~category.is_in(list(component.caps))
    capped = [samples.filter(used & (category == name)).sum() for name in component.caps]
    lacking = (matches(component.where.without_limits()) & lacks_number(component)).sum()
    return [used.sum(), samples.filter(used & uncapped).sum(), lacking, *capped]
