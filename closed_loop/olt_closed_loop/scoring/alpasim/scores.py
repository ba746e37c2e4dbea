"""From the samples of a drive to AlpaSim's metrics and scene score, by either of its public versions.

`3032e0c` (July 2026) has two hard zeros: a collision at fault, and off the road. `challenge-2026-09` (6f1029c, the
challenge of 2026) adds a third, leaving the corridor of 4 m sideways, and measures progress as a share of what the
recording reached in the time that is scored. See docs/formats/alpasim.md, "Score".
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

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
from olt_closed_loop.scoring.alpasim.recording import MAX_PATH_DISTANCE, measure_along_recording, measure_corridor
from olt_closed_loop.scoring.alpasim.roads import measure_road
from olt_closed_loop.scoring.alpasim.series import MetricSeries, UnmeasuredError
from olt_closed_loop.scoring.alpasim.surroundings import Surroundings, measure_contact

FULL_PROGRESS = 0.8
SHORT_RECORDING = 5.0
FULL_DURATION_US = 20e6

AlpasimVersion = Literal["3032e0c", "challenge-2026-09"]
VERSIONS: tuple[AlpasimVersion, ...] = get_args(AlpasimVersion)

Metrics = dict[str, MetricSeries]
Values = dict[str, float | None]

_Family = tuple[Callable[[Surroundings], Metrics], tuple[str, ...]]
_ALONG = (
    "dist_to_gt_location",
    "dist_to_gt_trajectory",
    "dist_traveled_m",
    "gt_dist_traveled_m",
    "progress",
    "progress_rel",
    "progress_rel_to_total",
)
_CORRIDOR = ("lateral_dist_to_gt_trajectory", "left_corridor_laterally")
_RECORDING: dict[AlpasimVersion, _Family] = {
    "3032e0c": (measure_along_recording, _ALONG),
    "challenge-2026-09": (measure_corridor, (*_ALONG, *_CORRIDOR)),
}
_FAMILIES: tuple[_Family, ...] = (
    (
        measure_contact,
        ("collision_any", "collision_front", "collision_lateral", "collision_rear", "min_distance_to_obstacle_m"),
    ),
    (measure_road, ("min_distance_to_lane_boundary_m", "offroad", "wrong_lane")),
    (measure_displacement, tuple(ade_name(horizon) for horizon in ADE_HORIZONS)),
    (measure_plan_deviation, ("plan_deviation",)),
    (measure_plan_collisions, ("open_loop_collision",)),
    (measure_safety_monitor, ("safety_monitor_triggered",)),
)
"""What measures which metrics; where one cannot be had, AlpaSim lacks the whole family."""

_NEEDED = ("progress_clipped_rel", "gt_dist_traveled_m", "collision_at_fault", "offroad")
_HARD_ZEROS: dict[AlpasimVersion, tuple[str, ...]] = {
    "3032e0c": ("collision_at_fault", "offroad"),
    "challenge-2026-09": ("collision_at_fault", "offroad", "left_corridor_laterally"),
}
_SHOWN: dict[AlpasimVersion, tuple[str, ...]] = {
    "3032e0c": (*_NEEDED, "progress_rel", "dist_to_gt_trajectory"),
    "challenge-2026-09": (*_NEEDED, "progress_rel", "dist_to_gt_trajectory", *_CORRIDOR),
}
"""The metrics that AlpaSim shows beside a score."""


@dataclass(frozen=True)
class SceneScore:
    """AlpaSim's scene score; where a metric that it needs has no value all is None but `error`, which says which."""

    score: float | None = None
    progress_score: float | None = None
    failure_reason: str | None = None
    passed: bool | None = None
    error: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """The score, or nothing but the error: AlpaSim raises it in the score's place."""
        values = vars(self).copy()
        return {"error": self.error} if values.pop("error") else values


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
        version: whose values they are.
    """

    raw: Values
    final: Values
    scene: SceneScore
    missing: dict[str, str]
    n_steps: int
    n_steps_scored: int
    version: AlpasimVersion = "3032e0c"

    def to_dict(self) -> dict[str, Any]:
        """The scores as JSON can hold them."""
        return {**vars(self), "scene": self.scene.to_dict()}


def score_as_alpasim(record: RolloutRecord, version: AlpasimVersion = "3032e0c") -> AlpasimScores:
    """All metrics and the scene score of one drive.

    Camera frames are not looked at: `img_is_black` is 0, as with frames that show something.
    """
    times, surroundings = record.timestamps_us, Surroundings(record)
    series: Metrics = {"img_is_black": MetricSeries(times, np.zeros(len(times)), "max")}
    missing: dict[str, str] = {}
    for measure, names in (_FAMILIES[0], _RECORDING[version], *_FAMILIES[1:]):
        try:
            series |= measure(surroundings)
        except UnmeasuredError as error:
            missing |= dict.fromkeys(names, str(error))
    raw = {name: series[name].folded() if name in series else None for name in sorted([*missing, *series])}
    if "dist_to_gt_trajectory" not in series:
        return AlpasimScores(raw, {}, score_scene({}, version), missing, len(times), 0, version)
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
    return AlpasimScores(raw, final, score_scene(final, version), missing, len(times), kept, version)


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


def score_scene(final: Values, version: AlpasimVersion) -> SceneScore:
    """The scene score that the final metrics give; None among them is AlpaSim's NaN."""
    zeros = _HARD_ZEROS[version]
    values: dict[str, float] = {}
    for name in dict.fromkeys((*_NEEDED, *zeros)):
        value = final.get(name)
        if value is None:
            lacks = f"metric '{name}' has non-finite value nan" if name in final else f"missing metric '{name}'"
            return SceneScore(error=f"Cannot compute scene score: {lacks}.")
        values[name] = value
    progress = min(max(values["progress_clipped_rel"], 0.0), 1.0)
    progress_score = 1.0 if values["gt_dist_traveled_m"] < SHORT_RECORDING else min(progress / FULL_PROGRESS, 1.0)
    reason = next((name for name in zeros if values[name]), None)
    return SceneScore(0.0 if reason else progress_score, progress_score, reason, reason is None)


def summary_row(scene: SceneScore, final: Values, version: AlpasimVersion) -> dict[str, Any]:
    """The row of a rollout in AlpaSim's `results-summary.json`, without the names of run and scene."""
    if scene.error:
        return {
            "status": "unscored",
            "passed": None,
            "score": None,
            "failure_reason": scene.error,
            "score_metrics": None,
        }
    shown = {name: final.get(name) for name in _SHOWN[version]} | {"progress_score": scene.progress_score}
    return {
        "status": "pass" if scene.passed else "fail",
        "passed": scene.passed,
        "score": scene.score,
        "failure_reason": scene.failure_reason,
        "score_metrics": shown,
    }


def failed_row(reason: str, version: AlpasimVersion) -> dict[str, Any]:
    """The row of a rollout that failed, for whatever reason: score 0 and no metric."""
    return summary_row(SceneScore(0.0, 0.0, reason, False), {}, version)
