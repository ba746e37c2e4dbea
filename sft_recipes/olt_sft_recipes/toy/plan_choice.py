"""Of several plans the one that the policy's own sight finds free. Toy only.

With every plan that it is given, plans a little to its sides are tried, and such that brake along all of these paths. A
plan is worth the way that it makes in its 6.4 s, less what its sight thinks that it runs into: somebody, at the times
and places where the vehicle would be, or a line that is held.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from olt_generator.poses import Array
from olt_sft_recipes.toy.birds_eye import FRONT, STATIONS, WORLD_CELL, WORLD_X, WORLD_Y
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD, TAKEN_WEIGHT, Sight
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS

BRAKING = (1.5, 3.0, 5.0, 7.0)
"""Decelerations that are tried, m/s2."""
ASIDE = (0.0, 0.6, -0.6)
"""Metres to the left of a plan that are tried."""
ASIDE_METRES = 12.0
"""Way on which it gets there."""
WAY_WORTH = 0.06
"""What the whole way is worth, against 1 for a contact that is certain and now (`olt bench plan_choice`)."""
ASIDE_COST = 0.02
"""What a metre aside costs."""
FADES = 0.15
"""By how much less a contact counts for every second until then: there is time to see better."""
PROBES: Array = np.array([-0.2, 1.4, 3.0])
"""Metres ahead of the rig's origin of the points of the vehicle that are looked up."""
HOLD_SECONDS = 3.0
_BESIDE = 1.3
_LEAST_WAY = 1.0


@dataclass(frozen=True)
class Occupancy:
    """What is thought to be taken, as shares of 1.

    Attributes:
        route: (seconds, stations, offsets); held: (stations,) the way held now.
        world: (seconds, rows, columns).
        cells: of the route grid, their places in the rig frame.
    """

    route: Array
    held: Array
    world: Array
    cells: KDTree

    @classmethod
    def of(cls, sight: Sight, along: Array) -> "Occupancy":
        """What the sight of one observation thinks, with the cells (stations, offsets, 3) of its route grid."""
        # Taken back is by how much taken cells count more in training, so that these are probabilities.
        odds = math.log(TAKEN_WEIGHT)
        route, world = ((logits[0] - odds).sigmoid().double().numpy() for logits in (sight.route, sight.world))
        return cls(route[:-1], route[-1].mean(axis=-1), world, KDTree(along[..., :2].reshape(-1, 2)))

    @classmethod
    def of_truth(cls, route: NDArray[np.uint8], world: NDArray[np.uint8], along: Array) -> "Occupancy":
        """What is really taken (`training.auxiliary.gather_truth`, of one sample)."""
        told = route.astype(np.float64)
        return cls(told[:-1], told[-1].mean(axis=-1), world.astype(np.float64), KDTree(along[..., :2].reshape(-1, 2)))

    def contacts(self, plans: Array) -> Array:
        """How likely plans (..., steps, 3) of x, y, yaw meet somebody (...), contacts later counted less."""
        steps = min(plans.shape[-2], round(SECONDS_AHEAD[-1] / STEP_SECONDS))
        time = STEP_SECONDS * np.arange(1, steps + 1)
        second = np.rint(time / (SECONDS_AHEAD[1] - SECONDS_AHEAD[0])).astype(np.int64)[:, None]
        x, y, yaw = (plans[..., :steps, axis, None] for axis in range(3))
        x, y = x + PROBES * np.cos(yaw), y + PROBES * np.sin(yaw)
        away, nearest = self.cells.query(np.stack([x, y], axis=-1))
        on_route = self.route.reshape(len(self.route), -1)[second, nearest]
        row, column = (
            np.rint((at - begin[0]) / WORLD_CELL).astype(np.int64) for at, begin in ((x, WORLD_X), (y, WORLD_Y))
        )
        inside = (row >= 0) & (row < len(WORLD_X)) & (column >= 0) & (column < len(WORLD_Y)) & (x > FRONT)
        off_route = self.world[second, np.clip(row, 0, len(WORLD_X) - 1), np.clip(column, 0, len(WORLD_Y) - 1)]
        taken = np.where(away < _BESIDE, on_route, np.where(inside, off_route, 0.0)).max(axis=-1)
        return np.asarray((taken * (1.0 - FADES * time)).max(axis=-1))

    def crossings(self, ways: Array) -> Array:
        """How likely plans that make ways (..., steps) in metres pass a line that is held (...)."""
        front = FRONT + ways[..., round(HOLD_SECONDS / STEP_SECONDS) - 1, None]
        return np.where((STATIONS > FRONT) & (front > STATIONS), self.held, 0.0).max(axis=-1)


def choose_plan(plans: Array, speed: float, occupancy: Occupancy, way_worth: float = WAY_WORTH) -> Array:
    """The best (64, 3) of plans (k, 64, 3) of x, y, yaw, of those beside them, and of those that brake from a speed."""
    tried = np.stack([slower_plans(plan_beside(plan, aside), speed) for plan in plans for aside in ASIDE])
    ways = ways_along(tried)
    farthest = max(float(ways[..., -1].max()), _LEAST_WAY)
    worth = way_worth * ways[..., -1] / farthest
    worth -= ASIDE_COST * np.tile(np.abs(ASIDE), len(plans))[:, None]
    worth -= np.maximum(occupancy.contacts(tried), occupancy.crossings(ways))
    return tried[np.unravel_index(int(worth.argmax()), worth.shape)]


def ways_along(plans: Array) -> Array:
    """Metres (..., steps) that plans (..., steps, 3) have made until each step."""
    return np.cumsum(np.linalg.norm(np.diff(plans[..., :2], axis=-2, prepend=0.0), axis=-1), axis=-1)


def plan_beside(plan: Array, aside: float) -> Array:
    """A plan (64, 3) that goes over to a path so many metres to the left."""
    way = ways_along(plan)
    share = np.minimum(way / ASIDE_METRES, 1.0)
    offset = aside * share**2 * (3.0 - 2.0 * share)
    slope = aside * 6.0 * share * (1.0 - share) / ASIDE_METRES
    x, y, yaw = plan.T
    return np.stack([x - offset * np.sin(yaw), y + offset * np.cos(yaw), yaw + np.arctan(slope)], axis=-1)


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
