"""An event of the suite, and the traffic that several kinds share."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from olt_closed_loop.scenes.hills import lay_crest
from olt_closed_loop.scenes.maps.frames import mirrored
from olt_closed_loop.scenes.scene import Agent, Hills
from olt_closed_loop.suite.courses import Course, at_speed, go_while_there, stand, stand_in_a_row, stream
from olt_closed_loop.suite.grounds import Ground

BEFORE, AFTER, GAP = 1.6, 3.0, 1.25
"""Seconds before and after the ego's arrival in which cross traffic flows, and between two of its cars."""


@dataclass(frozen=True)
class Event:
    """What happens on a ground.

    Attributes:
        ground: map, route, and how the ego comes.
        agents: everybody, over 20 s, on level ground.
        hills: that the ground, the agents and the drive are put on; None where it is level.
    """

    ground: Ground
    agents: tuple[Agent, ...]
    hills: Hills | None = None


Make = Callable[[np.random.Generator], Event]
"""Makes an event from a generator."""


def in_mirror(make: Make) -> Make:
    """Makes the same events in the mirror, where traffic keeps to the left.

    What gives way to the right then gives way to the left, so it is for roads on which signs or lights tell who goes.
    """
    return partial(_in_mirror, make)


def _in_mirror(make: Make, generator: np.random.Generator) -> Event:
    event = make(generator)
    ground = replace(event.ground, road_map=mirrored(event.ground.road_map))
    return replace(event, ground=ground, agents=tuple(map(_mirrored_agent, event.agents)))


def _mirrored_agent(agent: Agent) -> Agent:
    poses = agent.poses * [1.0, -1.0, 1.0, -1.0]
    if agent.label == "arm":
        # Its hand is at its left end, which in the mirror is the right one.
        poses[:, 3] += np.pi
    return replace(agent, poses=poses)


def behind_a_crest(make: Make) -> Make:
    """Makes the same events beyond a crest of the road, which hides them for a while."""
    return partial(_behind_a_crest, make)


def _behind_a_crest(make: Make, generator: np.random.Generator) -> Event:
    event = make(generator)
    height, length = float(generator.uniform(2.2, 3.2)), float(generator.uniform(130.0, 160.0))
    x, y, heading = event.ground.course.locate(event.ground.crux - float(generator.uniform(25.0, 35.0)))
    crest = lay_crest(float(heading[0]), 0.0, height, length)
    place = float(crest.along(np.array([x[0], y[0]])))
    return replace(event, hills=replace(crest, start=crest.start + place))


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
