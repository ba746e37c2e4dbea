"""Mixtures: how far batches are from the share that was asked for, and what composing takes at ten million clips."""

import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from olt_datasets import Mixture, MixtureBatchSampler, compose_mixture, scan_clip_tables
from olt_datasets.mixtures.recipe import parse_recipe
from olt_datasets.tables.fake_table import write_fake_table
from olt_generator.seeds import derive_seed
from olt_toolkit.bench.benchmark import Benchmark, Grid, Setting
from olt_toolkit.bench.runner import resident_mib

BATCH_SIZE = 32
SHARE = 0.3
BATCHES = 10_000
SAMPLES = BATCHES * BATCH_SIZE
SCALES = (10_000, 1_000_000, 10_000_000)

Counts = NDArray[np.int64]


def _compose(table: Path, **content: Any) -> Mixture:
    recipe = parse_recipe({"name": "benchmark", "description": "", "version": 1, **content}, "benchmark")
    return compose_mixture(recipe, scan_clip_tables([table]), seed=0, allow_uncompared=True)


def _prepare_mixture() -> Callable[[], Counts]:
    """As many samples as an epoch has, 30 % of them synthesized: each is used once."""
    parts = [
        {"name": "nominal", "where": {"kind": "GT"}, "share": 1.0 - SHARE},
        {"name": "long_tail", "where": {"kind": "Syn"}, "share": SHARE},
    ]
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "clips.parquet"
        write_fake_table(table, SAMPLES)
        mixture = _compose(table, components=parts, samples=SAMPLES)
    synthesized = (mixture.samples["kind"] == "Syn").to_numpy()
    batches = MixtureBatchSampler(mixture, BATCH_SIZE)

    def count() -> Counts:
        batches.set_epoch(0)
        return np.array([synthesized[batch].sum() for batch in batches])

    return count


def _prepare_torch(weighted: bool) -> Callable[[], Counts]:
    """What is commonly done: all samples in random order, or weighted so that each group has its share in the mean."""
    import torch
    from torch.utils.data import BatchSampler, RandomSampler, WeightedRandomSampler

    synthesized = np.arange(SAMPLES) < round(SHARE * SAMPLES)
    weights = np.where(synthesized, SHARE / synthesized.sum(), (1.0 - SHARE) / (~synthesized).sum())
    generator = torch.Generator()

    def count() -> Counts:
        generator.manual_seed(derive_seed("mixture benchmark"))
        if weighted:
            sampler = WeightedRandomSampler(weights.tolist(), SAMPLES, replacement=True, generator=generator)
        else:
            sampler = RandomSampler(range(SAMPLES), generator=generator)
        batches = BatchSampler(sampler, BATCH_SIZE, drop_last=False)
        return np.array([synthesized[batch].sum() for batch in batches])

    return count


def _settings() -> Sequence[Setting]:
    return [
        Setting("MixtureBatchSampler", _prepare_mixture, default=True),
        Setting("torch RandomSampler", partial(_prepare_torch, weighted=False)),
        Setting("torch WeightedRandomSampler", partial(_prepare_torch, weighted=True)),
    ]


def _measure_composing(table: Path, clips: int) -> dict[str, Any]:
    """Time and memory of composing by a recipe in the shape of the paper's: one keyframe of each drive."""
    samples = min(10_000, clips // 20)
    nominal = {"kind": "GT", "source": ["pav"], "category": ["nominal"]}
    long_tail = {"kind": "Syn", "source": ["pav"], "category_not": ["nominal"]}
    start, start_of_processor = time.perf_counter(), time.process_time()
    mixture = _compose(
        table,
        components=[
            {"name": "nominal", "where": nominal, "count": samples, "t0": "keyframe"},
            {"name": "long_tail", "where": long_tail, "count": samples // 4, "t0": "keyframe"},
        ],
    )
    seconds, processor_seconds = time.perf_counter() - start, time.process_time() - start_of_processor
    peak_mib = resident_mib("VmHWM")
    return {
        "clips": clips,
        "samples": len(mixture),
        "seconds": round(seconds, 3),
        "processor_seconds": round(processor_seconds, 3),
        "peak_memory_mib": None if peak_mib is None else round(peak_mib),
    }


def _grid() -> Grid:
    counts = {setting.name: setting.prepare()() for setting in _settings()}
    batches = [
        {"setting": name, "fewest": int(found.min()), "most": int(found.max()), "mean": float(found.mean())}
        for name, found in counts.items()
    ]
    scales = []
    for clips in SCALES:
        with tempfile.TemporaryDirectory() as folder:
            table = Path(folder) / "clips.parquet"
            write_fake_table(table, clips)
            # A process of its own, so that its peak memory is that of composing.
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                scales.append(pool.submit(_measure_composing, table, clips).result())
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
    title=f"An epoch of {BATCHES:,} batches of {BATCH_SIZE}, of which a share of {SHARE} is synthesized",
    error_name="largest distance of a batch from its share",
    error_unit="items",
    reference=f"{SHARE} x {BATCH_SIZE} = {SHARE * BATCH_SIZE:g} items in every batch",
    settings=_settings,
    measure_error=lambda counts: float(np.abs(counts - SHARE * BATCH_SIZE).max()),
    grid=_grid,
)
