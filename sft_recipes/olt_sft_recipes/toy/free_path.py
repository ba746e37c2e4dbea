"""The freest path along the route, by dynamic programming over stations, offsets and slopes. Toy only.

The lattice of Werling et al. (ICRA 2010) without time: when the vehicle is at a station is told by a speed. The slope
is part of the state, so that bends cost; what is found is smoothed.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from olt_generator.poses import Array
from olt_sft_recipes.toy.occupancy import BODY, Occupancy
from olt_sft_recipes.toy.route_line import STEP
from olt_sft_recipes.toy.tried_paths import LENGTH, TriedPath

STATION_STEP, COUNT = 2.0, 24
OFFSETS: Array = 0.2 * np.arange(-22, 23, dtype=np.float64)
SLOPES: Array = 0.1 * np.arange(-5, 6, dtype=np.float64)
"""Metres to the left for every metre of way, so that a slope leads from offset to offset."""
MOST_CHANGE = 2
"""Steps of slope from one station to the next."""
TAKEN, OFF_ROAD, ASIDE, SLOPE, BEND = 4.0, 3.0, 0.01, 0.006, 0.012
"""What it costs to be where somebody is, off the road, a metre aside, a step of slope and a step of change, squared."""

_STEPS = np.arange(-5, 6)
_FROM = np.arange(len(OFFSETS)) - _STEPS[:, None]
_OUTSIDE: Array = np.where((_FROM < 0) | (len(OFFSETS) <= _FROM), np.inf, 0.0)
_CHANGE = _STEPS[:, None] - _STEPS
_SLOPED: Array = (
    np.where(np.abs(_CHANGE) <= MOST_CHANGE, BEND * _CHANGE**2, np.inf) + SLOPE * _STEPS.astype(float)[:, None] ** 2
)
_SMOOTHING, _FINE_SMOOTHING = 1.0, 2.5
_RETURN, _TURNS_BACK = 5.0, 4.0


def find_free_path(occupancy: Occupancy, speed: float | None) -> TriedPath:
    """The freest path from the vehicle on.

    Args:
        occupancy: who is where, and when, and where the road is.
        speed: m/s at which the path is driven; None where it is to be free of those who stay, whenever it is driven.
    """
    line = occupancy.line
    station, left, turned = line.locate(np.zeros(3)).tolist()
    stations = station + STATION_STEP * np.arange(COUNT)
    start = math.tan(np.clip(turned, math.atan(SLOPES[0]), math.atan(SLOPES[-1])))
    found = _cheapest(_costs(occupancy, stations, speed), left, start)
    way = np.arange(0.0, LENGTH, STEP)
    smooth = gaussian_filter1d(OFFSETS[found], _SMOOTHING, mode="nearest")
    offsets = gaussian_filter1d(np.interp(way, stations - station, smooth), _FINE_SMOOTHING, mode="nearest")
    offsets += (left - offsets[0]) * np.exp(-way / _RETURN)
    offsets += (start - (offsets[1] - offsets[0]) / STEP) * way * np.exp(-way / _TURNS_BACK)
    return TriedPath.beside(line, station + way, offsets)


def _costs(occupancy: Occupancy, stations: Array, speed: float | None) -> Array:
    """What it costs (stations, slopes, offsets) to be there."""
    at, slopes, offsets = stations[:, None, None], SLOPES[:, None], OFFSETS
    seconds = None if speed is None else (at - stations[0]) / speed
    taken = np.max([occupancy.room.taken(seconds, at + ahead, offsets + ahead * slopes) for ahead in BODY], axis=0)
    off_road = occupancy.off_road(at, offsets, np.arcsin(slopes))
    return TAKEN * taken + OFF_ROAD * off_road + ASIDE * np.abs(offsets)


def _cheapest(costs: Array, offset: float, slope: float) -> NDArray[np.int64]:
    """Indices (stations,) of the offsets of the cheapest path that begins at an offset with a slope."""
    total = np.full(costs.shape[1:], np.inf)
    total[np.argmin(np.abs(SLOPES - slope)), np.argmin(np.abs(OFFSETS - offset))] = 0.0
    before, came = np.clip(_FROM, 0, len(OFFSETS) - 1), list[NDArray[np.int64]]()
    for cost in costs[1:]:
        reached = total.T[before] + _OUTSIDE[..., None] + _SLOPED[:, None]  # (slope, offset, slope before)
        came.append(reached.argmin(axis=-1))
        total = reached.min(axis=-1) + cost
    to, place = np.unravel_index(int(total.argmin()), total.shape)
    indices = [int(place)]
    for origin in reversed(came):
        to, place = origin[to, place], before[to, place]
        indices.append(int(place))
    return np.array(indices[::-1])
