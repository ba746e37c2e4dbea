"""Traffic lights of a junction that change in turns."""

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.scenes.maps.lanes import Light, LightState, StopLine
from olt_closed_loop.scenes.maps.road_map import RoadMap
from olt_generator.errors import InputError
from olt_generator.poses import Array

LAMP_HEIGHT = 3.2
"""Metres over the road of the middle of a light's head."""
_BESIDE = 0.6


@dataclass(frozen=True)
class SignalPlan:
    """How the lights of a junction change.

    Attributes:
        phases: arms whose lights are green together, in turns.
        green, amber, all_red: seconds of each turn.
        start: when the first phase turns green, seconds.
    """

    phases: tuple[tuple[int, ...], ...] = ((0, 2), (1, 3))
    green: float = 8.0
    amber: float = 3.0
    all_red: float = 1.0
    start: float = 0.0

    @property
    def turn(self) -> float:
        """Seconds from the green of one phase to that of the next."""
        return self.green + self.amber + self.all_red


def with_signals(junction: RoadMap, plan: SignalPlan, end: float = 60.0) -> RoadMap:
    """The map of `junction` with a light on each arm of the plan that has lanes inbound.

    Lights hang beside the outer end of the stop line, over the kerb. They change from a full round before the
    start of the plan, and before time 0, until `end` seconds.

    Raises:
        InputError: an arm is in no map or in two phases, its stop line is missing, or a duration is not positive.
    """
    if min(plan.green, plan.amber) <= 0.0 or plan.all_red < 0.0:
        raise InputError("green and amber last longer than 0 s, all_red no less than 0 s")
    arms = [arm for phase in plan.phases for arm in phase]
    if len(set(arms)) < len(arms):
        raise InputError(f"phases {plan.phases} hold an arm twice; each arm is green in one of them")
    lights = tuple(_light(junction, plan, phase, arm, end) for phase, arms in enumerate(plan.phases) for arm in arms)
    return replace(junction, lights=(*junction.lights, *lights))


def _light(junction: RoadMap, plan: SignalPlan, phase: int, arm: int, end: float) -> Light:
    lines = [line for line in junction.stop_lines if line.id == f"arm{arm}_stop" and line.control == "light"]
    if not lines:
        raise InputError(f"arm {arm} has no stop line for a light; give it control='light' and inbound lanes")
    ways = tuple(name for lane in lines[0].lanes for name in junction.lane(lane).successors)
    times_us, states = _changes(plan, phase, end)
    lamp = _lamp(junction, lines[0])
    return Light(f"arm{arm}_light", ways, times_us, states, lamp)


def _lamp(junction: RoadMap, line: StopLine) -> Array:
    """The place (3,) of a lamp over the kerb, beside the end of a stop line that is nearer to the edge of the road."""
    edges = shapely.MultiLineString([edge[:, :2] for edge in junction.road_edges])
    ends = line.points[::-1]  # of two equally near the right one
    end = ends[int(np.argmin(shapely.distance(shapely.points(ends[:, :2]), edges)))]
    across = np.ptp(line.points[:, :2], axis=0) * np.sign(end[:2] - line.points[:, :2].mean(axis=0))
    kerb = shapely.get_coordinates(shapely.shortest_line(shapely.Point(end[:2]), edges))[1]
    return np.array([*(kerb + _BESIDE * across / np.linalg.norm(across)), end[2] + LAMP_HEIGHT])


def _changes(plan: SignalPlan, phase: int, end: float) -> tuple[NDArray[np.int64], tuple[LightState, ...]]:
    """Times (n,) in microseconds and states from a round before the plan's start, and before 0, until `end`."""
    period = plan.turn * len(plan.phases)
    first = plan.start + phase * plan.turn
    rounds_before = int(np.ceil(max(first, 0.0) / period)) + 1
    starts = np.arange(first - rounds_before * period, end, period)
    times = np.stack([starts, starts + plan.green, starts + plan.green + plan.amber], axis=1).ravel()
    states: tuple[LightState, ...] = ("green", "amber", "red") * len(starts)
    return np.round(times * 1e6).astype(np.int64), states
