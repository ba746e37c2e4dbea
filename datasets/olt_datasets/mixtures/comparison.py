"""What differs between two composed mixtures: recipes, samples and shares."""

from collections.abc import Mapping
from typing import Any

import polars as pl

from olt_datasets.mixtures.mixture import GROUPS, Mixture

SAMPLE_KEY = ("clip_id", "t0_us")
"""What makes two samples the same; a store may move."""


def compare_mixtures(first: Mixture, second: Mixture) -> dict[str, Any]:
    """What differs between two mixtures, as a JSON-able object of the pairs (first, second).

    `recipe` lists the keys whose values differ, `samples` and `components` count the distinct samples of both, of the
    first only and of the second only, and the shares are those of the items of epoch 0.
    """
    before, after = first.describe(), second.describe()
    return {
        "recipes": [first.recipe.name, second.recipe.name],
        "seeds": [first.seed, second.seed],
        "samples_per_epoch": [len(first), len(second)],
        "recipe": _differing_keys(first, second),
        "samples": _count_samples(first.samples, second.samples),
        "components": _compare_components(first, second),
        **{f"by_{group}": _compare_shares(before, after, f"by_{group}") for group in GROUPS},
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


def _compare_components(first: Mixture, second: Mixture) -> dict[str, dict[str, int]]:
    parts = [{part.component.name: part.samples for part in mixture.components} for mixture in (first, second)]
    nothing = pl.DataFrame(schema={"clip_id": pl.String, "t0_us": pl.Int64})
    names = dict.fromkeys([*parts[0], *parts[1]])
    return {name: _count_samples(*(part.get(name, nothing) for part in parts)) for name in names}


def _compare_shares(before: Mapping[str, Any], after: Mapping[str, Any], group: str) -> dict[str, list[float]]:
    def shares(summary: Mapping[str, Any], value: str) -> float:
        items = summary[group].get(value, {"got": 0})["got"]
        return items / max(summary["samples_per_epoch"], 1)

    values = sorted({*before[group], *after[group]})
    return {value: [shares(before, value), shares(after, value)] for value in values}


def _differing_keys(first: Mixture, second: Mixture) -> dict[str, list[Any]]:
    before, after = (_flatten(_by_name(mixture.recipe.model_dump(mode="json"))) for mixture in (first, second))
    keys = dict.fromkeys([*before, *after])
    return {key: [before.get(key), after.get(key)] for key in keys if before.get(key) != after.get(key)}


def _by_name(recipe: dict[str, Any]) -> dict[str, Any]:
    return recipe | {"components": {component["name"]: component for component in recipe["components"]}}


def _flatten(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat = {}
    for key, value in values.items():
        flat |= _flatten(value, f"{prefix}{key}.") if isinstance(value, dict) and value else {f"{prefix}{key}": value}
    return flat
