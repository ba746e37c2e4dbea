"""Numbers that say how good a sample is: shares of its pixels, noise of its labels, error in the action space.

Limits and weights of recipes go by them, and a composed mixture tells what it has. All are such that more is worse, but
for the observed share. What was not measured is null, never 0.
"""

from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.mixtures.recipe import Component, Filter
from olt_toolkit.policy.action_space import ROUND_TRIP_TOLERANCE

TIMES, ERRORS = pl.col("sample_t0_us"), pl.col("action_errors")
SAMPLE_QUALITIES = ("observed_share", "invented_share", "acceleration_noise", "action_error")
"""Columns of samples."""

_UNSEEN = (1.0 - pl.col("observed_share") - pl.col("invented_share")).clip(lower_bound=0.0)
_OF_SAMPLES = {
    "observed_share": pl.col("observed_share"),
    "invented_share": pl.col("invented_share"),
    "unseen_share": _UNSEEN,
    "acceleration_noise": pl.col("acceleration_noise"),
    "action_error": pl.col("action_error"),
}
# Of clips the errors of all samples stand in one list: it is there or not.
_OF_CLIPS = _OF_SAMPLES | {"action_error": ERRORS}


def within_limits(where: Filter) -> pl.Expr:
    """Whether a clip keeps the limits of a filter; those of single samples are kept by `usable_places`."""
    conditions = [pl.lit(True)]
    for field, limit in where.limits.items():
        name, _, end = field.rpartition("_")
        number = _OF_CLIPS[name]
        if name == "action_error":
            keeps = pl.when(number.is_not_null()).then(True)
        else:
            keeps = number >= limit if end == "min" else number <= limit
        conditions.append(keeps.fill_null(where.not_measured == "take"))
    return pl.all_horizontal(conditions)


def is_weighable(component: Component) -> pl.Expr:
    """Whether a clip has the numbers by which the component weighs, or needs none."""
    if component.where.not_measured == "take":
        return pl.lit(True)
    return pl.all_horizontal(pl.lit(True), *(_OF_CLIPS[name].is_not_null() for name in component.weight_by))


def lacks_number(component: Component) -> pl.Expr:
    """Whether a number by which the component limits or weighs was not measured of a clip."""
    names = {field.rpartition("_")[0] for field in component.where.limits} | set(component.weight_by)
    return pl.any_horizontal(pl.lit(False), *(_OF_CLIPS[name].is_null() for name in sorted(names)))


def usable_places(where: Filter) -> pl.Expr:
    """Places (list) in `sample_t0_us` of the samples that keep the limits of a filter."""
    every = pl.int_ranges(0, TIMES.list.len(), dtype=pl.UInt32)
    if where.action_error_max is None:
        return every
    kept = ERRORS.list.eval((pl.element() <= where.action_error_max).arg_true())
    return pl.when(ERRORS.is_null()).then(every).otherwise(kept)


def halvings(component: Component) -> pl.Expr:
    """By how many halvings the weight of a sample is below 1; a number that was not measured halves nothing."""
    parts = [(_OF_SAMPLES[name] / amount).fill_null(0.0) for name, amount in component.weight_by.items()]
    return pl.sum_horizontal(pl.lit(0.0), *parts)


def describe_quality(samples: pl.DataFrame, uses: NDArray[np.int64]) -> dict[str, dict[str, Any]]:
    """The mean of each number over items, `uses` (samples,) of each sample, and how many items it is not known of."""
    told = {}
    for name, expression in _OF_SAMPLES.items():
        values = samples.select(expression.alias(name)).to_series().to_numpy()
        known = ~np.isnan(values)
        count = int(uses[known].sum())
        told[name] = {
            "mean": float(values[known] @ uses[known] / count) if count else None,
            "not_measured": int(uses.sum()) - count,
        }
        if name == "action_error":
            told[name]["beyond_tolerance"] = int(uses[known & (values > ROUND_TRIP_TOLERANCE)].sum())
    return told


def word_quality(name: str, told: dict[str, Any]) -> str:
    """One number of `describe_quality` for people."""
    if told["mean"] is None:
        return "not measured"
    unit = {"acceleration_noise": "m/s2", "action_error": "m"}.get(name)
    text = f"{told['mean']:.1%}" if unit is None else f"{told['mean']:.3f} {unit}"
    if told.get("beyond_tolerance"):
        text += f", {told['beyond_tolerance']} beyond {ROUND_TRIP_TOLERANCE:g} m"
    return text + (f", {told['not_measured']} not measured" if told["not_measured"] else "")


def word_not_measured(clips: int, where: dict[str, Any]) -> str:
    """What became of the clips that lack a number which a component asks for."""
    became = "taken" if where.get("not_measured") == "take" else "left out"
    return f"{clips} clips were {became}, of which a number that it asks for was not measured"
