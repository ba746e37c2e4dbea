"""The whole closed loop without cameras: as many rollouts as the paper simulates, with gate and scores."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from olt_closed_loop.evaluation.evaluation import Result, run_closed_loop
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_toolkit.bench.benchmark import Benchmark, Setting

SCENES, ROLLOUTS = 53, 2
DURATION_US = 20_000_000
DEFAULT = "2 processes"

_EVERYTHING = SimulationSettings(skip=False)
_REFERENCE = SimulationSettings(skip=False, integrator="cvodes")


@lru_cache(maxsize=1)
def make_scenes() -> tuple[Scene, ...]:
    """The scenes, the categories in turn."""
    return tuple(generate_scene(CATEGORIES[index % len(CATEGORIES)], index, DURATION_US) for index in range(SCENES))


def _run(settings: SimulationSettings, workers: int) -> list[Result]:
    return run_closed_loop(make_scenes(), "route", ROLLOUTS, settings=settings, workers=workers)


def _prepare(settings: SimulationSettings, workers: int) -> Callable[[], list[Result]]:
    make_scenes()
    return lambda: _run(settings, workers)


def _settings() -> Sequence[Setting]:
    return [
        Setting(DEFAULT, lambda: _prepare(SimulationSettings(), 2), default=True),
        Setting("1 process", lambda: _prepare(SimulationSettings(), 1)),
        Setting("2 processes, nothing left out", lambda: _prepare(_EVERYTHING, 2)),
    ]


@lru_cache(maxsize=1)
def _reference() -> list[Result]:
    return _run(_REFERENCE, 2)


def _measure_error(results: list[Result]) -> float:
    """Largest distance between the ego's positions and those of the reference, metres."""
    pairs = zip(results, _reference(), strict=True)
    return max(
        float(np.linalg.norm(ours.states[:, :2] - exact.states[:, :2], axis=1).max()) for (ours, _), (exact, _) in pairs
    )


BENCHMARK = Benchmark(
    name="rollouts",
    title=f"{SCENES * ROLLOUTS} rollouts of 20 s in {SCENES} scenes with the route policy, gate and scores included",
    error_name="largest deviation of the ego",
    error_unit="m",
    reference="the same rollouts with the vehicle integrated by CVODES and nothing left out",
    settings=_settings,
    measure_error=_measure_error,
)
