"""Smoothing of plans: noise of single poses and of whole plans, before anything is steered after it.

A policy answers anew ten times a second. Where its answers are noisy a controller that follows each of them saws at the
wheel. Two linear filters take that out; `olt bench control` holds what each is worth against what it costs:

- within a plan, penalised least squares on third differences (Whittaker, Proc. Edinburgh Math. Soc. 41, 1922; Eilers,
  Anal. Chem. 75, 2003): motions of even acceleration pass unchanged, so it delays nothing. The first pose is where the
  rig is and stays.
- across plans, the running mean of what successive plans say of the same time, with weights that fall with a time
  constant, twice in a row, as one mean alone still lets the wheel turn back at every noisy plan.

Both act on where the path lies to the left or right and how it heads. How far along it the vehicle is to be is left as
it is, so no brake is late and no plan to stand is blurred.

A small change of mind sideways arrives late. One of more than `DECISIVE` metres is no noise and goes through: the
weight of what was said before falls with the square of the change.
"""

from functools import lru_cache

import numpy as np

from olt_closed_loop.control.plans import TimedPoses, WorldPlan
from olt_generator.poses import Array
from olt_toolkit.policy.contract import STEP_US

DEFAULT_WINDOW, DEFAULT_DELAY = 0.2, 0.4
"""Seconds. More than this gains little against noise and delays small changes of mind by more than a quarter second."""
DECISIVE = 1.0
"""Metres to the side at which half of the weight of what was said before is gone; a lane is three times as wide."""
_MEANS = 2


class PlanSmoother:
    """Smooths the plans of one drive.

    Args:
        window: within a plan, seconds: waves of 2 pi windows are halved, shorter ones vanish. 0 for none.
        delay: across plans, time constant of each of the two means in seconds. 0 for none.
    """

    def __init__(self, window: float, delay: float) -> None:
        self._window, self._delay = window, delay
        self._given: WorldPlan | None = None
        self._means: list[TimedPoses] = []

    def __call__(self, plan: WorldPlan) -> TimedPoses:
        """What to follow where `plan` is in force; times of plans never fall."""
        if plan is not self._given:
            smooth = TimedPoses(plan.timestamps_us, plan.poses)
            if self._window:
                matrix = smoothing_matrix(len(plan.poses), self._window * 1e6 / STEP_US)
                smooth = moved_sideways(smooth, matrix @ plan.poses - plan.poses, 1.0)
            self._means = self._mean_of(smooth)
            self._given = plan
        return self._means[-1]

    def _mean_of(self, plan: TimedPoses) -> list[TimedPoses]:
        """The plan, averaged with the means before once and again."""
        if self._given is None or not self._delay:
            return [plan] * _MEANS
        age_us, means = plan.timestamps_us[0] - self._given.timestamps_us[0], []
        for before in self._means:
            plan = averaged(plan, before, float(np.exp(-age_us * 1e-6 / self._delay)))
            means.append(plan)
        return means


def averaged(plan: TimedPoses, before: TimedPoses, kept: float) -> TimedPoses:
    """A plan, moved sideways and turned by the share `kept` towards the one before, as far as that reaches."""
    off = before.at(plan.timestamps_us) - plan.poses
    off[:, 2] -= 2.0 * np.pi * np.round(off[0, 2] / (2.0 * np.pi))
    return moved_sideways(plan, off, kept * (plan.timestamps_us <= before.timestamps_us[-1]), DECISIVE)


def moved_sideways(plan: TimedPoses, off: Array, share: Array | float, decisive: float = np.inf) -> TimedPoses:
    """A plan, turned by a share of `off` (n, 3) and moved by that share of its part across the plan's own headings.

    The share falls with the square of that part over `decisive` metres.
    """
    cos, sin = np.cos(plan.poses[:, 2]), np.sin(plan.poses[:, 2])
    left = cos * off[:, 1] - sin * off[:, 0]
    weight = share / (1.0 + np.square(left / decisive))
    return TimedPoses(plan.timestamps_us, plan.poses + (weight * [-sin * left, cos * left, off[:, 2]]).T)


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
    return np.linalg.inv(system).astype(np.float64)
