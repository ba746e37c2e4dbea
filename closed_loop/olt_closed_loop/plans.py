"""A policy's plan as the simulator keeps it: timed poses in the world."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array, yaw_of
from olt_toolkit.policy import FUTURE_STEPS, STEP_US, Plan


class PlanRefused(Exception):
    """A policy's answer that no vehicle can be asked to follow; the message says why."""


@dataclass(frozen=True)
class WorldPlan:
    """Where the rig is to be, and when.

    Attributes:
        timestamps_us: (n,) int64, strictly increasing; the first is the time of planning.
        poses: (n, 3) float64: x, y in the world (m) and unwrapped yaw (rad); the first is where the rig was then.
    """

    timestamps_us: NDArray[np.int64]
    poses: Array

    def at(self, timestamps_us: NDArray[np.int64]) -> Array:
        """Poses (m, 3) at the given times, linear in between; after its end the plan stands at its last pose."""
        first = self.timestamps_us[0]
        known, asked = self.timestamps_us - first, timestamps_us - first
        return np.stack([np.interp(asked, known, column) for column in self.poses.T], axis=-1)


def place_plan(plan: Plan, x: float, y: float, yaw: float, time_us: int) -> WorldPlan:
    """The plan that was made in the rig at (x, y, yaw), in the world.

    Raises:
        PlanRefused: the plan has another shape than the policy contract says, or is not finite.
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
