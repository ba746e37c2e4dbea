"""Of several plans the one that the policy's own sight finds free. Toy only.

Tried are the plans that it is given, such a little to their sides, and all of these slower and faster (`tried_plans`).
A plan is worth the way that it makes in the seconds of which its sight tells, less what that thinks that it runs into,
somebody at the times and places where the vehicle would be or a line that is held, and less for being where the road
likely is no more (`route_line`).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_sft_recipes.toy.birds_eye import FRONT, STATIONS, WORLD_CELL, WORLD_X, WORLD_Y
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD, TAKEN_WEIGHT, Sight
from olt_sft_recipes.toy.route_line import RouteLine
from olt_sft_recipes.toy.tried_plans import try_plans, ways_along
from olt_toolkit.policy.contract import STEP_SECONDS

WAY_WORTH = 0.08
"""What the whole way is worth, against 1 for a contact that is certain and now (`olt bench plan_choice`)."""
ASIDE_COST = 0.02
"""What a metre aside costs."""
OFF_ROAD_COST = 1.0
"""What it costs to be off the road all the time."""
FADES = 0.15
"""By how much less a contact counts for every second until then: there is time to see better."""
PROBES: Array = np.array([-0.2, 1.4, 3.0])
"""Metres ahead of the rig's origin of the points of the vehicle that are looked up."""
HOLD_SECONDS = 3.0
_BESIDE = 1.3
_LEAST_WAY = 1.0
_STEPS = round(SECONDS_AHEAD[-1] / STEP_SECONDS)


@dataclass(frozen=True)
class Occupancy:
    """What is thought to be taken, as shares of 1.

    Attributes:
        route: (seconds, stations, offsets); held: (stations,) the way held now.
        world: (seconds, rows, columns).
        line: the middle of the route grid.
    """

    route: Array
    held: Array
    world: Array
    line: RouteLine

    @classmethod
    def of(cls, sight: Sight, line: RouteLine) -> "Occupancy":
        """What the sight of one observation thinks."""
        # Taken back is by how much taken cells count more in training, so that these are probabilities.
        odds = math.log(TAKEN_WEIGHT)
        route, world = ((logits[0] - odds).sigmoid().double().numpy() for logits in (sight.route, sight.world))
        return cls(route[:-1], route[-1].mean(axis=-1), world, line)

    @classmethod
    def of_truth(cls, route: NDArray[np.uint8], world: NDArray[np.uint8], line: RouteLine) -> "Occupancy":
        """What is really taken (`training.auxiliary.gather_truth`, of one sample)."""
        told = route.astype(np.float64)
        return cls(told[:-1], told[-1].mean(axis=-1), world.astype(np.float64), line)

    def contacts(self, plans: Array) -> Array:
        """How likely plans (..., steps, 3) of x, y, yaw meet somebody (...), contacts later counted less."""
        plans = plans[..., :_STEPS, :]
        time = STEP_SECONDS * np.arange(1, plans.shape[-2] + 1)
        second = np.rint(time / (SECONDS_AHEAD[1] - SECONDS_AHEAD[0])).astype(np.int64)[:, None]
        x, y, yaw = (plans[..., axis, None] for axis in range(3))
        x, y = x + PROBES * np.cos(yaw), y + PROBES * np.sin(yaw)
        away, nearest = self.line.cells.query(np.stack([x, y], axis=-1))
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
    """The best (64, 3) of what is tried in place of plans (k, 64, 3) of x, y, yaw, from a speed in m/s."""
    tried, aside = try_plans(plans, speed, occupancy.line)
    ways = ways_along(tried)
    made = ways[..., _STEPS - 1]
    worth = way_worth * made / max(float(made.max()), _LEAST_WAY)
    worth -= ASIDE_COST * np.abs(aside)[:, None]
    worth -= np.maximum(occupancy.contacts(tried), occupancy.crossings(ways))
    worth -= OFF_ROAD_COST * occupancy.line.off_road(tried[..., :_STEPS, :])
    return tried[np.unravel_index(int(worth.argmax()), worth.shape)]
