"""A policy's plan as the simulator keeps it: timed poses in the world."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array, yaw_of
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_US, PlannedTrajectory

MAX_PLAN_SPEED = 65.0
"""m/s over any second of a plan. Vehicle and control are made for 60 m/s; the rest is room to catch up."""
REACH = 0.5 * 9.81
"""Metres by which tyres with a friction of 1 bring a vehicle, within a second, from where its velocity leads."""
_SECOND_US = 1_000_000


class PlanRefused(Exception):
    """A policy's answer that no vehicle can be asked to follow; the message says why."""


class TimedPoses(NamedTuple):
    """Poses (n, 3) x, y, yaw in the world at rising times (n,) int64 in microseconds."""

    timestamps_us: NDArray[np.int64]
    poses: Array

    def at(self, timestamps_us: NDArray[np.int64]) -> Array:
        """Poses (m, 3) at the given times, linear in between; after their end they stand at the last."""
        first = self.timestamps_us[0]
        known, asked = self.timestamps_us - first, timestamps_us - first
        return np.array([np.interp(asked, known, column) for column in self.poses.T]).T


@dataclass(frozen=True)
class WorldPlan:
    """Where the rig is to be, and when.

    Attributes:
        timestamps_us: (n,) int64, strictly increasing; the first is the time of planning.
        poses: (n, 3) float64: x, y in the world (m) and unwrapped yaw (rad); the first is where the rig was then.

    Raises:
        PlanRefused: the shapes do not fit, times do not increase, a pose is not finite, or the plan is faster than
            MAX_PLAN_SPEED.
    """

    timestamps_us: NDArray[np.int64]
    poses: Array

    def __post_init__(self) -> None:
        count = len(self.timestamps_us)
        if count == 0 or self.poses.shape != (count, 3):
            raise PlanRefused(f"plan of {count} times and poses of shape {self.poses.shape}")
        if np.any(np.diff(self.timestamps_us) <= 0):
            raise PlanRefused("times of the plan do not increase")
        if not np.isfinite(self.poses).all():
            raise PlanRefused("plan is not finite")
        later = self.at(self.timestamps_us + _SECOND_US)
        speed = np.linalg.norm(later[:, :2] - self.poses[:, :2], axis=1).max()
        if speed > MAX_PLAN_SPEED:
            raise PlanRefused(f"plan moves {speed:.0f} m within a second; at most {MAX_PLAN_SPEED:.0f} m/s are driven")

    def at(self, timestamps_us: NDArray[np.int64]) -> Array:
        """Poses (m, 3) at the given times, linear in between; after its end the plan stands at its last pose."""
        return TimedPoses(self.timestamps_us, self.poses).at(timestamps_us)


def is_out_of_reach(plan: WorldPlan, velocity: Array) -> bool:
    """Whether a plan is, after a second, farther than `REACH` from where a velocity (2,) in m/s in the world leads."""
    after = plan.at(plan.timestamps_us[:1] + _SECOND_US)[0, :2]
    return bool(np.linalg.norm(after - plan.poses[0, :2] - velocity) > REACH)


def place_plan(plan: PlannedTrajectory, x: float, y: float, yaw: float, time_us: int) -> WorldPlan:
    """The plan that was made in the rig at (x, y, yaw), in the world.

    Raises:
        PlanRefused: the plan has another shape than the policy contract says, is not finite, or too fast.
    """
    if plan.xyz.shape != (FUTURE_STEPS, 3) or plan.rotation.shape != (FUTURE_STEPS, 3, 3):
        raise PlanRefused(f"plan of shapes {plan.xyz.shape}, {plan.rotation.shape} instead of 64 poses")
    if not (np.isfinite(plan.xyz).all() and np.isfinite(plan.rotation).all()):
        raise PlanRefused("plan is not finite")
    in_rig = np.concatenate([np.zeros((1, 3)), np.column_stack([plan.xyz[:, :2], yaw_of(plan.rotation)])])
    cos, sin = np.cos(yaw), np.sin(yaw)
    poses = np.stack(
        [
            x + cos * in_rig[:, 0] - sin * in_rig[:, 1],
            y + sin * in_rig[:, 0] + cos * in_rig[:, 1],
            yaw + np.unwrap(in_rig[:, 2]),
        ],
        axis=-1,
    )
    return WorldPlan(time_us + STEP_US * np.arange(FUTURE_STEPS + 1, dtype=np.int64), poses)
