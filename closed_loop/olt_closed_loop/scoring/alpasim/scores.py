"""From the samples of a drive to AlpaSim's metrics and scene score."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scoring.alpasim.plans import (
    ADE_HORIZONS,
    ade_name,
    measure_displacement,
    measure_plan_collisions,
    measure_plan_deviation,
    measure_safety_monitor,
)
from olt_closed_loop.scoring.alpasim.recording import measure_along_recording
from olt_closed_loop.scoring.alpasim.roads import measure_road
from olt_closed_loop.scoring.alpasim.series import MetricSeries, UnmeasuredError
from olt_closed_loop.scoring.alpasim.surroundings import Surroundings, measure_contact

MAX_PATH_DISTANCE = 4.0
FULL_PROGRESS = 0.8
SHORT_RECORDING = 5.0
FULL_DURATION_US = 20e6

Metrics = dict[str, MetricSeries]
Values = dict[str, float | None]

_FAMILIES: tuple[tuple[Callable[[Surroundings], Metrics], tuple[str, ...]], ...] = (
    (
        measure_contact,
        ("collision_any", "collision_front", "collision_lateral", "collision_rear", "min_distance_to_obstacle_m"),
    ),
    (
        measure_along_recording,
        (
            "dist_to_gt_location",
            "dist_to_gt_trajectory",
            "dist_traveled_m",
            "gt_dist_traveled_m",
            "progress",
            "progress_rel",
            "progress_rel_to_total",
        ),
    ),
    (measure_road, ("min_distance_to_lane_boundary_m", "offroad", "wrong_lane")),
    (measure_displacement, tuple(ade_name(horizon) for horizon in ADE_HORIZONS)),
    (measure_plan_deviation, ("plan_deviation",)),
    (measure_plan_collisions, ("open_loop_collision",)),
    (measure_safety_monitor, ("safety_monitor_triggered",)),
)
"""What measures which metrics; where one cannot be had, AlpaSim lacks the whole family."""


@dataclass(frozen=True)
class SceneScore:
    """AlpaSim's scene score; all None when a metric that it needs has no value."""

    score: float | None = None
    progress_score: float | None = None
    failure_reason: str | None = None
    passed: bool | None = None


@dataclass(frozen=True)
class AlpasimScores:
    """AlpaSim's values of one drive; None is its "no value".

    Attributes:
        raw: every metric folded over all samples.
        final: every metric that has samples, and those made of others, folded over the samples from the hand-over to
            the first incident or the first time off the recorded path; empty when the distance to that path has no
            value, without which AlpaSim does not aggregate.
        scene: the scene score.
        missing: metrics that cannot be had from this drive, with the reason.
        n_steps, n_steps_scored: samples, and how many of them are left.
    """

    raw: Values
    final: Values
    scene: SceneScore
    missing: dict[str, str]
    n_steps: int
    n_steps_scored: int

    def to_dict(self) -> dict[str, Any]:
        """The scores as JSON can hold them."""
        return {**vars(self), "scene": vars(self.scene).copy()}


def score_as_alpasim(record: RolloutRecord) -> AlpasimScores:
    """All metrics and the scene score of one drive.

    Camera frames are not looked at: `img_is_black` is 0, as with frames that show something.
    """
    times, surroundings = record.timestamps_us, Surroundings(record)
    series: Metrics = {"img_is_black": MetricSeries(times, np.zeros(len(times)), "max")}
    missing: dict[str, str] = {}
    for measure, names in _FAMILIES:
        try:
            series |= measure(surroundings)
        except UnmeasuredError as error:
            missing |= dict.fromkeys(names, str(error))
    raw = {name: series[name].folded() if name in series else None for name in sorted([*missing, *series])}
    if "dist_to_gt_trajectory" not in series:
        return AlpasimScores(raw, {}, SceneScore(), missing, len(times), 0)
    # The first sample that is not warm-up; the very first when the drive ends before the hand-over.
    start_us = int(times[int(np.argmax(times >= record.handover_us))])
    series |= _combine(record, series, start_us)
    end_us = int(times[-1])
    for name, limit in (("offroad_or_collision", 1.0), ("dist_to_gt_trajectory", MAX_PATH_DISTANCE)):
        span = series[name].within(start_us, end_us)
        reached = span.times_us[span.values >= limit]
        end_us = int(reached[0]) if len(reached) else end_us
    final = {name: s.within(start_us, end_us).folded() for name, s in sorted(series.items()) if len(s.values)}
    final["progress_clipped_rel"] = final["progress_rel_to_total"]
    kept = int(((times >= start_us) & (times <= end_us)).sum())
    return AlpasimScores(raw, final, _scene_score(final), missing, len(times), kept)


def _combine(record: RolloutRecord, series: Metrics, start_us: int) -> Metrics:
    """The metrics made of others. Without a map nothing is off road here, though the scene score is refused."""
    times = record.timestamps_us
    front, lateral, contact = (series[f"collision_{name}"].values for name in ("front", "lateral", "any"))
    offroad = series["offroad"].values if "offroad" in series else np.zeros(len(times))
    at_fault = np.maximum(front, lateral)
    duration = np.where(times >= start_us, (times - start_us) / FULL_DURATION_US, np.nan)
    return {
        "collision_at_fault": MetricSeries(times, at_fault, "max"),
        "offroad_or_collision": MetricSeries(times, np.maximum(contact, offroad), "max"),
        "offroad_or_collision_at_fault": MetricSeries(times, np.maximum(at_fault, offroad), "max"),
        "duration_frac_20s": MetricSeries(times, duration, "last"),
        "eval_relevant": MetricSeries(times, (times >= record.handover_us).astype(np.float64), "max"),
    }


def _scene_score(final: Values) -> SceneScore:
    names = ("progress_clipped_rel", "gt_dist_traveled_m", "collision_at_fault", "offroad")
    needed = [value for value in map(final.get, names) if value is not None]
    if len(needed) < len(names):
        return SceneScore()
    progress, length, at_fault, offroad = needed
    progress_score = 1.0 if length < SHORT_RECORDING else min(min(max(progress, 0.0), 1.0) / FULL_PROGRESS, 1.0)
    reason = "collision_at_fault" if at_fault else "offroad" if offroad else None
    return SceneScore(0.0 if reason else progress_score, progress_score, reason, reason is None)
