"""Scoring in traffic: what one rollout of 20 s among 20 or 60 vehicles costs, by definition."""

from collections.abc import Callable, Sequence

from olt_closed_loop.benchmarks.score_drives import HANDOVER_US, crowded_drive
from olt_closed_loop.scoring.definitions import DEFINITIONS, Definition, score_record
from olt_toolkit.bench.benchmark import Benchmark, Setting

AGENTS = (20, 60)
DEFAULT = "strict, 20 agents"

_NEAREST: dict[Definition, str] = {
    "strict": "min_distance_to_agents_m",
    "alpasim": "min_distance_to_obstacle_m",
}
"""What each definition calls the smallest distance to an agent."""


def _prepare(definition: Definition, count: int) -> Callable[[], tuple[int, float]]:
    record = crowded_drive(count).record()
    return lambda: (count, float(score_record(record, definition).metrics[_NEAREST[definition]] or 0.0))


def _settings() -> Sequence[Setting]:
    return [
        Setting(
            f"{definition}, {count} agents",
            lambda definition=definition, count=count: _prepare(definition, count),
            default=f"{definition}, {count} agents" == DEFAULT,
        )
        for definition in DEFINITIONS
        for count in AGENTS
    ]


def _measure_error(result: tuple[int, float]) -> float:
    count, nearest_m = result
    return abs(nearest_m - crowded_drive(count).nearest_m(HANDOVER_US))


BENCHMARK = Benchmark(
    name="score_traffic",
    title="Scoring one rollout of 20 s, with a plan every 0.1 s, among vehicles on a busy road",
    error_name="error of the smallest distance to an agent",
    error_unit="m",
    reference="distance of the exact outlines (shapely), every millisecond",
    settings=_settings,
    measure_error=_measure_error,
)
