"""What a rollout is worth, by a definition with a name: `strict`, the default, or one of AlpaSim's public versions.

`alpasim@3032e0c` (July 2026) and `alpasim@challenge-2026-09` (`scoring.alpasim`) give the values of AlpaSim's own
evaluation; `alpasim` alone stands for the first, and results name it in full. `strict` keeps their intent:

- Only what happens after the hand-over counts.
- The score is 0 after a collision at fault or off the road, else min(progress / 0.8, 1).
- Progress is the arc length along the recorded path, as a share of what the recording drives from the hand-over to the
  end of the rollout; where that is under 5 m the progress score is 1. It is not counted from the first time on at which
  the ego is 4 m or more from the recorded path.

Where the two differ, and the case that shows it (`tests/closed_loop/scoring/test_definitions.py` holds each):

| | `alpasim` | `strict` | case |
| --- | --- | --- | --- |
| time | samples only | continuous between them | a fast crossing between two samples is hit |
| boxes | 2 % smaller, corners rounded | as they are | clipping a corner by 2 cm is a hit |
| height | ignored | counts | a bridge above the road is no hit |
| several contacts | one of them decides, by place | each has its side | hit ahead and behind at once, heading west |
| first contact | ends the rollout | only its own fault counts | tapped from behind, then driving into a parked car |
| fault | front or side, whoever moved | the rules of `scoring.fault.rules` | a standing ego that is hit from the side |
| appears over the ego | a hit | no contact until they have been apart | an agent whose first sample is over the ego |
| away for a while | interpolated | not there | an agent that is seen again across the road |
| off the road | at the edge only | also beyond it | the whole drive 8 m beside the road |
| lane direction | angles not wrapped | wrapped | the proper lane, heading west |
| progress | nearest point of the whole path | only ahead of the last one | a path that passes the same place twice |
| whole | recording, warm-up included | what was recorded after the hand-over | a perfect drive of the first half |
| precision | single | double | coordinates of 5e6 m |
| failure | stops the summary | this rollout is not valid | a pose that is not finite |
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.rollouts.rollout_record import RolloutRecord, record_rollout
from olt_closed_loop.scenes.polylines import arc_lengths
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scoring.alpasim.recording import MAX_PATH_DISTANCE
from olt_closed_loop.scoring.alpasim.scores import (
    FULL_PROGRESS,
    SHORT_RECORDING,
    AlpasimVersion,
    failed_row,
    score_as_alpasim,
    score_scene,
    summary_row,
)
from olt_closed_loop.scoring.collisions import Collision, find_collisions, site_of
from olt_closed_loop.scoring.drivable import drivable_area_of, first_departure
from olt_closed_loop.scoring.driving_metrics import measure_driving
from olt_closed_loop.scoring.moving_boxes import agent_box, ego_box, stretches
from olt_generator.errors import InputError
from olt_generator.omissions import Omission
from olt_toolkit.policy.route import PathTracker

Definition = Literal["strict", "alpasim@3032e0c", "alpasim@challenge-2026-09"]
DEFINITIONS: tuple[Definition, ...] = get_args(Definition)
DefinitionName = Literal["strict", "alpasim", "alpasim@3032e0c", "alpasim@challenge-2026-09"]
"""What a user may write: a definition, or `alpasim` for the version of `ALPASIM`."""
ALPASIM: Definition = "alpasim@3032e0c"
_VERSIONS: dict[Definition, AlpasimVersion] = {
    "alpasim@3032e0c": "3032e0c",
    "alpasim@challenge-2026-09": "challenge-2026-09",
}


def full_definition(name: DefinitionName) -> Definition:
    """The definition of a name."""
    return ALPASIM if name == "alpasim" else name


def alpasim_version(definition: Definition) -> AlpasimVersion | None:
    """The version of AlpaSim whose values a definition gives; None for `strict`."""
    return _VERSIONS.get(definition)


@dataclass(frozen=True)
class RolloutScore:
    """The score of one rollout.

    Attributes:
        scene, category, policy, seed: which rollout; the seed is None where nobody knows it.
        definition: how the score is defined.
        valid: whether the rollout can be scored; if not, `reason` says why and what was not measured is None.
        failed: whether the rollout broke off, so that there is nothing to score.
        score: the scene score, 0 to 1. `alpasim@challenge-2026-09` counts a rollout that failed as 0, valid or not.
        progress: share of the recorded path that was driven, 0 to 1.
        collided, collided_at_fault: whether the ego touched anything, and whether that was its fault.
        collisions: first contact with each agent, in order of time; () when none was found. `strict` only.
        offroad: whether the ego left the road; None when the scene has none.
        offroad_us: when it first did. `strict` only.
        left_path_us: when the ego was first 4 m or more from the recorded path. `strict` only.
        distance_m: driven after the hand-over; for `alpasim` along the whole path up to the first incident.
        incidents, incidents_at_fault: number of collisions and departures from the road; for `alpasim` at most one.
        reason: why the score is 0 by rule ("collision_at_fault", "offroad", "left_corridor_laterally"), why there is
            none, or None.
        metrics: further figures by name (`driving_metrics`, or AlpaSim's metrics).
        left_out: what was not computed, and why.
        rollout_incidents: what went wrong in the rollout (`rollouts.rollout.Incidents`); None when nobody counted.
        plan_deviation_max, plan_deviation_rms: of the rollout (`rollouts.rollout.Rollout`), metres.
    """

    scene: str
    category: str
    policy: str
    seed: int | None
    definition: Definition = "strict"
    valid: bool = False
    failed: bool = False
    score: float | None = None
    progress: float | None = None
    collided: bool | None = None
    collided_at_fault: bool | None = None
    collisions: tuple[Collision, ...] = ()
    offroad: bool | None = None
    offroad_us: int | None = None
    left_path_us: int | None = None
    distance_m: float | None = None
    incidents: int | None = None
    incidents_at_fault: int | None = None
    reason: str | None = None
    metrics: dict[str, float | None] = field(default_factory=dict)
    left_out: tuple[Omission, ...] = ()
    rollout_incidents: dict[str, int] | None = None
    plan_deviation_max: float | None = None
    plan_deviation_rms: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """The score as JSON can hold it."""
        return {
            **vars(self),
            "collisions": [vars(collision).copy() for collision in self.collisions],
            "left_out": [omission.to_dict() for omission in self.left_out],
        }


def score_rollout(
    scene: Scene, rollout: Rollout, skip: bool = True, definition: DefinitionName = "strict"
) -> RolloutScore:
    """Score one rollout of the scene. One that failed, or whose states are not finite, is not valid.

    `skip` leaves out what cannot change the result; the result is the same without, only slower.

    Raises:
        InputError: the rollout is one of another scene.
    """
    if rollout.scene != scene.name:
        raise InputError(f"rollout of scene {rollout.scene} cannot be scored on scene {scene.name}; give its own scene")
    if rollout.failure:
        return score_failed(rollout, definition)
    unscored = RolloutScore(scene.name, scene.category, rollout.policy, rollout.seed, full_definition(definition))
    unscored = replace(
        unscored,
        rollout_incidents=vars(rollout.incidents).copy(),
        plan_deviation_max=rollout.plan_deviation_max,
        plan_deviation_rms=rollout.plan_deviation_rms,
    )
    finite = np.isfinite(rollout.states).all(axis=1) & np.isfinite(rollout.heights)
    if not finite.all():
        return _failed(unscored, f"the state at {rollout.timestamps_us[np.argmin(finite)]} us is not finite")
    return _score(record_rollout(scene, rollout), unscored, skip)


def score_failed(rollout: Rollout, definition: DefinitionName = "strict") -> RolloutScore:
    """What a rollout that failed is worth; it may have no scene at all, which is no failure of the policy."""
    unscored = RolloutScore(
        rollout.scene,
        rollout.category,
        rollout.policy,
        rollout.seed,
        full_definition(definition),
        reason=rollout.failure,
    )
    unscored = replace(unscored, rollout_incidents=vars(rollout.incidents).copy())
    return unscored if rollout.failure_kind == "scene_refused" else _failed(unscored, rollout.failure or "")


def score_record(record: RolloutRecord, definition: DefinitionName = "strict", skip: bool = True) -> RolloutScore:
    """Score a rollout of which nothing but the record is known (`rollouts.rollout_files`)."""
    return _score(record, RolloutScore(record.name, "unknown", "unknown", None, full_definition(definition)), skip)


def alpasim_rows(scores: Sequence[RolloutScore]) -> list[dict[str, Any]]:
    """The rows of AlpaSim's `results-summary.json` for scores by its versions, those of failed rollouts last, as there.

    A failed rollout has status "fail", score 0 and no metric; one without a scene score is "unscored", as AlpaSim calls
    what nobody scored (it writes no summary then).
    """
    rows = []
    for score in sorted(scores, key=lambda score: score.failed):
        version = _VERSIONS[score.definition]
        if score.failed:
            row = failed_row(score.reason or "", version)
        else:
            row = summary_row(score_scene(score.metrics, version), score.metrics, version)
        rows.append({"run_name": score.policy, "clipgt_id": score.scene, "rollout_id": str(score.seed), **row})
    return rows


def _failed(unscored: RolloutScore, reason: str) -> RolloutScore:
    """A rollout that broke off. The challenge counts it as 0, 3032e0c makes no summary while there is one."""
    counted = unscored.definition == "alpasim@challenge-2026-09"
    return replace(unscored, failed=True, reason=reason, score=0.0 if counted else None)


def _score(record: RolloutRecord, unscored: RolloutScore, skip: bool) -> RolloutScore:
    if record.failure:
        return _failed(unscored, record.failure)
    if record.driver_ended and unscored.definition == "alpasim@challenge-2026-09":
        return _failed(unscored, "the driver ended the session")
    if int((record.timestamps_us >= record.handover_us).sum()) < 2:
        return replace(unscored, reason="the drive ends before the hand-over")
    version = alpasim_version(unscored.definition)
    if version is None and not _is_recorded(record):
        return replace(unscored, reason="nothing was recorded after the hand-over, so progress cannot be measured")
    given = _score_as_alpasim(record, version) if version else _score_strictly(record, skip)
    if record.absent:
        absent, total = len(record.absent), len(record.absent) + len(record.agents)
        given["left_out"] += (Omission("agents", "no sample at a time of the drive", absent, total),)
    return replace(unscored, **given)


def _score_strictly(record: RolloutRecord, skip: bool) -> dict[str, Any]:
    ego, area = ego_box(record), drivable_area_of(record, skip)
    agents = tuple(stretches(record.agents))
    boxes = [agent_box(agent) for agent in agents]
    span = _scored_span(record)
    found = find_collisions(ego, agents, boxes, *span, skip_unreachable=skip, site=site_of(record, area))
    collisions = found.collisions
    offroad_us = first_departure(area, ego, *span, skip=skip) if area else None
    recorded_m = recorded_length(record)
    progress, left_path_us = _measure_progress(record, recorded_m)
    metrics = measure_driving(record, ego, boxes)
    at_fault = sum(collision.at_fault for collision in collisions)
    left_road = int(offroad_us is not None)
    reason = "collision_at_fault" if at_fault else "offroad" if left_road else None
    progress_score = 1.0 if recorded_m < SHORT_RECORDING else min(progress / FULL_PROGRESS, 1.0)
    left_out = []
    if found.unreachable:
        left_out.append(Omission("agents in collision tests", "never within reach", found.unreachable, len(agents)))
    left_out += [Omission(f"contact with {name}", "appeared in contact") for name in found.appeared]
    left_out += [Omission(f"contact with {name}", "in contact at the hand-over") for name in found.handed_over]
    if area and area.left_out:
        left_out.append(
            Omission("map in the road test", "lanes or outlines far from the drive", area.left_out, area.parts)
        )
    if not area:
        left_out.append(Omission("road test", "the scene has no drivable area, nor lanes with road edges"))
    return {
        "valid": True,
        "score": 0.0 if reason else progress_score,
        "progress": progress,
        "collided": bool(collisions),
        "collided_at_fault": at_fault > 0,
        "collisions": collisions,
        "offroad": bool(left_road) if area else None,
        "offroad_us": offroad_us,
        "left_path_us": left_path_us,
        "distance_m": metrics["distance_m"],
        "incidents": len(collisions) + left_road,
        "incidents_at_fault": at_fault + left_road,
        "reason": reason,
        "metrics": metrics,
        "left_out": tuple(left_out),
    }


def _score_as_alpasim(record: RolloutRecord, version: AlpasimVersion) -> dict[str, Any]:
    scores = score_as_alpasim(record, version)
    given: dict[str, Any] = {
        "metrics": scores.final,
        "left_out": tuple(Omission(name, reason) for name, reason in scores.missing.items()),
    }
    if scores.scene.score is None:
        why = "; ".join(f"{name}: {reason}" for name, reason in scores.missing.items()) or scores.scene.error
        return given | {"reason": f"AlpaSim gives no scene score ({why})"}
    final = {name: value for name, value in scores.final.items() if value is not None}
    return given | {
        "valid": True,
        "score": scores.scene.score,
        "progress": min(max(final["progress_clipped_rel"], 0.0), 1.0),
        "collided": final["collision_any"] > 0.0,
        "collided_at_fault": final["collision_at_fault"] > 0.0,
        "offroad": final["offroad"] > 0.0,
        "distance_m": final["dist_traveled_m"],
        "incidents": int(final["offroad_or_collision"]),
        "incidents_at_fault": int(final["offroad_or_collision_at_fault"]),
        "reason": scores.scene.failure_reason,
    }


def _scored_span(record: RolloutRecord) -> tuple[int, int]:
    """First and last microsecond that count."""
    return max(record.handover_us, int(record.timestamps_us[0])), int(record.timestamps_us[-1])


def _is_recorded(record: RolloutRecord) -> bool:
    """Whether the recording has some of the time that counts."""
    start_us, end_us = _scored_span(record)
    return int(record.recorded_us[0]) < end_us and int(record.recorded_us[-1]) > start_us


def _measure_progress(record: RolloutRecord, recorded_m: float) -> tuple[float, int | None]:
    """Progress along the metres that were recorded, and when the path was left."""
    tracker = PathTracker(record.recorded_poses[:, :2])
    handed_over, reached, left_path_us = 0.0, 0.0, None
    for time_us, position in zip(record.timestamps_us.tolist(), record.poses[:, :2], strict=True):
        arc_length = tracker.advance(position)
        if tracker.distance >= MAX_PATH_DISTANCE:
            left_path_us = time_us
            break
        reached = arc_length
        if time_us <= record.handover_us:
            handed_over = reached
    return (min((reached - handed_over) / recorded_m, 1.0) if recorded_m > 0.0 else 1.0), left_path_us


def recorded_length(record: RolloutRecord) -> float:
    """Metres that the recording drives from the rollout's hand-over to its end."""
    times = record.recorded_us
    driven = arc_lengths(record.recorded_poses)
    start, end = np.interp(np.array(_scored_span(record)) - times[0], times - times[0], driven)
    return float(end - start)
