"""Of several plans the one that the policy's own sight finds free. Toy only.

Beside every plan that it is given, plans along the same path are tried that brake. A plan is worth the way that it
makes in its 6.4 s, less what its sight thinks that it runs into: somebody, at the times and places where the vehicle
would be, or a line that is held.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_sft_recipes.toy.birds_eye import STATIONS, WORLD_CELL, WORLD_X, WORLD_Y
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS

BRAKING = (1.5, 3.0, 5.0, 7.0)
"""Decelerations that are tried, m/s2."""
WAY_WORTH = 0.35
"""What the whole way is worth, against 1 for a contact that is certain and now."""
FADES = 0.12
"""By how much less a contact counts for every second until then: there is time to see better."""
PROBES: Array = np.array([-0.2, 1.4, 3.0])
"""Metres ahead of the rig's origin of the points of the vehicle that are looked up."""
FRONT = 4.1
HOLD_SECONDS = 3.0
_BESIDE = 1.3
_LEAST_WAY = 1.0


@dataclass(frozen=True)
class Outlook:
    """What is thought to be taken, as shares of 1.

    Attributes:
        route: (seconds, stations, offsets); held: (stations,) the way held now.
        world: (seconds, rows, columns).
        along: (stations, offsets, 3) the cells of the route grid.
    """

    route: Array
    held: Array
    world: Array
    along: Array

    def contact(self, poses: Array) -> float:
        """How likely it is that plans (steps, 3) of x, y, yaw meet somebody, contacts later counted less."""
        steps = min(len(poses), round(SECONDS_AHEAD[-1] / STEP_SECONDS))
        time = STEP_SECONDS * np.arange(1, steps + 1)
        second = np.rint(time / (SECONDS_AHEAD[1] - SECONDS_AHEAD[0])).astype(np.int64)[:, None]
        x, y, yaw = (column[:steps, None] for column in poses.T)
        x, y = x + PROBES * np.cos(yaw), y + PROBES * np.sin(yaw)
        cells = self.along[..., :2].reshape(-1, 2)
        apart = np.hypot(x[..., None] - cells[:, 0], y[..., None] - cells[:, 1])
        nearest = apart.argmin(axis=-1)
        beside = np.take_along_axis(apart, nearest[..., None], axis=-1)[..., 0] < _BESIDE
        on_route = self.route.reshape(len(self.route), -1)[second, nearest]
        row, column = (
            np.rint((at - begin[0]) / WORLD_CELL).astype(np.int64) for at, begin in ((x, WORLD_X), (y, WORLD_Y))
        )
        inside = (row >= 0) & (row < len(WORLD_X)) & (column >= 0) & (column < len(WORLD_Y)) & (x > FRONT)
        off_route = self.world[second, np.clip(row, 0, len(WORLD_X) - 1), np.clip(column, 0, len(WORLD_Y) - 1)]
        taken = np.where(beside, on_route, np.where(inside, off_route, 0.0)).max(axis=1)
        return float((taken * (1.0 - FADES * time)).max())

    def crossing(self, way: Array) -> float:
        """How likely a plan that makes a way (steps,) in metres passes a line that is held."""
        front = FRONT + way[round(HOLD_SECONDS / STEP_SECONDS) - 1]
        passed = (STATIONS > FRONT) & (front > STATIONS)
        return float(self.held[passed].max(initial=0.0))


def choose_plan(plans: Array, speed: float, outlook: Outlook) -> Array:
    """The best (64, 3) of plans (k, 64, 3) of x, y, yaw and of those that brake along them from a speed, m/s."""
    tried = np.concatenate([slower_plans(plan, speed) for plan in plans])
    ways = np.cumsum(np.linalg.norm(np.diff(tried[..., :2], axis=1, prepend=0.0), axis=-1), axis=1)
    farthest = max(float(ways[:, -1].max()), _LEAST_WAY)
    worth = [
        WAY_WORTH * way[-1] / farthest - max(outlook.contact(plan), outlook.crossing(way))
        for plan, way in zip(tried, ways, strict=True)
    ]
    return tried[int(np.argmax(worth))]


def slower_plans(plan: Array, speed: float) -> Array:
    """A plan (64, 3) and those along its path that brake by BRAKING, (1 + 4, 64, 3)."""
    path = np.concatenate([np.zeros((1, 3)), plan])
    moves = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(moves)])
    moving: NDArray[np.bool_] = np.concatenate([[True], moves > 1e-6])
    time = STEP_SECONDS * np.arange(1, FUTURE_STEPS + 1)
    slower = [plan]
    for braking in BRAKING:
        until = np.minimum(time, speed / braking)
        braked = np.minimum(speed * until - 0.5 * braking * until**2, way[1:])
        slower.append(np.stack([np.interp(braked, way[moving], column) for column in path[moving].T], axis=-1))
    return np.stack(slower)
