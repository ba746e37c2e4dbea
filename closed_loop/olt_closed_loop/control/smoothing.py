"""Smoothing of plans: noise of single poses and of whole plans, before anything is steered after it.

A policy answers anew ten times a second. Where its answers are noisy a controller that follows each of them saws at the
wheel. Two linear filters take that out; `olt bench control` holds what each is worth against what it costs:

- within a plan, penalised least squares on third differences (Whittaker, Proc. Edinburgh Math. Soc. 41, 1922; Eilers,
  Anal. Chem. 75, 2003): motions of even acceleration pass unchanged, so it delays nothing. The first pose is where the
  rig is and stays.
- across plans, the running mean of what successive plans say of the same time, with weights that fall with a time
  constant. A change of mind arrives late by that constant.
"""

from functools import lru_cache

import numpy as np

from olt_closed_loop.control.plans import WorldPlan
from olt_generator.poses import Array
from olt_toolkit.policy.contract import STEP_US

DEFAULT_WINDOW, DEFAULT_DELAY = 0.0, 0.0


class PlanSmoother:
    """Smooths the plans of one drive.

    Args:
        window: within a plan, seconds: waves of 2 pi windows are halved, shorter ones vanish. 0 for none.
        delay: across plans, time constant in seconds. 0 for none.
    """

    def __init__(self, window: float, delay: float) -> None:
        self._window, self._delay = window, delay
        self._given: WorldPlan | None = None
        self._smooth: WorldPlan | None = None

    def __call__(self, plan: WorldPlan) -> WorldPlan:
        """The plan to follow where `plan` is in force; times of plans never fall."""
        if plan is self._given and self._smooth is not None:
            return self._smooth
        if not (self._window or self._delay):
            return plan
        poses = plan.poses
        if self._window:
            poses = smoothing_matrix(len(poses), self._window * 1e6 / STEP_US) @ poses
        if self._delay and self._smooth is not None and self._given is not None:
            poses = self._blended(poses, plan, self._smooth, plan.timestamps_us[0] - self._given.timestamps_us[0])
        self._given, self._smooth = plan, WorldPlan(plan.timestamps_us, poses)
        return self._smooth

    def _blended(self, poses: Array, plan: WorldPlan, before: WorldPlan, age_us: int) -> Array:
        """The mean with the plan before, as far as that reaches."""
        kept = np.exp(-age_us * 1e-6 / self._delay) * (plan.timestamps_us <= before.timestamps_us[-1])
        old = before.at(plan.timestamps_us)
        old[:, 2] += 2.0 * np.pi * np.round((poses[0, 2] - old[0, 2]) / (2.0 * np.pi))
        return poses + kept[:, None] * (old - poses)


@lru_cache(maxsize=8)
def smoothing_matrix(count: int, window: float) -> Array:
    """The map (count, count) from evenly timed values to smooth ones; `window` in steps.

    The smooth values y of x minimise |y - x|^2 + window^6 |third differences of y|^2 with the first value kept.
    """
    if count < 4:
        return np.eye(count)
    rough = np.diff(np.eye(count), n=3, axis=0)
    system = np.eye(count) + window**6 * rough.T @ rough
    system[0] = np.eye(count)[0]
    return np.linalg.inv(system)
