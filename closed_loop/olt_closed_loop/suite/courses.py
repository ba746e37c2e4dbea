"""Agents along lines: who stands beside one, and who moves along it."""

from functools import cached_property

import numpy as np
import shapely

from olt_closed_loop.scenes.actors import SIZES, sample_times
from olt_closed_loop.scenes.polylines import arc_lengths, without_repeats
from olt_closed_loop.scenes.scene import Agent
from olt_generator.poses import Array

DURATION_US = 20_000_000
TIMES: Array = sample_times(DURATION_US)
Size = tuple[float, float, float]
"""Length, width, height in metres."""
_SMOOTH = 1.0
_NEAR = 0.6


class Course:
    """A line (n, 2 or more) in metres to go along: the station is the way along it, the offset metres to its left."""

    def __init__(self, line: Array) -> None:
        self._line = without_repeats(line[:, :2])
        self._arc = arc_lengths(self._line)

    @property
    def length(self) -> float:
        """Metres."""
        return float(self._arc[-1])

    @cached_property
    def line(self) -> shapely.LineString:
        """The line as shapely has it."""
        return shapely.LineString(self._line)

    def locate(self, stations: Array | float, offsets: Array | float = 0.0) -> tuple[Array, Array, Array]:
        """x, y and heading (n,) of places; straight on beyond both ends."""
        stations = np.atleast_1d(np.asarray(stations, dtype=np.float64))
        inside = np.clip(stations, 0.0, self.length)
        before, after = (self._points(np.clip(inside + step, 0.0, self.length)) for step in (-_SMOOTH, _SMOOTH))
        heading = np.unwrap(np.arctan2(*(after - before).T[::-1]))
        x, y = self._points(inside).T
        beyond = stations - inside
        x, y = x + beyond * np.cos(heading), y + beyond * np.sin(heading)
        return x - offsets * np.sin(heading), y + offsets * np.cos(heading), heading

    def _points(self, arc: Array) -> Array:
        return np.stack([np.interp(arc, self._arc, column) for column in self._line.T], axis=-1)

    def station_of(self, point: Array) -> float:
        """The station beside a point (2,)."""
        return float(self.line.project(shapely.Point(*point)))

    def meets(self, other: "Course", after: float = 0.0) -> tuple[float, float]:
        """Stations on this course and on another where the two first come together, `after` a station of this one.

        Raises:
            ValueError: they never do.
        """
        stations = np.arange(after, self.length, 0.25)
        x, y, _ = self.locate(stations)
        near = np.flatnonzero(shapely.distance(shapely.points(x, y), other.line) < _NEAR)
        if len(near) == 0:
            raise ValueError("the courses never come together")
        at = float(stations[near[0]])
        return at, other.station_of(np.array([x[near[0]], y[near[0]]]))


def stand(
    name: str,
    label: str,
    course: Course,
    station: float,
    offset: float,
    turn: float = 0.0,
    size: Size | None = None,
    above: float = 0.0,
) -> Agent:
    """Who stands beside a course, turned by `turn` radians from it, its underside `above` metres over the ground."""
    return go(name, label, course, np.full(2, station), np.full(2, offset), turn, size, above, TIMES[[0, -1]])


def stand_in_a_row(name: str, label: str, course: Course, stations: Array, offsets: Array | float) -> list[Agent]:
    """Objects that stand at stations (n,) and offsets (n,)."""
    places = zip(stations.tolist(), np.broadcast_to(offsets, stations.shape).tolist(), strict=True)
    return [stand(f"{name}_{index}", label, course, s, d) for index, (s, d) in enumerate(places)]


def go(
    name: str,
    label: str,
    course: Course,
    stations: Array,
    offsets: Array | float = 0.0,
    turn: Array | float = 0.0,
    size: Size | None = None,
    above: float = 0.0,
    times: Array = TIMES,
) -> Agent:
    """Who moves along a course: its box's centre is at stations and offsets (n,) at times (n,), seconds."""
    length, width, height = size or SIZES[label]
    x, y, heading = course.locate(stations, offsets)
    poses = np.column_stack([x, y, np.full_like(x, above + height / 2), heading + turn])
    return Agent(name, label, length, width, height, np.round(times * 1e6).astype(np.int64), poses)


def go_while_there(
    name: str, label: str, course: Course, stations: Array, offsets: Array | float = 0.0, size: Size | None = None
) -> list[Agent]:
    """Who moves along a course while it is on it; nobody if it is there for less than half a second."""
    margin = (size or SIZES[label])[0] / 2
    there = (stations > margin) & (stations < course.length - margin)
    if there.sum() < 5:
        return []
    offsets = np.broadcast_to(offsets, stations.shape)
    return [go(name, label, course, stations[there], offsets[there], size=size, times=TIMES[there])]


def at_speed(station: float, when: float, speed: float) -> Array:
    """Stations (n,) at TIMES of who passes a station at a time, seconds, at a steady speed, m/s."""
    return station + speed * (TIMES - when)


def stream(
    name: str, course: Course, station: float, first: float, last: float, speed: float, gap: float
) -> list[Agent]:
    """Cars that pass a station from one time to another, `gap` seconds apart."""
    agents: list[Agent] = []
    for index, when in enumerate(np.arange(first, last + 1e-9, gap).tolist()):
        agents += go_while_there(f"{name}_{index}", "automobile", course, at_speed(station, when, speed))
    return agents


def staged(knots: list[tuple[float, float]]) -> Array:
    """Stations or offsets (n,) at TIMES from (time, value) knots, moved over smoothly between them."""
    times, values = np.array(knots).T
    index = np.clip(np.searchsorted(times, TIMES, side="right") - 1, 0, len(times) - 2)
    share = np.clip((TIMES - times[index]) / (times[index + 1] - times[index]), 0.0, 1.0)
    return values[index] + (values[index + 1] - values[index]) * share * share * (3.0 - 2.0 * share)
