"""What the plans were worth: against the recording, against each other, and against the agents' recorded future."""

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.alpasim.series import Fold, MetricSeries
from olt_closed_loop.alpasim.surroundings import Surroundings
from olt_closed_loop.alpasim.tracks import RoundedBox, Track, ego_track
from olt_closed_loop.drive_record import Plan
from olt_generator.poses import Array

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
    record = surroundings.record
    recorded = ego_track(record.recorded_us, record.recorded_poses, record.box)
    rows: dict[float, list[tuple[int, float]]] = {horizon: [] for horizon in ADE_HORIZONS}
    for plan in record.plans:
        if plan.samples:
            for horizon, value in zip(ADE_HORIZONS, _displacements(surroundings, recorded, plan), strict=False):
                rows[horizon].append((plan.now_us, value))
    return {ade_name(horizon): _series(pairs) for horizon, pairs in rows.items()}


def _displacements(surroundings: Surroundings, recorded: Track, plan: Plan) -> list[float]:
    """The values of the horizons that the drive still has samples for, shortest first."""
    record = surroundings.record
    times = record.timestamps_us
    last_us = min(plan.now_us + max(ADE_HORIZONS) * 1e6, times[-1])
    compared = times[(times >= plan.query_us) & (times <= last_us)]
    target, _ = recorded.at(compared)
    tracks = [ego_track(plan.timestamps_us, sample, record.box) for sample in plan.samples]
    errors = np.stack([np.linalg.norm(track.at(compared)[0] - target, axis=-1) for track in tracks])
    means = (np.cumsum(errors, axis=1) / np.arange(1, len(compared) + 1)).min(axis=0)
    ends = np.searchsorted(times, plan.now_us + 1e6 * np.array(ADE_HORIZONS)) - np.searchsorted(times, plan.now_us) - 1
    return [float(means[end]) for end in ends if end < len(means)]


def measure_plan_deviation(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """How far each plan is from the one before it, where both have poses; near poses weigh more.

    Raises:
        UnmeasuredError: a plan has poses before the plan that came before it starts.
    """
    record = surroundings.record
    pairs = []
    for before, plan in zip(record.plans[:-1], record.plans[1:], strict=True):
        shared = plan.timestamps_us[1:]
        shared = shared[shared <= before.timestamps_us[-1]]
        if len(shared):
            places = [ego_track(p.timestamps_us, p.poses, record.box).at(shared)[0] for p in (before, plan)]
            apart = np.linalg.norm(places[1] - places[0], axis=-1)
            pairs.append((plan.now_us, float(np.average(apart, weights=np.exp(-DECAY * np.arange(len(apart)))))))
    return {"plan_deviation": _series(pairs)}


def measure_plan_collisions(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """Whether each plan runs into a recorded agent within 3 s."""
    pairs = [(plan.now_us, _plan_collides(surroundings, plan)) for plan in surroundings.record.plans]
    return {"open_loop_collision": _series(pairs)}


def measure_safety_monitor(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """Whether the policy called a plan of its own unsafe; no plan of a rollout file does."""
    return {"safety_monitor_triggered": _series([(plan.now_us, 0.0) for plan in surroundings.record.plans], "max")}


def _plan_collides(surroundings: Surroundings, plan: Plan) -> float:
    """1, 0, or NaN for a plan without a pose in the horizon."""
    times = plan.timestamps_us
    ahead = times[(times > plan.now_us) & (times <= plan.now_us + COLLISION_HORIZON_US)]
    if len(ahead) == 0:
        return np.nan
    ego = ego_track(times, plan.poses, surroundings.record.box)
    return float(any(_meet(ego, surroundings.ego_shape, *agent, ahead) for agent in surroundings.agents))


def _meet(ego: Track, ego_shape: RoundedBox, shape: RoundedBox, track: Track, times: NDArray[np.int64]) -> bool:
    """Whether two outlines touch at any of the times (n,) at which the second exists."""
    shared = times[track.exists(times)]
    ours, theirs = ego.at(shared), track.at(shared)
    apart: Array = np.linalg.norm(ours[0] - theirs[0], axis=-1)
    near = apart <= ego_shape.reach + shape.reach + 1e-3 * (1.0 + np.abs(ours[0]).max(initial=0.0) * 1e-3)
    outlines = [
        figure.polygons(place[near], yaw[near]) for figure, (place, yaw) in ((ego_shape, ours), (shape, theirs))
    ]
    return bool(shapely.intersects(*outlines).any())


def _series(pairs: list[tuple[int, float]], fold: Fold = "mean") -> MetricSeries:
    times = np.array([time for time, _ in pairs], dtype=np.int64)
    return MetricSeries(times, np.array([value for _, value in pairs], dtype=np.float64), fold)
