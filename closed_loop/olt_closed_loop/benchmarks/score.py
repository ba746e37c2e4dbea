"""Scoring: how far scores and times of contact are off when a drive is sampled coarsely, and what scoring costs."""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from itertools import product

import numpy as np

from olt_closed_loop.benchmarks.score_drives import DURATION_US, HANDOVER_US, crowded_drive, in_town, known_drives
from olt_closed_loop.evaluation.score_table import summarize_scores
from olt_closed_loop.rollouts.rollout_record import PLAN_STEP_US, RolloutRecord
from olt_closed_loop.scoring.alpasim.surroundings import Surroundings, measure_contact
from olt_closed_loop.scoring.contacts import first_contacts
from olt_closed_loop.scoring.definitions import DEFINITIONS, Definition, score_record
from olt_closed_loop.scoring.moving_boxes import agent_box, ego_box
from olt_closed_loop.situations.table import SITUATIONS, contact_of
from olt_generator.poses import Array
from olt_toolkit.bench.benchmark import Benchmark, Setting

DRIVES = 40
REFERENCE_STEP_US = 1000
CROWDS = (20, 60)

Measure = Callable[[Sequence[RolloutRecord]], Array]
"""Of drives: AS and CR (2,), or the time of the first contact (drives,) in microseconds, infinite if there is none."""


def average_scores(records: Sequence[RolloutRecord], definition: Definition) -> Array:
    """AS and CR (2,) of drives."""
    row = summarize_scores([score_record(record, definition) for record in records]).overall
    return np.array([row.alpasim_score, row.collision_rate], dtype=np.float64)


@lru_cache(maxsize=1)
def reference_average() -> Array:
    """AS (strict, at 1 kHz) and CR (outlines bisected on the exact motion), (2,), of the drives."""
    drives = known_drives(DRIVES)
    collided = sum(bool(np.isfinite(drive.contact_us())) for drive in drives) / len(drives)
    score, _ = average_scores([drive.sampled(REFERENCE_STEP_US) for drive in drives], "strict")
    return np.array([score, collided], dtype=np.float64)


def continuous_contact(record: RolloutRecord) -> float:
    """First contact in microseconds by `scoring.contacts`; infinite if there is none."""
    boxes = [agent_box(agent) for agent in record.agents]
    return HANDOVER_US + float(first_contacts(ego_box(record), boxes, HANDOVER_US, DURATION_US).min())


def sampled_contact(record: RolloutRecord) -> float:
    """The first sample in microseconds at which AlpaSim's outlines touch; infinite if there is none."""
    series = measure_contact(Surroundings(record))["collision_any"].within(HANDOVER_US, DURATION_US)
    touching = series.times_us[series.values > 0.0]
    return float(touching[0]) if len(touching) else np.inf


@lru_cache(maxsize=1)
def reference_contacts() -> Array:
    """Contact times (drives,) in microseconds on the exact motion."""
    return np.array([drive.contact_us() for drive in known_drives(DRIVES)])


def _contact_error(contacts: Array) -> float:
    """Mean error in seconds; a contact that is missed or invented counts as one second."""
    with np.errstate(invalid="ignore"):  # where neither has a contact the difference of infinities is none
        errors = np.nan_to_num(1e-6 * np.abs(contacts - reference_contacts()))
    return float(np.minimum(errors, 1.0).mean())


def _sampled_settings(
    measures: Mapping[str, Measure], steps_ms: Mapping[str, Sequence[int]], default: str
) -> list[Setting]:
    """Each measure of the known drives, sampled at each of its steps; `default` at 100 ms is the default."""

    def prepare(measure: Measure, step_ms: int) -> Callable[[], Array]:
        return partial(measure, [drive.sampled(1000 * step_ms) for drive in known_drives(DRIVES)])

    return [
        Setting(f"{name}, {step_ms} ms", partial(prepare, measure, step_ms), default=(name, step_ms) == (default, 100))
        for name, measure in measures.items()
        for step_ms in steps_ms[name]
    ]


SCORE = Benchmark(
    title=f"Scoring {DRIVES} drives of 8 s with one agent each, sampled at different steps",
    error_name="larger error of AS and CR",
    error_unit="share",
    reference="CR: outlines (shapely) bisected to 1 us on the exact motion; AS: the definition strict at 1 kHz",
    settings=lambda: _sampled_settings(
        {definition: partial(average_scores, definition=definition) for definition in DEFINITIONS},
        {"strict": (500, 200, 100, 50, 20), **dict.fromkeys(DEFINITIONS[1:], (500, 200, 100, 50))},
        "strict",
    ),
    measure_error=lambda averages: float(np.abs(averages - reference_average()).max()),
)

CONTACTS = Benchmark(
    title=f"First contact in {DRIVES} drives of 8 s with one agent each, sampled at different steps",
    error_name="mean error of the contact time",
    error_unit="s",
    reference="outlines (shapely) bisected to 1 us on the exact motion; a missed contact counts as 1 s",
    settings=lambda: _sampled_settings(
        {
            "continuous": lambda records: np.array([continuous_contact(record) for record in records]),
            "alpasim": lambda records: np.array([sampled_contact(record) for record in records]),
        },
        dict.fromkeys(("continuous", "alpasim"), (500, 200, 100, 50, 20)),
        "continuous",
    ),
    measure_error=_contact_error,
)


def judge_sampled(step_us: int) -> Callable[[], list[bool | None]]:
    """Says of all situations, sampled every `step_us`, whether the ego is at fault; None: no contact."""
    records = [situation.record(step_us) for situation in SITUATIONS]
    return lambda: [hit.at_fault if (hit := contact_of(record)) else None for record in records]


def _share_wrong(verdicts: Sequence[bool | None]) -> float:
    right = [situation.at_fault for situation in SITUATIONS]
    return sum(said != known for said, known in zip(verdicts, right, strict=True)) / len(right)


FAULT = Benchmark(
    title=f"Whose fault the contacts of {len(SITUATIONS)} named situations are, sampled at different steps",
    error_name="share of wrong verdicts",
    error_unit="share",
    reference="whose fault each situation was made to be",
    settings=lambda: [
        Setting(f"{step_ms} ms", partial(judge_sampled, 1000 * step_ms), default=step_ms == 100)
        for step_ms in (500, 200, 100, 50, 20)
    ],
    measure_error=_share_wrong,
)


def _prepare_crowd(definition: Definition, count: int, town: bool = False) -> Callable[[], tuple[int, float]]:
    # What each definition calls the smallest distance to an agent.
    nearest = "min_distance_to_agents_m" if definition == "strict" else "min_distance_to_obstacle_m"
    record = crowded_drive(count).sampled(PLAN_STEP_US, with_plans=True)
    record = in_town(record) if town else record
    return lambda: (count, float(score_record(record, definition).metrics[nearest] or 0.0))


TRAFFIC = Benchmark(
    title="Scoring one rollout of 20 s, with a plan every 0.1 s, among vehicles on a busy road",
    error_name="error of the smallest distance to an agent",
    error_unit="m",
    reference="distance of the exact outlines (shapely), every millisecond",
    settings=lambda: (
        [
            Setting(f"{definition}, {count} agents", partial(_prepare_crowd, definition, count), default=not index)
            for index, (definition, count) in enumerate(product(DEFINITIONS, CROWDS))
        ]
        + [Setting("strict, 100 agents and the map of a town", partial(_prepare_crowd, "strict", 100, True))]
    ),
    measure_error=lambda result: abs(result[1] - crowded_drive(result[0]).nearest_m()),
)
