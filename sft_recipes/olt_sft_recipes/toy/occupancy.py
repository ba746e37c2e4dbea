"""What the policy's sight, or the truth, says of the cells along the route: who is there and when, what is held,
and where road is.

Toy only. `Room` is the same on a finer grid and seen from the vehicle's middle line: how likely somebody is beside or
under a point of it.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from olt_generator.poses import Array
from olt_sft_recipes.toy.birds_eye import FRONT, OFFSETS, STATIONS
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD, TAKEN_WEIGHT, Sight
from olt_sft_recipes.toy.route_line import RouteLine

BODY = (-0.7, 0.7, 2.1, 3.5)
"""Metres ahead of the rig's origin of the points of the vehicle at which others are looked up."""
BESIDE = 0.2
"""Metres to both sides of them that are looked up. Cells tell of boxes up to a metre away (`training.auxiliary`)."""
ENDS, HALF_WIDTH = (-1.2, 4.0), 1.1
"""Metres ahead of the rig's origin, and to both sides of them, that must be road."""
HOLD_SECONDS = 3.0
"""How long a line that is held is not passed."""
_STATION_STEP, _OFFSET_STEP = 0.5, 0.1
_BEFORE_HELD = 0.5
_INTERVAL = SECONDS_AHEAD[1] - SECONDS_AHEAD[0]


@dataclass(frozen=True)
class Room:
    """Shares of 1 on a fine grid.

    Attributes:
        shares: (seconds and one more, stations, offsets) from each of SECONDS_AHEAD to the next; last those that stay
            all the time. The grid has a border, of 0 before and behind.
    """

    shares: NDArray[np.floating]

    @classmethod
    def of(cls, moving: NDArray[np.floating], staying: NDArray[np.floating], beside: float = 0.0) -> "Room":
        """Of shares (seconds, stations, offsets), of those (stations, offsets) that stay, and of what is beside all."""
        shares = np.pad(np.concatenate([moving, staying[None]]), ((0, 0), (0, 0), (1, 1)), constant_values=beside)
        return cls(np.pad(shares, ((0, 0), (1, 1), (0, 0))))

    def taken(self, seconds: Array | None, stations: Array, offsets: Array) -> NDArray[np.floating]:
        """How likely somebody is there (...) at times and places that are broadcast; None for who stays."""
        last = len(self.shares) - 1
        when = last if seconds is None else np.clip((seconds / _INTERVAL + 1e-6).astype(np.int64), 0, last - 1)
        _, rows, columns = self.shares.shape
        row = np.clip((stations - STATIONS[0]) / _STATION_STEP + 1.5, 0.0, rows - 0.5).astype(np.int64)
        column = np.clip((offsets - OFFSETS[0]) / _OFFSET_STEP + 1.5, 0.0, columns - 0.5).astype(np.int64)
        return self.shares[when, row, column]


@dataclass(frozen=True)
class Occupancy:
    """What is thought to be taken, as shares of 1.

    Attributes:
        route: (seconds, stations, offsets) how near somebody is to each cell.
        held: (stations,) the way held now.
        road: (stations, offsets) road.
        line: the middle of the route grid.
    """

    route: Array
    held: Array
    road: Array
    line: RouteLine

    @classmethod
    def of(cls, sight: Sight, line: RouteLine) -> "Occupancy":
        """What the sight of one observation thinks."""
        # Taken back is by how much taken cells count more in training, so that these are probabilities.
        return cls._of((sight.route[0] - math.log(TAKEN_WEIGHT)).sigmoid().double().numpy(), line)

    @classmethod
    def of_truth(cls, route: NDArray[np.uint8], line: RouteLine) -> "Occupancy":
        """What is really taken (`training.auxiliary.gather_truth`, of one sample)."""
        return cls._of(route / 255.0, line)

    @classmethod
    def _of(cls, told: Array, line: RouteLine) -> "Occupancy":
        return cls(told[:-2], told[-2].mean(axis=-1), told[-1], line)

    @cached_property
    def room(self) -> Room:
        """Who is beside the vehicle's middle line, on a fine grid."""
        shares = _refined(self.route)
        shares = maximum_filter1d(shares, 2 * round(BESIDE / _OFFSET_STEP) + 1, axis=2)
        shares = maximum_filter1d(shares, 3, axis=1)
        between = np.maximum(shares, np.concatenate([shares[1:], shares[-1:]]))
        return Room.of(between, np.minimum(shares[0], shares[-1]))

    @cached_property
    def roadside(self) -> Room:
        """How likely the vehicle, turned along the route, has a side where no road is, on the same grid.

        Beside the grid no road is known: whoever goes straight on where the route turns leaves the road.
        """
        beyond = maximum_filter1d(1.0 - _refined(self.road[None]), 2 * round(HALF_WIDTH / _OFFSET_STEP) + 1, axis=2)
        return Room.of(beyond, beyond[0], beside=1.0)

    def off_road(self, station: Array, left: Array, turned: Array) -> Array:
        """How likely the vehicle is off the road (...) at places beside the route (...)."""
        aside = np.sin(turned)
        return np.max([self.roadside.taken(None, station + at, left + at * aside) for at in ENDS], axis=0)

    def contacts(self, seconds: Array, station: Array, left: Array, turned: Array) -> Array:
        """How likely the vehicle meets somebody (...) at times and places beside the route (...)."""
        aside = np.sin(turned)
        return np.max([self.room.taken(seconds, station + at, left + at * aside) for at in BODY], axis=0)

    def crossings(self, seconds: Array, station: Array) -> Array:
        """How likely plans that are at stations (..., times) at times pass a line that is held (...)."""
        front = FRONT + np.where(seconds <= HOLD_SECONDS, station, -np.inf).max(axis=-1)[..., None]
        return np.where((STATIONS > FRONT) & (front > STATIONS - _BEFORE_HELD), self.held, 0.0).max(axis=-1)


def _refined(cells: Array) -> NDArray[np.floating]:
    """Shares of cells (k, stations, offsets) on the fine grid."""
    shares: NDArray[np.floating] = cells.astype(np.float32)
    for axis, fine, coarse in (
        (1, np.arange(STATIONS[0], STATIONS[-1], _STATION_STEP), STATIONS),
        (2, np.arange(OFFSETS[0], OFFSETS[-1] + 1e-6, _OFFSET_STEP), OFFSETS),
    ):
        place = np.interp(fine, coarse, np.arange(len(coarse)))
        before = np.minimum(place.astype(np.int64), len(coarse) - 2)
        share = (place - before).astype(np.float32).reshape(-1, *[1] * (2 - axis))
        shares = np.take(shares, before, axis) * (1.0 - share) + np.take(shares, before + 1, axis) * share
    return shares
