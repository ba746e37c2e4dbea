"""The paths that are tried: those of the plans that are drawn, and such that go over to another place on the road.

Toy only.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from olt_generator.poses import Array
from olt_sft_recipes.toy.route_line import STEP, RouteLine

ASIDE: Array = np.array([-4.0, -3.25, -2.5, -1.75, -1.0, -0.5, 0.0, 0.5, 1.0, 1.75, 2.5, 3.25, 4.0])
"""Metres to the left of the route that paths go over to."""
SHORT, LONG = (9.0, 2.0, 20.0), (16.0, 4.0, 32.0)
"""The way that going over takes: at least so many metres, so many seconds, at most so many metres."""
LENGTH = 80.0
"""Metres that paths are long."""
_LEAST_WAY = 1.0
_MOST_TURNED = 0.6


@dataclass(frozen=True)
class TriedPath:
    """A path from the vehicle on.

    Attributes:
        arc: (n,) rising, metres.
        poses: (n, 3) x, y in metres and yaw in the rig frame.
        places: (n, 3) station, metres to the left of the route and turn against it.
    """

    arc: Array
    poses: Array
    places: Array

    @classmethod
    def of(cls, poses: Array, line: RouteLine) -> "TriedPath":
        """The path of poses (n, 3), of which those that are where the one before was are left out."""
        steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
        moved = np.concatenate([[True], steps > 1e-6])
        arc = np.concatenate([[0.0], np.cumsum(steps)])[moved]
        return cls(arc, poses[moved], line.locate(poses[moved]))

    @classmethod
    def beside(cls, line: RouteLine, stations: Array, offsets: Array) -> "TriedPath":
        """The path that is at rising stations (n,) so many metres to the left of a line (n,)."""
        poses, turned = line.path_beside(stations, offsets)
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
        return cls(arc, poses, np.stack([stations, offsets, turned], axis=-1))

    @cached_property
    def bends(self) -> Array:
        """Curvature (n,) without its sign, 1/m."""
        return np.abs(np.gradient(np.unwrap(self.poses[:, 2]), self.arc))

    def poses_at(self, ways: Array) -> Array:
        """Poses (..., 3) after ways (...) in metres."""
        return np.stack([np.interp(ways, self.arc, column) for column in self.poses.T], axis=-1)

    def beside_at(self, ways: Array) -> tuple[Array, Array, Array]:
        """Station, metres to the left and turn (...) after ways (...) in metres."""
        station, left, turned = (np.interp(ways, self.arc, column) for column in self.places.T)
        return station, left, turned


def drawn_paths(plans: Array, line: RouteLine) -> list[TriedPath]:
    """Those of plans (k, 64, 3), which go on along the route."""
    paths = [TriedPath.of(np.concatenate([np.zeros((1, 3)), plan, line.beyond(plan[-1])]), line) for plan in plans]
    return [path for path in paths if path.arc[-1] > _LEAST_WAY]


def paths_aside(line: RouteLine, speed: float) -> list[TriedPath]:
    """Paths that go over to ASIDE, soon and less soon, from a speed in m/s."""
    return [path_aside(line, aside, over, speed) for aside in ASIDE.tolist() for over in (SHORT, LONG)]


def path_aside(line: RouteLine, aside: float, over: tuple[float, float, float], speed: float) -> TriedPath:
    """The polynomial of fifth degree from where the vehicle is and goes, over to a place beside the route."""
    least, seconds, most = over
    metres = min(max(seconds * speed, least), most)
    station, left, turned = line.locate(np.zeros(3)).tolist()
    way = np.arange(0.0, LENGTH, STEP)
    share, slope = np.minimum(way / metres, 1.0), metres * math.tan(min(max(turned, -_MOST_TURNED), _MOST_TURNED))
    apart = aside - left
    offsets = left + slope * share
    offsets += (10.0 * apart - 6.0 * slope) * share**3
    offsets += (8.0 * slope - 15.0 * apart) * share**4 + (6.0 * apart - 3.0 * slope) * share**5
    return TriedPath.beside(line, station + way, offsets)
