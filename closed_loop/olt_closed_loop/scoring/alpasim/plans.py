"""What the plans were worth: against the recording, against each other, and against the agents' recorded future."""

from collections.abc import Sequence

import numpy as np
import shapely

from olt_closed_loop.scoring.alpasim.series import Fold, MetricSeries
from olt_closed_loop.scoring.alpasim.surroundings import Surroundings
from olt_closed_loop.scoring.alpasim.tracks import Indices, Times, ego_track, ego_tracks

ADE_HORIZONS = (0.5, 1.0, 2.5, 5.0)
COLLISION_HORIZON_US = 3_000_000
DECAY = 0.1


def ade_name(horizon: float) -> str:
    """Name of the displacement metric at a horizon in seconds."""
    return f"min_ade@{horizon:.1f}s(gt)"


def measure_displacement(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """At each plan and horizon, the smallest mean distance of its samples from the recorded positions.

    Raises:
        UnmeasuredError: a plan or the recording ends before the longest horizon, which takes all horizons with it.
    """
    record, scored = surroundings.record, surroundings.record.timestamps_us
    plans = [plan for plan in record.plans if plan.samples]
    last_us = [plan.now_us + max(ADE_HORIZONS) * 1e6 for plan in plans]
    compared = [
        scored[(scored >= plan.query_us) & (scored <= end_us)] for plan, end_us in zip(plans, last_us, strict=True)
    ]
    drawn = [(plan.timestamps_us, sample, i) for i, plan in enumerate(plans) for sample in plan.samples]
    times, sample_of = _joined([compared[i] for _, _, i in drawn])
    target, _ = ego_track(record.recorded_us, record.recorded_poses, record.box).at(times)
    samples = ego_tracks([known for known, _, _ in drawn], [poses for _, poses, _ in drawn], record.box)
    errors = np.linalg.norm(samples.at(times, sample_of)[0] - target, axis=-1)
    plan_of = np.array([i for _, _, i in drawn], dtype=np.int64)[sample_of]

    rows: dict[float, list[tuple[int, float]]] = {horizon: [] for horizon in ADE_HORIZONS}
    for i, plan in enumerate(plans):
        apart = errors[plan_of == i].reshape(len(plan.samples), -1)
        means = (np.cumsum(apart, axis=1) / np.arange(1, apart.shape[1] + 1)).min(axis=0)
        ends = np.searchsorted(scored, plan.now_us + 1e6 * np.array(ADE_HORIZONS))
        ends = ends - np.searchsorted(scored, plan.now_us) - 1
        # A horizon beyond the end of the drive has no value.
        for horizon, end in zip(ADE_HORIZONS, ends, strict=True):
            if end < len(means):
                rows[horizon].append((plan.now_us, float(means[end])))
    return {ade_name(horizon): _series(pairs) for horizon, pairs in rows.items()}


def measure_plan_deviation(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """How far each plan is from the one before it, where both have poses; near poses weigh more.

    Raises:
        UnmeasuredError: a plan has poses before the plan that came before it starts.
    """
    record = surroundings.record
    shared = [
        plan.timestamps_us[1:][plan.timestamps_us[1:] <= before.timestamps_us[-1]]
        for before, plan in zip(record.plans[:-1], record.plans[1:], strict=True)
    ]
    times, pair = _joined(shared)
    places = [surroundings.plans.at(times, plan)[0] for plan in (pair, pair + 1)]
    apart = np.linalg.norm(places[1] - places[0], axis=-1)
    weights = np.exp(-DECAY * np.arange(max(map(len, shared), default=0)))
    pairs, end = [], 0
    for plan, count in zip(record.plans[1:], map(len, shared), strict=True):
        start, end = end, end + count
        if count:
            pairs.append((plan.now_us, float((apart[start:end] * weights[:count]).sum() / weights[:count].sum())))
    return {"plan_deviation": _series(pairs)}


def measure_plan_collisions(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """Whether each plan touches a recorded agent at any of its times in the 3 s after it was made."""
    plans = surroundings.record.plans
    ahead = [
        plan.timestamps_us[
            (plan.timestamps_us > plan.now_us) & (plan.timestamps_us <= plan.now_us + COLLISION_HORIZON_US)
        ]
        for plan in plans
    ]
    times, plan = _joined(ahead)
    ego = surroundings.plans.at(times, plan)
    moments, moment = np.unique(times, return_inverse=True)
    positions, yaws = (places[:, moment] for places in surroundings.agents_at(moments))
    reaches = surroundings.agent_shapes.reaches[:, None] + surroundings.ego_shape.reaches + surroundings.slack
    apart = np.hypot(*np.moveaxis(positions - ego[0], -1, 0))
    agent, row = np.nonzero(apart <= reaches)
    own, others = (ego[0][row], ego[1][row]), (positions[agent, row], yaws[agent, row])
    at_least, _ = surroundings.distance_bounds(own, others, agent)

    touches = np.zeros(len(plans), dtype=bool)
    # A plan is settled by one contact, so the pair of boxes that overlap most is looked at before the others.
    by_depth = np.lexsort((at_least, plan[row]))
    by_depth = by_depth[at_least[by_depth] <= 0.0]
    _, deepest = np.unique(plan[row[by_depth]], return_index=True)
    for pairs in (by_depth[deepest], np.delete(by_depth, deepest)):
        pairs = pairs[~touches[plan[row[pairs]]]]
        outlines = surroundings.ego_shape.polygons(*(place[pairs] for place in own))
        met = surroundings.agent_shapes.select(agent[pairs]).polygons(*(place[pairs] for place in others))
        touches[plan[row[pairs]][shapely.intersects(outlines, met)]] = True
    return {
        "open_loop_collision": _series(
            [
                (plan.now_us, float(touch) if len(times) else np.nan)
                for plan, times, touch in zip(plans, ahead, touches, strict=True)
            ]
        )
    }


def measure_safety_monitor(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """Whether the policy called a plan of its own unsafe; no plan of a rollout file does."""
    return {"safety_monitor_triggered": _series([(plan.now_us, 0.0) for plan in surroundings.record.plans], "max")}


def _joined(times: Sequence[Times]) -> tuple[Times, Indices]:
    """All times (n,) in a row, and the list (n,) that each is of."""
    owners = np.repeat(np.arange(len(times)), [len(part) for part in times])
    return np.concatenate([np.empty(0, np.int64), *times]), owners


def _series(pairs: list[tuple[int, float]], fold: Fold = "mean") -> MetricSeries:
    times = np.array([time for time, _ in pairs], dtype=np.int64)
    return MetricSeries(times, np.array([value for _, value in pairs], dtype=np.float64), fold)
