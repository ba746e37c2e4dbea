"""Of several plans the one that the policy's own sight finds free. Toy only.

Tried are many paces (`paces`) along many paths: those of the plans that it is given, such that go over to another place
on the road (`tried_paths`), and the freest ones (`free_path`). A plan is worth the way that it makes, the sooner the
better, in the seconds of which its sight tells. It costs what it is thought to run into then and in coming to a stand
after that, a line that is held, being off the road, being close behind somebody, standing where there is no way out,
and being aside.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from olt_generator.poses import Array
from olt_sft_recipes.toy.birds_eye import STATIONS
from olt_sft_recipes.toy.free_path import find_free_path
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD
from olt_sft_recipes.toy.occupancy import BODY, Occupancy
from olt_sft_recipes.toy.paces import ACCELERATIONS, pace_ways
from olt_sft_recipes.toy.route_line import LATERAL
from olt_sft_recipes.toy.tried_paths import TriedPath, drawn_paths, paths_aside
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS

WAY_WORTH = 0.12
"""What the way of all seconds at CRUISE is worth, against 1 for a contact that is certain and now."""
CRUISE = 8.0
"""Speed that a free road is driven with where no plan is faster, m/s."""
FASTEST = float(STATIONS[-1]) / SECONDS_AHEAD[-1]
"""Speed that is never exceeded, m/s: faster, a plan would lead farther than is told."""
FADES, LEAST_FADED = 0.12, 0.3
"""By how much less a contact counts for every second until then, and what is left: there is time to see better."""
STANDING, MOVING = 0.15, 1.0
"""What a contact counts for who stands, and the speed from which on it counts whole, m/s."""
OFF_ROAD_COST = 1.0
"""What it costs to be off the road at all."""
CLOSE_COST, CLOSE = 0.05, (2.5, 5.0)
"""What it costs to be behind somebody all the time, and how many metres ahead on its path are looked at."""
SHUT_COST, WAY_OUT = 0.5, (1.0, 2.5, 4.0, 5.5, 7.0)
"""What it costs to stand straight before somebody who stays, and how many metres before the vehicle are looked at: who
stops too close does not get around any more."""
OUT_COST, OUT, TOO_FAST = 0.3, (1.0, 2.0), (CRUISE, CRUISE + 2.0)
"""What it costs to be out of the lane, and faster than a free road is driven with, all the time: from so many metres
aside and m/s on, and whole at so many. Who was learned from was seldom there: its sight tells less than it seems to."""
BEND_COST = 0.3
"""What it costs to accelerate to the side by twice LATERAL all the time."""
SHARPEST = 0.16
"""Curvature beyond which a path is not driven, 1/m; it costs 1 for every SHARPEST more."""
ASIDE_COST = 0.02
"""What a metre aside costs."""
EFFORT_COST = 0.0015
"""What it costs to accelerate or brake with 1 m/s2 at first and with as much later; with the square of it."""
OTHER_COST, FREE_COST = 0.01, 0.003
"""What it costs to take a path aside, or the freest one, in place of one that was drawn."""
STOPPING = 3.0
"""Deceleration of coming to a stand after the seconds that are told, m/s2."""
_LAST_STEPS = 10
_EVERY = 2
_LOOKED_UP = np.arange(_EVERY - 1, FUTURE_STEPS, _EVERY)
_SECONDS: Array = STEP_SECONDS * (1 + _LOOKED_UP.astype(np.float64))
_TOLD = round(SECONDS_AHEAD[-1] / STEP_SECONDS)
_BEFORE = _LOOKED_UP < _TOLD
_FADED: Array = np.maximum(1.0 - FADES * _SECONDS, LEAST_FADED)


@dataclass(frozen=True)
class _Paces:
    """Paces from a speed.

    Attributes:
        driven: ways (paces, 64), metres.
        ways, speeds: (paces, times) where it is looked up who is there; after the seconds that are told they brake.
        last: (paces,) speeds at the end of those.
    """

    driven: Array
    ways: Array
    speeds: Array
    last: Array

    @classmethod
    def of(cls, speed: float, most: float) -> "_Paces":
        driven, speeds = pace_ways(speed, most)
        last = speeds[:, _TOLD - 1]
        braked = np.minimum(np.maximum(_SECONDS - SECONDS_AHEAD[-1], 0.0), last[:, None] / STOPPING)
        stopping = driven[:, _TOLD - 1, None] + last[:, None] * braked - 0.5 * STOPPING * braked**2
        ways = np.where(_BEFORE, driven[:, _LOOKED_UP], stopping)
        return cls(driven, ways, np.where(_BEFORE, speeds[:, _LOOKED_UP], last[:, None] - STOPPING * braked), last)


def choose_plan(plans: Array, speed: float, occupancy: Occupancy, way_worth: float = WAY_WORTH) -> Array:
    """The best (64, 3) of what is tried in place of plans (k, 64, 3) of x, y, yaw, from a speed in m/s."""
    line = occupancy.line
    paces = _Paces.of(speed, _most_speed(plans, speed, line.bend_speed))
    tried = [(path, 0.0) for path in drawn_paths(plans, line)]
    tried += [(path, OTHER_COST) for path in paths_aside(line, speed)]
    tried += [(find_free_path(occupancy, at), FREE_COST) for at in (None, max(speed, 0.5 * CRUISE))]
    paths, costs = zip(*tried, strict=True)
    worth = _worth(paths, paces, occupancy, way_worth) - np.array(costs)[:, None]
    path, pace = np.unravel_index(int(worth.argmax()), worth.shape)
    return paths[path].poses_at(paces.driven[pace])


def _most_speed(plans: Array, speed: float, bend_speed: float) -> float:
    """Speed that is not exceeded, m/s."""
    last = float(np.hypot(*(plans[0, -1, :2] - plans[0, -1 - _LAST_STEPS, :2]))) / (STEP_SECONDS * _LAST_STEPS)
    return min(max(last, speed, CRUISE), bend_speed, FASTEST)


def _worth(paths: Sequence[TriedPath], paces: _Paces, occupancy: Occupancy, way_worth: float) -> Array:
    """What paces along paths are worth (paths, paces)."""
    station, left, turned = np.stack([path.beside_at(paces.ways) for path in paths], axis=1)
    made = 2.0 * paces.ways[:, _BEFORE].mean(axis=1) + 0.5 * paces.last
    counts = (STANDING + (1.0 - STANDING) * np.minimum(paces.speeds / MOVING, 1.0)) * _FADED
    met = (occupancy.contacts(_SECONDS, station, left, turned) * counts).max(axis=-1)
    bends = np.stack([np.interp(paces.ways[:, _BEFORE], path.arc, path.bends) for path in paths])
    before = station[..., _BEFORE], left[..., _BEFORE], turned[..., _BEFORE]
    sideways = paces.speeds[:, _BEFORE] ** 2 * bends
    return (
        way_worth * made / (CRUISE * (SECONDS_AHEAD[-1] + 0.5))
        - np.maximum(met, occupancy.crossings(_SECONDS, station))
        - OFF_ROAD_COST * occupancy.off_road(*before).max(axis=-1)
        - CLOSE_COST * _close(paths, paces, occupancy)
        - SHUT_COST * _shut(occupancy, station[..., -1], left[..., -1], turned[..., -1])
        - OUT_COST * (_share(np.abs(before[1]), OUT) * _share(paces.speeds[:, _BEFORE], TOO_FAST)).mean(axis=-1)
        - BEND_COST * np.maximum(sideways / LATERAL - 1.0, 0.0).mean(axis=-1)
        - np.maximum(bends / SHARPEST - 1.0, 0.0).max(axis=-1)
        - ASIDE_COST * np.abs(before[1]).mean(axis=-1)
        - EFFORT_COST * 0.5 * (ACCELERATIONS**2).sum(axis=0)
    )


def _share(values: Array, between: tuple[float, float]) -> Array:
    """How much of the way from one value to the other has been made, 0 to 1."""
    return np.clip((values - between[0]) / (between[1] - between[0]), 0.0, 1.0)


def _close(paths: Sequence[TriedPath], paces: _Paces, occupancy: Occupancy) -> Array:
    """For how much of CLOSE and of the time somebody is ahead on each path at each pace (paths, paces)."""
    found = np.zeros((len(paths), len(paces.ways)))
    for beyond in BODY[-1] + np.array(CLOSE):
        station, left, _ = np.stack([path.beside_at(paces.ways[:, _BEFORE] + beyond) for path in paths], axis=1)
        found += occupancy.room.taken(_SECONDS[_BEFORE], station, left).mean(axis=-1)
    return found / len(CLOSE)


def _shut(occupancy: Occupancy, station: Array, left: Array, turned: Array) -> Array:
    """For how much of WAY_OUT somebody who stays is straight ahead of places (paths, paces) beside the route."""
    beyond = BODY[-1] + np.array(WAY_OUT)[:, None, None]
    return occupancy.room.taken(None, station + beyond, left + beyond * np.sin(turned)).mean(axis=0)


def contacts_of_plan(plan: Array, occupancy: Occupancy) -> float:
    """How likely a plan (64, 3) of x, y, yaw meets somebody, contacts later counted less."""
    station, left, turned = occupancy.line.locate(plan[_LOOKED_UP[_BEFORE]]).T
    return float((occupancy.contacts(_SECONDS[_BEFORE], station, left, turned) * _FADED[_BEFORE]).max())
