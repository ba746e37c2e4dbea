"""The whole closed loop without cameras: as many rollouts as the paper simulates, with gate and scores."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np

from olt_closed_loop.evaluation.evaluation import Result, run_closed_loop
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_toolkit.bench.benchmark import Benchmark, Setting

SCENES, ROLLOUTS = 53, 2
DURATION_US = 20_000_000


@lru_cache(maxsize=1)
def make_scenes() -> tuple[Scene, ...]:
    """The scenes, the categories in turn."""
    return tuple(generate_scene(CATEGORIES[index % len(CATEGORIES)], index, DURATION_US) for index in range(SCENES))


def _prepare(workers: int = 2, **settings: Any) -> Callable[[], list[Result]]:
    return partial(
        run_closed_loop, make_scenes(), "route", ROLLOUTS, settings=SimulationSettings(**settings), workers=workers
    )


@lru_cache(maxsize=1)
def reference_results() -> list[Result]:
    """The same rollouts by CVODES with nothing left out."""
    return _prepare(skip=False, integrator="cvodes")()


def _measure_error(results: list[Result]) -> float:
    """Largest distance between the ego's positions and those of the reference, metres."""
    pairs = zip(results, reference_results(), strict=True)
    return max(
        float(np.linalg.norm(ours.states[:, :2] - exact.states[:, :2], axis=1).max()) for (ours, _), (exact, _) in pairs
    )


BENCHMARK = Benchmark(
    title=f"{SCENES * ROLLOUTS} rollouts of 20 s in {SCENES} scenes with the route policy, gate and scores included",
    error_name="largest deviation of the ego",
    error_unit="m",
    reference="the same rollouts with the vehicle integrated by CVODES and nothing left out",
    settings=lambda: [
        Setting("2 processes", _prepare, default=True),
        Setting("1 process", partial(_prepare, workers=1)),
        Setting("2 processes, nothing left out", partial(_prepare, skip=False)),
    ],
    measure_error=_measure_error,
)
