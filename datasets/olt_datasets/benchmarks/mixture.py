"""Mixtures: how far batches are from the share that was asked for, and what composing takes at ten million clips."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.benchmarks.mixture_tables import compose_at_scale
from olt_datasets.mixtures.mixture import Mixture, compose_mixture
from olt_datasets.mixtures.recipe import parse_recipe
from olt_datasets.tables.clip_frame import SCHEMA
from olt_generator.seeds import derive_seed
from olt_toolkit.bench.benchmark import Benchmark, Grid, Setting

BATCH_SIZE = 32
SHARE = 0.3
BATCHES = 10_000
SAMPLES = BATCHES * BATCH_SIZE
SCALES = (10_000, 1_000_000, 10_000_000)

Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]


@lru_cache(maxsize=1)
def _mixture() -> Mixture:
    """As many samples as an epoch has, 30 % of them synthesized: each is used once."""
    number = pl.int_range(SAMPLES)
    values = {
        "clip_id": pl.format("{}-0000-5000-8000-000000000000", number.cast(pl.String).str.zfill(8)),
        "scene_id": number.cast(pl.String),
        "kind": pl.when(number < round(SHARE * SAMPLES)).then(pl.lit("Syn")).otherwise(pl.lit("GT")),
        "split": pl.lit("train"),
        "factors": pl.lit([], pl.List(pl.String)),
        "sample_t0_us": pl.lit([5_100_000]),
        "store": pl.lit("store"),
    }
    cells = {name: pl.lit("", dtype) if dtype == pl.String else pl.lit(None, dtype) for name, dtype in SCHEMA.items()}
    cells |= values
    parts = [
        {"name": "nominal", "where": {"kind": "GT"}, "share": 1.0 - SHARE},
        {"name": "long_tail", "where": {"kind": "Syn"}, "share": SHARE},
    ]
    content = {"name": "benchmark", "description": "", "version": 1, "samples": SAMPLES, "components": parts}
    return compose_mixture(
        parse_recipe(content, "benchmark"), pl.select([cell.alias(name) for name, cell in cells.items()]), seed=0
    )


def _prepare_mixture() -> Callable[[], Counts]:
    mixture = _mixture()
    synthesized = set(mixture.samples.filter(kind="Syn")["clip_id"])

    def count() -> Counts:
        batches = mixture.epoch(0, BATCH_SIZE)
        return np.array([sum(key.clip_id in synthesized for key in batch) for batch in batches])

    return count


def _prepare_torch(make_sampler: Callable[[Any, Flags], Any]) -> Callable[[], Counts]:
    import torch
    from torch.utils.data import BatchSampler

    synthesized = np.arange(SAMPLES) < round(SHARE * SAMPLES)
    generator = torch.Generator()

    def count() -> Counts:
        generator.manual_seed(derive_seed("mixture benchmark"))
        batches = BatchSampler(make_sampler(generator, synthesized), BATCH_SIZE, drop_last=False)
        return np.array([synthesized[batch].sum() for batch in batches])

    return count


def _weighted_sampler(generator: Any, synthesized: Flags) -> Any:
    """What is commonly done: every sample is weighted so that its group has its share in the mean."""
    from torch.utils.data import WeightedRandomSampler

    weights = np.where(synthesized, SHARE / synthesized.sum(), (1.0 - SHARE) / (~synthesized).sum())
    return WeightedRandomSampler(weights.tolist(), SAMPLES, replacement=True, generator=generator)


def _shuffling_sampler(generator: Any, synthesized: Flags) -> Any:
    """All samples in random order, of which the right share is synthesized."""
    from torch.utils.data import RandomSampler

    return RandomSampler(range(len(synthesized)), generator=generator)


def _settings() -> Sequence[Setting]:
    return [
        Setting("Mixture.epoch", _prepare_mixture, default=True),
        Setting("torch RandomSampler", lambda: _prepare_torch(_shuffling_sampler)),
        Setting("torch WeightedRandomSampler", lambda: _prepare_torch(_weighted_sampler)),
    ]


def _measure_error(counts: Counts) -> float:
    return float(np.abs(counts - SHARE * BATCH_SIZE).max())


def _grid() -> Grid:
    counts = {setting.name: setting.prepare()() for setting in _settings()}
    batches = [
        {"setting": name, "fewest": int(found.min()), "most": int(found.max()), "mean": float(found.mean())}
        for name, found in counts.items()
    ]
    scales = [compose_at_scale(clips) for clips in SCALES]
    summary = [
        f"{row['setting']}: {row['fewest']} to {row['most']} synthesized items a batch, {row['mean']:.3f} in the mean"
        for row in batches
    ] + [
        f"composing {row['samples']:,} samples from {row['clips']:,} clips: {row['seconds']:.1f} s "
        f"({row['processor_seconds']:.1f} s of processor), peak {row['peak_memory_mib']} MiB"
        for row in scales
    ]
    return Grid([*batches, *scales], summary)


BENCHMARK = Benchmark(
    name="mixture",
    title=f"An epoch of {BATCHES:,} batches of {BATCH_SIZE}, of which a share of {SHARE} is synthesized",
    error_name="largest distance of a batch from its share",
    error_unit="items",
    reference=f"{SHARE} x {BATCH_SIZE} = {SHARE * BATCH_SIZE:g} items in every batch",
    settings=_settings,
    measure_error=_measure_error,
    grid=_grid,
)
