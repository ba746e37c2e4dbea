"""Motions whose poses are known without the action space: speed and curvature by time, integrated in steps of 1 ms."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

from olt_generator.poses import Array, planar_pose
from olt_generator.seeds import make_generator
from olt_toolkit.policy.contract import FUTURE_STEPS, HISTORY_STEPS, STEP_SECONDS

OfTime = Callable[[Array], Array]
_FINE = 0.001
_PER_STEP = round(STEP_SECONDS / _FINE)
HISTORY_SECONDS, FUTURE_SECONDS = (HISTORY_STEPS - 1) * STEP_SECONDS, FUTURE_STEPS * STEP_SECONDS
_LATERAL = 3.0  # m/s^2 that drawn motions keep below


@dataclass(frozen=True)
class Motions:
    """Poses of n motions in the rig frame at t0: x and y in metres and yaw in radians.

    Attributes:
        history: (n, 16, 3) at t0 - 1.5 ... 0 s.
        future: (n, 64, 3) at t0 + 0.1 ... 6.4 s.
    """

    history: Array
    future: Array

    def poses(self) -> tuple[Array, Array, Array, Array]:
        """History xyz (n, 16, 3) and rotation (n, 16, 3, 3), and the same of the future, as `trajectory_to_actions`."""
        past, coming = (planar_pose(*np.moveaxis(part, -1, 0)) for part in (self.history, self.future))
        return past[..., :3, 3], past[..., :3, :3], coming[..., :3, 3], coming[..., :3, :3]


def drive(speed: OfTime, curvature: OfTime) -> Motions:
    """One motion (n = 1) of a speed in m/s, negative backwards, and a curvature in 1/m, at times (m,) in s from t0."""
    steps = round(HISTORY_SECONDS / _FINE) + round(FUTURE_SECONDS / _FINE)
    times: Array = -HISTORY_SECONDS + _FINE * np.arange(steps + 1, dtype=np.float64)
    v = np.broadcast_to(speed(times), times.shape)
    yaw = cumulative_trapezoid(v * curvature(times), dx=_FINE, initial=0.0)
    yaw -= yaw[round(HISTORY_SECONDS / _FINE)]
    x, y = (cumulative_trapezoid(v * turned, dx=_FINE, initial=0.0) for turned in (np.cos(yaw), np.sin(yaw)))
    poses = np.stack([x, y, yaw], axis=-1)[::_PER_STEP]
    poses = poses - poses[HISTORY_STEPS - 1]
    return Motions(poses[None, :HISTORY_STEPS], poses[None, HISTORY_STEPS:])


def join(motions: list[Motions]) -> Motions:
    """All of them as one."""
    return Motions(
        np.concatenate([each.history for each in motions]), np.concatenate([each.future for each in motions])
    )


def drawn_motions(count: int, seed: int = 0) -> Motions:
    """Ordinary driving: speeds of 3 to 25 m/s that rise and fall by up to 2 m/s^2, and curves of up to 3 m/s^2."""
    draw = make_generator("motions", seed)
    return join([_draw(draw) for _ in range(count)])


def _draw(draw: np.random.Generator) -> Motions:
    middle, pace = draw.uniform(3.0, 25.0), draw.uniform(0.2, 1.0)
    swing = min(0.4 * middle, draw.uniform(0.0, 2.0) / pace)
    sharpest = _LATERAL / (middle + swing) ** 2
    bend, wave, phase = draw.uniform(-0.7, 0.7) * sharpest, draw.uniform(0.0, 0.3) * sharpest, draw.uniform(0.0, 6.28)
    return drive(
        lambda times: middle + swing * np.sin(pace * times + phase),
        lambda times: bend + wave * np.sin(0.8 * times + phase),
    )


def distances(driven: Array, motions: Motions) -> Array:
    """Distance in the plane (n, 64) in metres between trajectories (n, 64, 3) and the motions."""
    return np.linalg.norm(driven[..., :2] - motions.future[..., :2], axis=-1)


def by_horizon(errors: Array) -> dict[str, float]:
    """Mean error in metres over the first second, three seconds and all of (n, 64)."""
    return {
        f"mean error over {seconds:g} s (m)": float(errors[:, : round(10 * seconds)].mean())
        for seconds in (1.0, 3.0, 6.4)
    }
