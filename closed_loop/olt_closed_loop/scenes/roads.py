"""Two-way roads along a smooth reference line, and their lanes, edges and outline.

Road coordinates: the station `s` runs along the line between the two directions of traffic, the offset `d` is metres
to its left. Traffic keeps to the right, so the lanes of the ego's direction have negative offsets.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline

from olt_closed_loop.scenes.scene import Lane
from olt_generator.poses import Array

LANE_WIDTH = 3.5
MOST_BENDS = 2

_GRID_STEP = 0.5
_MAP_STEP = 2.0
_SECTION_LENGTH = 120.0


@dataclass(frozen=True)
class Road:
    """A road of `length` metres.

    Attributes:
        length: of the reference line, metres.
        lanes: lanes in each direction.
        shoulder: width of the paved shoulder on both sides, metres.
        line: position (x, y) of the reference line by station.
    """

    length: float
    lanes: int
    shoulder: float
    line: CubicSpline

    @property
    def lane_edge(self) -> float:
        """Offset of the outermost lane border on the left; the right one is its negative."""
        return self.lanes * LANE_WIDTH

    @property
    def half_width(self) -> float:
        """Offset of the left edge of the drivable area; the right one is its negative."""
        return self.lane_edge + self.shoulder

    def lane_offset(self, lane: int, oncoming: bool = False) -> float:
        """Offset of a lane's centre; lane 0 is the one beside the reference line."""
        offset = (lane + 0.5) * LANE_WIDTH
        return offset if oncoming else -offset

    def heading(self, s: ArrayLike) -> Array:
        """Direction (...) of the reference line at stations (...), radians."""
        tangent = self.line(s, 1)
        return np.arctan2(tangent[..., 1], tangent[..., 0])

    def locate(self, s: ArrayLike, d: ArrayLike) -> Array:
        """World positions (..., 2) of road coordinates (...)."""
        heading = self.heading(s)
        across = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return self.line(s) + np.asarray(d, dtype=np.float64)[..., None] * across

    def polyline(self, d: float, start: float = 0.0, end: float | None = None) -> Array:
        """Points (n, 3) on the ground at a constant offset, about 2 m apart, in the direction of the stations."""
        end = self.length if end is None else end
        s = np.linspace(start, end, max(2, round((end - start) / _MAP_STEP) + 1))
        return np.column_stack([self.locate(s, np.full_like(s, d)), np.zeros(len(s))])

    @cached_property
    def edges(self) -> tuple[Array, Array]:
        """Right and left edge, polylines (n, 3) in metres; the drivable area lies to the left of each."""
        return self.polyline(-self.half_width), self.polyline(self.half_width)[::-1].copy()

    @cached_property
    def outline(self) -> Array:
        """Closed counter-clockwise outline (n, 3) of the drivable area; the last point repeats the first."""
        right, left = self.edges
        return np.concatenate([right, left, right[:1]])

    def driving_lanes(self) -> tuple[Lane, ...]:
        """All lanes of both directions, cut into sections that follow each other."""
        sections = max(1, round(self.length / _SECTION_LENGTH))
        cuts = np.linspace(0.0, self.length, sections + 1)
        lanes = []
        for oncoming, lane, section in product((False, True), range(self.lanes), range(sections)):
            name = f"{'oncoming' if oncoming else 'forward'}_{lane}"
            center, ahead = self.lane_offset(lane, oncoming), -1 if oncoming else 1
            # Seen in driving direction, the reference line is always on the left.
            sides = (center, center + ahead * LANE_WIDTH / 2, center - ahead * LANE_WIDTH / 2)
            lines = [self.polyline(d, cuts[section], cuts[section + 1])[::ahead].copy() for d in sides]
            successors = (f"{name}_{section + ahead}",) if 0 <= section + ahead < sections else ()
            lanes.append(Lane(f"{name}_{section}", *lines, successors=successors))
        return tuple(lanes)


def generate_road(generator: np.random.Generator, length: float, lanes: int) -> Road:
    """A road of random shape and direction whose curvature is continuous and never tighter than 80 m."""
    # Knots (station, curvature) of straights, clothoids and arcs, as roads are laid out.
    bends, knots = generator.integers(MOST_BENDS + 1), [(0.0, 0.0), (generator.uniform(20.0, 60.0), 0.0)]
    sign = generator.choice([-1.0, 1.0])
    for _ in range(bends):
        radius, turn, clothoid = generator.uniform(80.0, 250.0), generator.uniform(0.3, 0.9), generator.uniform(25, 40)
        arc = max(radius * turn - clothoid, 5.0)
        for step, value in ((clothoid, sign / radius), (arc, sign / radius), (clothoid, 0.0)):
            knots.append((knots[-1][0] + step, value))
        knots.append((knots[-1][0] + generator.uniform(5.0, 25.0), 0.0))
        sign = -sign
    knots.append((max(length, knots[-1][0]) + 1.0, 0.0))
    heading = generator.uniform(-np.pi, np.pi)
    return lay_road(knots, heading, length, lanes, generator.uniform(2.0, 2.5))


def lay_road(knots: Sequence[tuple[float, float]], heading: float, length: float, lanes: int, shoulder: float) -> Road:
    """A road from the origin whose curvature (1/m, positive to the left) runs linearly between knots by station.

    Args:
        knots: (station, curvature), sorted by station; the curvature of the last one goes on.
        heading: direction of its start, radians.
        length: metres.
        lanes: lanes in each direction.
        shoulder: width of the paved shoulder on both sides, metres.
    """
    s = np.linspace(0.0, length, round(length / _GRID_STEP) + 1)
    bend = np.interp(s, *np.array(knots).T)
    headings = heading + cumulative_simpson(bend, x=s, initial=0.0)
    direction = np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    points = cumulative_simpson(direction, x=s, axis=0, initial=0.0)
    return Road(length, lanes, shoulder, CubicSpline(s, points))
