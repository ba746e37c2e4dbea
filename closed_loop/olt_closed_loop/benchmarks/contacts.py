"""Contacts: how far the time of the first contact is off when motion is sampled coarsely, by definition."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from olt_closed_loop.benchmarks.score_drives import DURATION_US, HANDOVER_US, known_drives
from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scoring.alpasim.surroundings import Surroundings, measure_contact
from olt_closed_loop.scoring.contacts import first_contacts
from olt_closed_loop.scoring.moving_boxes import agent_box, ego_box
from olt_generator.poses import Array
from olt_toolkit.bench.benchmark import Benchmark, Setting

DRIVES = 40
STEPS_MS = (500, 200, 100, 50, 20)
DEFAULT = "continuous, 100 ms"


def continuous_contact(record: RolloutRecord) -> float:
    """First contact in microseconds by `scoring.contacts`; infinite if there is none."""
    boxes = [agent_box(agent) for agent in record.agents]
    return HANDOVER_US + float(first_contacts(ego_box(record), boxes, HANDOVER_US, DURATION_US).min())


def sampled_contact(record: RolloutRecord) -> float:
    """The first sample in microseconds at which AlpaSim's outlines touch; infinite if there is none."""
    series = measure_contact(Surroundings(record))["collision_any"].within(HANDOVER_US, DURATION_US)
    touching = series.times_us[series.values > 0.0]
    return float(touching[0]) if len(touching) else np.inf


_FINDERS: dict[str, Callable[[RolloutRecord], float]] = {"continuous": continuous_contact, "alpasim": sampled_contact}


@lru_cache(maxsize=1)
def reference_contacts() -> Array:
    """Contact times (drives,) in microseconds on the exact motion."""
    return np.array([drive.contact_us() for drive in known_drives(DRIVES)])


def _prepare(finder: str, step_ms: int) -> Callable[[], Array]:
    records = [drive.sampled(1000 * step_ms) for drive in known_drives(DRIVES)]
    return lambda: np.array([_FINDERS[finder](record) for record in records])


def _settings() -> Sequence[Setting]:
    return [
        Setting(
            f"{finder}, {step_ms} ms",
            lambda finder=finder, step_ms=step_ms: _prepare(finder, step_ms),
            default=f"{finder}, {step_ms} ms" == DEFAULT,
        )
        for finder in _FINDERS
        for step_ms in STEPS_MS
    ]


def _measure_error(contacts: Array) -> float:
    """Mean error in seconds; a contact that is missed or invented counts as one second."""
    found, real = np.isfinite(contacts), np.isfinite(reference_contacts())
    errors = np.where(found == real, 0.0, 1.0)
    both = found & real
    errors[both] = np.minimum(np.abs(contacts[both] - reference_contacts()[both]) * 1e-6, 1.0)
    return float(errors.mean())


BENCHMARK = Benchmark(
    name="contacts",
    title=f"First contact in {DRIVES} drives of 8 s with one agent each, sampled at different steps",
    error_name="mean error of the contact time",
    error_unit="s",
    reference="outlines (shapely) bisected to 1 us on the exact motion; a missed contact counts as 1 s",
    settings=_settings,
    measure_error=_measure_error,
)
