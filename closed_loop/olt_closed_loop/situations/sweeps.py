"""Where a verdict changes: situations over two of their numbers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from olt_closed_loop.situations.motions import Motion
from olt_closed_loop.situations.roads import WIDTH, two_way
from olt_closed_loop.situations.situation import Situation
from olt_closed_loop.situations.table import contact_of

_STILL = ((0.0, 0.0),)
_MEETING = 6.0


@dataclass(frozen=True)
class Sweep:
    """Verdicts over two numbers.

    Attributes:
        name: what happens.
        rows, columns: names of the numbers.
        row_values, column_values: their values.
        verdicts: [row][column]: whether the ego is at fault; None where nobody is touched.
    """

    name: str
    rows: str
    columns: str
    row_values: tuple[float, ...]
    column_values: tuple[float, ...]
    verdicts: tuple[tuple[bool | None, ...], ...]


Build = Callable[[float, float], Situation]


def _crosses(speed: float, angle: float) -> Situation:
    yaw = np.deg2rad(angle)
    way = speed * _MEETING * np.array([np.cos(yaw), np.sin(yaw)])
    start = (10.0 * _MEETING - float(way[0]), -float(way[1]))
    return Situation("crosses", None, "", Motion((0.0, 0.0)), Motion(start, float(yaw), ((0.0, speed),)))


def _stands(speed: float, angle: float) -> Situation:
    yaw = float(np.deg2rad(angle))
    way = max(speed * _MEETING, 12.0)
    partner = Motion((-way * float(np.cos(yaw)), -way * float(np.sin(yaw))), yaw, ((0.0, speed),))
    return Situation("stands", None, "", Motion((0.0, 0.0), speed=_STILL), partner)


def _creeps(speed: float, heading: float) -> Situation:
    partner = Motion((2.4 + 0.25 + _MEETING * speed, 0.0), float(np.deg2rad(heading)), _STILL)
    return Situation("creeps", None, "", Motion((0.0, 0.0), speed=((0.0, speed),)), partner, "person")


def _cuts_in(faster: float, gap: float) -> Situation:
    ego = Motion((0.0, 0.0), shifts=((3.0, 4.5, -WIDTH),))
    partner = Motion((-(gap + 4.8) - 3.6 * faster, -WIDTH), speed=((0.0, 10.0 + faster),))
    return Situation("cuts in", None, "", ego, partner, lanes=two_way(lanes=2))


def _steps_out(before: float, speed: float) -> Situation:
    # It is before the front of the ego when it has walked to its way.
    start, walks_at = (speed * _MEETING + 2.4, -1.25 - 1.5 * before), _MEETING - before
    person = Motion(start, np.pi / 2, ((0.0, 0.0), (walks_at - 0.01, 0.0), (walks_at, 1.5)))
    return Situation(
        "steps out", None, "", Motion((0.0, 0.0), speed=((0.0, speed),)), person, "person", lanes=two_way()
    )


def _goes_over(shift: float, speed: float) -> Situation:
    ego = Motion((0.0, 0.0), shifts=((2.0, 4.0, shift),))
    partner = Motion(
        (_MEETING * (10.0 + speed), WIDTH), np.pi, ((0.0, speed),), shifts=((2.0, 4.0, WIDTH - shift - 1.5),)
    )
    return Situation("meets", None, "", ego, partner, lanes=two_way())


_SWEEPS: tuple[tuple[str, str, str, Build, Sequence[float], Sequence[float]], ...] = (
    ("drives on at 10 m/s, crossed without a map", "speed of the agent, m/s", "angle of the agent, degrees",
     _crosses, np.linspace(1.0, 20.0, 9).tolist(), np.arange(-180.0, 180.0, 9.0).tolist()),
    ("stands, run into from all sides", "speed of the agent, m/s", "angle of the agent, degrees",
     _stands, np.linspace(1.0, 20.0, 9).tolist(), np.arange(-180.0, 180.0, 9.0).tolist()),
    ("creeps into a standing person", "speed of the ego, m/s", "heading of the person, degrees",
     _creeps, [0.01, 0.02, 0.03, 0.035, 0.045, 0.05, 0.09, 0.2, 0.5], np.arange(-180.0, 180.0, 45.0).tolist()),
    ("cuts in at 10 m/s", "agent is faster by, m/s", "gap as it comes into the way, m",
     _cuts_in, np.linspace(1.0, 12.0, 12).tolist(), np.linspace(1.0, 25.0, 13).tolist()),
    ("a person steps out", "seconds before", "speed of the ego, m/s",
     _steps_out, np.linspace(0.2, 4.0, 20).tolist(), np.linspace(2.0, 16.0, 15).tolist()),
    ("meets an oncoming car", "metres to the left, of the ego", "speed of the agent, m/s",
     _goes_over, np.linspace(0.0, WIDTH, 20).tolist(), np.linspace(2.0, 20.0, 7).tolist()),
)  # fmt: skip


def sweep_all() -> tuple[Sweep, ...]:
    """All sweeps."""
    return tuple(_sweep(*sweep) for sweep in _SWEEPS)


def _sweep(
    name: str, rows: str, columns: str, build: Build, row_values: Sequence[float], column_values: Sequence[float]
) -> Sweep:
    verdicts = []
    for row in row_values:
        hits = [contact_of(build(row, column).record()) for column in column_values]
        verdicts.append(tuple(hit.at_fault if hit else None for hit in hits))
    return Sweep(name, rows, columns, tuple(row_values), tuple(column_values), tuple(verdicts))
