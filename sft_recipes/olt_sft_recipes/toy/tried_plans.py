"""The plans that are tried: those that are drawn, such a little beside them, and all of these slower and faster.

Toy only. Plans drawn start to move late, and no plan of a vehicle that is to start again now and again ever starts: so
such are tried that come to their speed at once, and gently.
"""

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_sft_recipes.toy.route_line import RouteLine
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS

BRAKING: Array = np.array([1.5, 3.0, 5.0, 7.0])
"""Decelerations, m/s2."""
GENTLE = 0.5
"""Acceleration of who starts gently, m/s2."""
SPEEDING: Array = np.array([1.0, 2.0])
"""Accelerations of who comes sooner to the speed that a plan ends with, m/s2."""
CRUISE = 8.0
"""Speed beyond which none is sped up, m/s."""
ASIDE = (0.0, 0.6, -0.6)
"""Metres to the left of a plan."""
ASIDE_SECONDS, ASIDE_METRES = 2.5, (8.0, 20.0)
"""Time in which it gets there, and the least and the most way."""
PACES = 1 + len(BRAKING) + 1 + len(SPEEDING)
_LAST_STEPS = 10
_TIME = STEP_SECONDS * np.arange(1, FUTURE_STEPS + 1)


def try_plans(plans: Array, speed: float, line: RouteLine) -> tuple[Array, Array]:
    """What is tried in place of plans (k, 64, 3) of x, y, yaw, from a speed in m/s.

    Returns:
        (n, PACES, 64, 3) plans, and how many metres to the left of its plan each of the n paths goes.
    """
    paths = [np.concatenate([plan, line.beyond(plan[-1])]) for plan in plans]
    tried = [paced_plans(path_beside(path, aside, speed), speed, line.bend_speed) for path in paths for aside in ASIDE]
    return np.stack(tried), np.tile(ASIDE, len(plans))


def ways_along(plans: Array) -> Array:
    """Metres (..., steps) that plans (..., steps, 3) have made until each step."""
    return np.cumsum(np.linalg.norm(np.diff(plans[..., :2], axis=-2, prepend=0.0), axis=-1), axis=-1)


def path_beside(path: Array, aside: float, speed: float) -> Array:
    """A path (n, 3) that goes over to one so many metres to the left."""
    metres = np.clip(ASIDE_SECONDS * speed, *ASIDE_METRES)
    share = np.minimum(ways_along(path) / metres, 1.0)
    offset = aside * share**2 * (3.0 - 2.0 * share)
    slope = aside * 6.0 * share * (1.0 - share) / metres
    x, y, yaw = path.T
    return np.stack([x - offset * np.sin(yaw), y + offset * np.cos(yaw), yaw + np.arctan(slope)], axis=-1)


def paced_plans(path: Array, speed: float, bend_speed: float) -> Array:
    """The plan that a path (64 or more, 3) begins with, and others along that path (PACES, 64, 3).

    They brake by BRAKING, start no faster than GENTLE, or come by SPEEDING to the speed that the plan ends with, where
    that is faster than now, no faster than CRUISE and the bends ahead allow it; they are no slower than the plan.
    """
    whole = np.concatenate([np.zeros((1, 3)), path])
    way = np.concatenate([[0.0], ways_along(path)])
    own = way[1 : FUTURE_STEPS + 1]
    last = (own[-1] - own[-1 - _LAST_STEPS]) / (STEP_SECONDS * _LAST_STEPS)
    most = max(min(float(last), bend_speed, CRUISE), speed)
    paces = [np.minimum(_ways(speed, -BRAKING, 0.0), own)]
    if most > speed:
        paces += [np.minimum(_ways(speed, np.array([GENTLE]), most), own)]
        paces += [np.maximum(_ways(speed, SPEEDING, most), own)]
    else:
        paces += [np.tile(own, (1 + len(SPEEDING), 1))]
    ways = np.concatenate(paces)
    moving: NDArray[np.bool_] = np.concatenate([[True], np.diff(way) > 1e-6])
    paced = np.stack([np.interp(ways, way[moving], column) for column in whole[moving].T], axis=-1)
    return np.concatenate([path[None, :FUTURE_STEPS], paced])


def _ways(speed: float, accelerations: Array, until: float) -> Array:
    """Metres (n, 64) that are made from one speed to another, at accelerations (n,), and on at that."""
    changing = np.minimum(_TIME, (until - speed) / accelerations[:, None])
    return speed * changing + 0.5 * accelerations[:, None] * changing**2 + until * (_TIME - changing)
