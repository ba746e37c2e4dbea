"""Courses: curves in the plane from which lanes are laid, with their exact directions.

A course is sampled so densely that its chords stay within 4 mm of it. All courses that join begin and end with a
straight piece, so that the chords of two that follow each other have one direction where they meet.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BPoly

from olt_closed_loop.scenes.polylines import wrap
from olt_generator.errors import InputError
from olt_generator.poses import Array

LEAD = 0.3
"""Metres of straight piece at both ends of a course that joins others."""
_SAG = 0.004
_LONGEST_STEP = 2.0
_LEAST_TURN, _MOST_TURN = np.radians(10.0), np.radians(170.0)
_FEWEST_PIECES = 40
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


class Place(NamedTuple):
    """A place in the plane, metres, and a direction, radians."""

    x: float
    y: float
    heading: float

    def at(self, along: float, left: float = 0.0, turn: float = 0.0) -> "Place":
        """The place that lies so far ahead and to the left of this one, turned to the left."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        return Place(self.x + along * cos - left * sin, self.y + along * sin + left * cos, self.heading + turn)


@dataclass(frozen=True)
class Course:
    """A sampled curve.

    Attributes:
        points: (n, 2) metres.
        headings: (n,) its direction at the points, radians, without jumps.
        stations: (n,) metres along it, from 0.
    """

    points: Array
    headings: Array
    stations: Array

    def beside(self, offsets: Array | float, reverse: bool = False) -> Array:
        """Points (n, 3) at height 0 so many metres (n,) to the left of the course; in reverse order if asked for."""
        across = np.column_stack([-np.sin(self.headings), np.cos(self.headings)])
        line = self.points + np.broadcast_to(offsets, self.stations.shape)[:, None] * across
        line = np.column_stack([line, np.zeros(len(line))])
        return line[::-1].copy() if reverse else line

    @property
    def tightest(self) -> float:
        """Radius of its tightest bend, metres; infinite where it is straight."""
        bend = np.abs(np.diff(self.headings)).max()
        steps = np.diff(self.stations)
        return float((steps / np.maximum(np.abs(np.diff(self.headings)), 1e-12)).min()) if bend > 1e-9 else np.inf


def follow(start: Place, pieces: Sequence[tuple[float, float, float]]) -> Course:
    """The course of pieces (length, curvature at its start, at its end), curvature 1/m and positive to the left."""
    stations, headings = [np.zeros(1)], [np.array([start.heading])]
    points = [np.array([[start.x, start.y]])]
    for length, first, last in pieces:
        if length <= 0.0:
            continue
        step = min(_LONGEST_STEP, np.sqrt(8.0 * _SAG / max(abs(first), abs(last), 1e-6)))
        places = np.linspace(0.0, length, max(2, int(np.ceil(length / step)) + 1))
        turned, moved = _integrate(places, headings[-1][-1], first, (last - first) / length)
        headings.append(turned)
        points.append(points[-1][-1] + moved)
        stations.append(stations[-1][-1] + places[1:])
    return Course(np.concatenate(points), np.concatenate(headings), np.concatenate(stations))


def _integrate(places: Array, heading: float, curvature: float, change: float) -> tuple[Array, Array]:
    """Headings (n - 1,) and displacements (n - 1, 2) at places (n,) after the first, of a clothoid."""
    half = np.diff(places) / 2.0
    nodes = (places[:-1] + half)[:, None] + half[:, None] * _NODES
    angles = heading + curvature * nodes + 0.5 * change * nodes**2
    steps = half[:, None] * np.stack([np.cos(angles) @ _WEIGHTS, np.sin(angles) @ _WEIGHTS], axis=-1)
    return heading + curvature * places[1:] + 0.5 * change * places[1:] ** 2, np.cumsum(steps, axis=0)


def meet(start: Place, end: Place) -> tuple[float, float]:
    """How far ahead of `start` and how far behind `end` their lines cross, metres; they must not be parallel."""
    turn = np.sin(end.heading - start.heading)
    dx, dy = end.x - start.x, end.y - start.y
    ahead = (dx * np.sin(end.heading) - dy * np.cos(end.heading)) / turn
    behind = (dy * np.cos(start.heading) - dx * np.sin(start.heading)) / turn
    return float(ahead), float(behind)


def turn_between(start: Place, end: Place) -> float:
    """How far one turns from one place to another, radians, -pi to pi, positive to the left."""
    return float(wrap(np.array(end.heading - start.heading)))


def connect(start: Place, end: Place, leads: tuple[float, float] = (LEAD, LEAD)) -> Course:
    """The course from one place to another: straight, one arc as wide as there is room for, and straight.

    Where one arc cannot lead there (hardly a turn, or a shift sideways) it is a quintic curve without bend at its ends.

    Args:
        start, end: its ends.
        leads: least metres that are straight at both ends.
    """
    turn = turn_between(start, end)
    if _LEAST_TURN <= abs(turn) <= _MOST_TURN:
        ahead, behind = meet(start, end)
        tangent = min(ahead - leads[0], behind - leads[1])
        if tangent > 0.0:
            radius = tangent / np.tan(abs(turn) / 2.0)
            bend = np.sign(turn) / radius
            pieces = [(ahead - tangent, 0.0, 0.0), (radius * abs(turn), bend, bend), (behind - tangent, 0.0, 0.0)]
            return _ending_at(follow(start, pieces), end)
    return _blend(start, end, leads)


def _blend(start: Place, end: Place, leads: tuple[float, float]) -> Course:
    """Straight, a quintic Bezier curve whose first and last three control points are in line, and straight."""
    first, last = start.at(leads[0]), end.at(-leads[1])
    a, b = np.array(first[:2]), np.array(last[:2])
    reach = np.linalg.norm(b - a) / 5.0
    ahead, behind = (reach * np.array([np.cos(place.heading), np.sin(place.heading)]) for place in (first, last))
    if reach < 0.1 or (b - a) @ ahead <= 0.0 or (b - a) @ behind <= 0.0:
        raise InputError(
            f"no way leads from ({start.x:.1f}, {start.y:.1f}) to ({end.x:.1f}, {end.y:.1f}) without turning back; "
            "give the arms more room or other directions"
        )
    control = np.array([a, a + ahead, a + 2.0 * ahead, b - 2.0 * behind, b - behind, b])
    curve = BPoly(control[:, None, :], [0.0, 1.0])
    pieces = max(_FEWEST_PIECES, int(np.ceil(5.0 * reach / _LONGEST_STEP)))
    shares = np.linspace(0.0, 1.0, pieces + 1)
    tangent = curve(shares, 1)
    headings = np.unwrap(np.concatenate([[start.heading], np.arctan2(tangent[:, 1], tangent[:, 0])]))
    headings = np.append(headings, headings[-1])
    points = np.concatenate([[start[:2]], curve(shares), [end[:2]]])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return Course(points, headings, np.concatenate([[0.0], np.cumsum(steps)]))


def _ending_at(course: Course, end: Place) -> Course:
    """The course with its last point put on `end`, from which only rounding keeps it."""
    points = course.points.copy()
    points[-1] = end[:2]
    return Course(points, course.headings, course.stations)
