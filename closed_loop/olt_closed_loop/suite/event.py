"""An event of the suite, and the traffic that several kinds share."""

from dataclasses import dataclass

import numpy as np

from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.suite.courses import Course, at_speed, go_while_there, stand, stand_in_a_row, stream
from olt_closed_loop.suite.grounds import Ground

BEFORE, AFTER, GAP = 1.6, 3.0, 1.25
"""Seconds before and after the ego's arrival in which cross traffic flows, and between two of its cars."""


@dataclass(frozen=True)
class Event:
    """What happens on a ground.

    Attributes:
        ground: map, route, and how the ego comes.
        agents: everybody, over 20 s.
    """

    ground: Ground
    agents: tuple[Agent, ...]


def cross_traffic(
    ground: Ground,
    start: str,
    goal: str,
    speed: float,
    name: str = "crossing",
    before: float = BEFORE,
    after: float = AFTER,
    gap: float = GAP,
) -> list[Agent]:
    """A stream from a lane to another that is in the ego's way about when an ego that nothing slows down comes."""
    course = ground.between(start, goal)
    mine, theirs = ground.course.meets(course, after=ground.crux)
    when = ground.arrival(mine)
    return stream(name, course, theirs, when - before, when + after, speed, gap)


def last_passes(ground: Ground, start: str, goal: str, after: float = AFTER) -> float:
    """When the last of such a stream is through, seconds."""
    mine, _ = ground.course.meets(ground.between(start, goal), after=ground.crux)
    return ground.arrival(mine) + after


def oncoming(
    ground: Ground, offset: float, station: float, first: float, last: float, speed: float, gap: float
) -> list[Agent]:
    """Cars that come along the ego's route against it, at an offset, and pass a station from one time to another."""
    x, y, _ = ground.course.locate(np.arange(0.0, ground.course.length, 2.0), offset)
    course = Course(np.column_stack([x, y])[::-1])
    x, y, _ = ground.course.locate(station, offset)
    return stream("oncoming", course, course.station_of(np.array([x[0], y[0]])), first, last, speed, gap)


def cone_line(name: str, course: Course, begin: tuple[float, float], end: tuple[float, float]) -> list[Agent]:
    """Cones every three metres from one (station, offset) to another."""
    count = max(2, round(abs(end[0] - begin[0]) / 3.0) + 1)
    return stand_in_a_row(
        name, "cone", course, np.linspace(begin[0], end[0], count), np.linspace(begin[1], end[1], count)
    )


def closure(ground: Ground, begin: float, end: float, inner: float, outer: float, name: str = "closed") -> list[Agent]:
    """Cones that close a lane from offset `outer` to `inner` between two stations, with tapers, and barriers in it."""
    course, taper = ground.course, 12.0
    agents = cone_line(f"{name}_taper", course, (begin - taper, outer), (begin, inner))
    agents += cone_line(f"{name}_line", course, (begin, inner), (end, inner))
    agents += cone_line(f"{name}_end", course, (end, inner), (end + 6.0, outer))
    stations = np.arange(begin + 2.0, end - 1.0, 4.0)
    return agents + [
        stand(f"{name}_barrier_{index}", "barrier", course, station, 0.5 * (inner + outer), turn=np.pi / 2)
        for index, station in enumerate(stations.tolist())
    ]


def lead_car(ground: Ground, gap: float, speed: float, offset: float = 0.0) -> list[Agent]:
    """A car ahead of the ego at a steady speed."""
    return go_while_there(
        "lead", "automobile", ground.course, at_speed(ground.start + FRONT_GAP + gap, 0.0, speed), offset
    )


FRONT_GAP = 6.0
"""Metres from the ego's rig to the centre of a car that would touch its front."""
