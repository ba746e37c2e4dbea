"""Scoring: how far AS and CR are off when a drive is sampled coarsely, and what scoring costs, by definition."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from olt_closed_loop.benchmarks.score_drives import known_drives
from olt_closed_loop.evaluation.score_table import summarize_scores
from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scoring.definitions import Definition, score_record
from olt_generator.poses import Array
from olt_toolkit.bench.benchmark import Benchmark, Setting

DRIVES = 40
REFERENCE_STEP_US = 1000
DEFAULT = ("strict", 100)

_STEPS_MS: dict[Definition, tuple[int, ...]] = {"strict": (500, 200, 100, 50, 20), "alpasim": (500, 200, 100, 50)}


def _average(records: Sequence[RolloutRecord], definition: Definition) -> Array:
    """AS and CR (2,) of drives."""
    row = summarize_scores([score_record(record, definition) for record in records]).overall
    return np.array([row.alpasim_score, row.collision_rate], dtype=np.float64)


@lru_cache(maxsize=1)
def reference_average() -> Array:
    """AS (strict, at 1 kHz) and CR (outlines bisected on the exact motion) of the drives."""
    drives = known_drives(DRIVES)
    collided = sum(bool(np.isfinite(drive.contact_us())) for drive in drives) / len(drives)
    score, _ = _average([drive.sampled(REFERENCE_STEP_US) for drive in drives], "strict")
    return np.array([score, collided], dtype=np.float64)


def _prepare(definition: Definition, step_ms: int) -> Callable[[], Array]:
    records = [drive.sampled(1000 * step_ms) for drive in known_drives(DRIVES)]
    return lambda: _average(records, definition)


def _settings() -> Sequence[Setting]:
    return [
        Setting(
            f"{definition}, {step_ms} ms",
            lambda definition=definition, step_ms=step_ms: _prepare(definition, step_ms),
            default=(definition, step_ms) == DEFAULT,
        )
        for definition, steps in _STEPS_MS.items()
        for step_ms in steps
    ]


def _measure_error(averages: Array) -> float:
    return float(np.abs(averages - reference_average()).max())


BENCHMARK = Benchmark(
    name="score",
    title=f"Scoring {DRIVES} drives of 8 s with one agent each, sampled at different steps",
    error_name="larger error of AS and CR",
    error_unit="share",
    reference="CR: outlines (shapely) bisected to 1 us on the exact motion; AS: the definition strict at 1 kHz",
    settings=_settings,
    measure_error=_measure_error,
)
