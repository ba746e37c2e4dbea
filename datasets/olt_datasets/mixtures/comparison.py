"""What differs between two composed mixtures: recipes, samples and shares."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import polars as pl

from olt_datasets.mixtures.mixture import GROUPS, Mixture
from olt_datasets.mixtures.recipe import Recipe

SAMPLE_KEY = ("clip_id", "t0_us")
"""What makes two samples the same; a store may move."""


def compare_mixtures(first: Mixture, second: Mixture) -> dict[str, Any]:
    """What differs between two mixtures, as a JSON-able object of the pairs (first, second).

    `recipe` lists the keys whose values differ, `samples` and `components` count the distinct samples of both, of the
    first only and of the second only, and the shares and means of `quality` are those of the items of epoch 0.
    """
    described = [(mixture.describe(), len(mixture)) for mixture in (first, second)]
    shares = {
        name: [{value: uses["got"] / items for value, uses in summary[name].items()} for summary, items in described]
        for name in (f"by_{group}" for group in GROUPS)
    }
    parts = [{part.component.name: part.samples for part in mixture.components} for mixture in (first, second)]
    asked = _pair([_flatten(mixture.recipe) for mixture in (first, second)], None)
    return {
        "recipes": [first.recipe.name, second.recipe.name],
        "seeds": [first.seed, second.seed],
        "samples_per_epoch": [len(first), len(second)],
        "recipe": {key: values for key, values in asked.items() if values[0] != values[1]},
        "samples": _count_samples(first.samples, second.samples),
        "components": {name: _count_samples(*samples) for name, samples in _pair(parts, first.samples.clear()).items()},
        "quality": {
            name: [summary["quality"][name]["mean"] for summary, _ in described] for name in described[0][0]["quality"]
        },
        **{name: dict(sorted(_pair(both, 0.0).items())) for name, both in shares.items()},
    }


def differing_samples(first: Mixture, second: Mixture) -> pl.DataFrame:
    """The samples that only one of two mixtures uses, with `mixture` ("first" or "second") in front."""
    sides = {"first": (first.samples, second.samples), "second": (second.samples, first.samples)}
    only = [
        own.join(other, on=SAMPLE_KEY, how="anti", maintain_order="left").select(pl.lit(side).alias("mixture"), "*")
        for side, (own, other) in sides.items()
    ]
    return pl.concat(only)


def _count_samples(first: pl.DataFrame, second: pl.DataFrame) -> dict[str, int]:
    both = len(first.join(second, on=SAMPLE_KEY, how="semi"))
    return {"both": both, "only_first": len(first) - both, "only_second": len(second) - both}


def _pair(both: Sequence[Mapping[str, Any]], absent: Any) -> dict[str, list[Any]]:
    """The values of both by key, with `absent` where there is none."""
    return {key: [values.get(key, absent) for values in both] for key in {**both[0], **both[1]}}


def _flatten(recipe: Recipe) -> dict[str, Any]:
    """The values of a recipe by their paths, such as `components.nominal.share`."""

    def flatten(values: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
        for key, value in values.items():
            if isinstance(value, dict) and value:
                yield from flatten(value, f"{prefix}{key}.")
            else:
                yield f"{prefix}{key}", value

    values = recipe.model_dump(mode="json")
    return dict(flatten(values | {"components": {part["name"]: part for part in values["components"]}}, ""))
