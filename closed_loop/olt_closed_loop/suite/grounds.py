"""The roads that events happen on: a map, the ego's route on it, and where the event is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from olt_closed_loop.scenes.maps.carriageways import carriageway
from olt_closed_loop.scenes.maps.cross_sections import CrossSection
from olt_closed_loop.scenes.maps.frames import moved
from olt_closed_loop.scenes.maps.junctions import Arm, junction
from olt_closed_loop.scenes.maps.lanes import HUMAN, Control, Lane, Light, LightState, StopLine
from olt_closed_loop.scenes.maps.road_map import RoadMap
from olt_closed_loop.scenes.maps.roundabouts import roundabout
from olt_closed_loop.scenes.maps.signals import SignalPlan, with_signals
from olt_closed_loop.scenes.polylines import arc_lengths, points_along
from olt_closed_loop.suite.courses import Course
from olt_closed_loop.suite.training_roads import SUITE_WIDTHS, bend_of, draw_lane_width, draw_wider, given_width
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

ARM_LENGTH = 190.0
_PLACES = 4000.0
_SPREAD = 4.0
_OTHER_SPEEDS = 0.6
_CENTER = DEFAULT_VEHICLE.rear_axle_to_bbox_center
FRONT = _CENTER + DEFAULT_VEHICLE.length / 2


@dataclass(frozen=True)
class Ground:
    """A map and the ego's route on it.

    Attributes:
        road_map: the map.
        lanes: ids of the lanes of the ego's route.
        crux: station on the route at which the event is, metres.
        cruise: the ego's speed where nothing asks for less, m/s.
        start: station at which the recording begins.
    """

    road_map: RoadMap
    lanes: tuple[str, ...]
    crux: float
    cruise: float
    start: float

    @cached_property
    def course(self) -> Course:
        """The ego's route."""
        return Course(self.road_map.route_line(self.lanes))

    def between(self, start: str, goal: str) -> Course:
        """The course from a lane to another."""
        return Course(self.road_map.route_line(self.road_map.route(start, goal)))

    def ways(self, start: str, goal: str) -> tuple[str, ...]:
        """The lanes between two, without these."""
        return self.road_map.route(start, goal)[1:-1]

    def arrival(self, station: float) -> float:
        """Seconds until the centre of an ego that nothing slows down is at a station."""
        return (station - self.start - _CENTER) / self.cruise

    def with_light(self, light: Light) -> "Ground":
        """The ground with one light more."""
        return replace(self, road_map=replace(self.road_map, lights=(*self.road_map.lights, light)))

    def signalled(self, plan: SignalPlan) -> "Ground":
        """The ground with lights that change by a plan, on the arms that have stop lines for lights."""
        return replace(self, road_map=with_signals(self.road_map, plan))

    def waved_on(self, lanes: Sequence[str]) -> "Ground":
        """The ground where a person waves traffic on through some lanes all the time."""
        return self.with_light(Light(f"{HUMAN}_others", tuple(lanes), np.zeros(1, dtype=np.int64), ("green",)))

    def directed(self, held: Sequence[tuple[float, float]]) -> "Ground":
        """The ground where a person holds the ego's lane at the crux for spans of seconds."""
        way = next(name for name in self.lanes if self._begins_at(name) > self.crux - 1.0)
        times: list[int] = []
        states: list[LightState] = []
        if held[0][0] > 0.0:
            times.append(0)
            states.append("green")
        for begin, end in held:
            times += [round(begin * 1e6), round(end * 1e6)]
            states.extend(("red", "green"))
        return self.with_light(Light(f"{HUMAN}_{way}", (way,), np.array(times, dtype=np.int64), tuple(states)))

    def _begins_at(self, name: str) -> float:
        return self.course.station_of(self.road_map.lane(name).center[0, :2])


def place(
    road_map: RoadMap, start: str, goal: str, generator: np.random.Generator, lead: float | None = None
) -> Ground:
    """A junction somewhere in the world, and a route over it: the crux is where it leaves the first lane."""
    road_map = _somewhere(road_map, generator)
    lanes = road_map.route(start, goal)
    crux = float(arc_lengths(road_map.lane(lanes[0]).center)[-1])
    return _approach(road_map, lanes, crux, generator, lead)


def _approach(
    road_map: RoadMap, lanes: tuple[str, ...], crux: float, generator: np.random.Generator, lead: float | None
) -> Ground:
    cruise = draw_wider(generator, 8.0, 10.5, _OTHER_SPEEDS)
    seconds = draw_wider(generator, 5.5, 7.0, _OTHER_SPEEDS) if lead is None else lead
    return Ground(road_map, lanes, crux, cruise, crux - FRONT - cruise * seconds)


def _somewhere(road_map: RoadMap, generator: np.random.Generator) -> RoadMap:
    x, y = generator.uniform(-_PLACES, _PLACES, size=2)
    return moved(road_map, float(x), float(y), float(generator.uniform(-np.pi, np.pi)))


def crossroads(
    generator: np.random.Generator,
    headings: Sequence[float] = (0.0, 90.0, 180.0, 270.0),
    controls: Sequence[Control | None] = (None, None, None, None),
    wear: float = 0.0,
    bend: float = 0.0,
) -> RoadMap:
    """A junction of arms at headings in degrees, each up to 4 degrees off."""
    width = draw_lane_width(generator, *SUITE_WIDTHS)
    section = CrossSection(lane_width=width, shoulder=given_width(generator, 0.8), wear=wear)
    off = generator.uniform(-_SPREAD, _SPREAD, size=len(headings))
    lengths = generator.uniform(0.0, 15.0, size=len(headings))
    bend = bend_of(generator, bend)
    arms = [
        Arm(
            float(np.deg2rad(heading + turn)),
            length=float(ARM_LENGTH + more),
            section=section,
            bend=bend,
            control=control,
        )
        for heading, turn, more, control in zip(headings, off, lengths, controls, strict=True)
    ]
    return junction(arms, turn_radius=draw_wider(generator, 7.0, 10.0))


def circle(generator: np.random.Generator, headings: Sequence[float]) -> RoadMap:
    """A roundabout with arms at headings in degrees."""
    section = CrossSection(lane_width=draw_lane_width(generator, 3.5, 3.8), shoulder=given_width(generator, 1.2))
    arms = [
        Arm(float(np.deg2rad(heading)), length=ARM_LENGTH, section=section, control="yield") for heading in headings
    ]
    radius, ring_width = draw_wider(generator, 16.0, 20.0), given_width(generator, 5.0)
    return roundabout(arms, radius=radius, ring_width=ring_width, turn_radius=10.0)


def road(
    generator: np.random.Generator,
    forward: int = 1,
    curve: float = 0.0,
    shoulder: float = 1.0,
    wear: float = 0.0,
) -> Ground:
    """A road between junctions, bent by `curve` (1/m) about the event; the crux is 90 m from its start."""
    width = draw_lane_width(generator, 3.3, 3.7)
    section = CrossSection(lane_width=width, shoulder=given_width(generator, shoulder), wear=wear)
    crux, curve = 90.0, bend_of(generator, curve)
    knots = ((0.0, 0.0), (crux - 60.0, 0.0), (crux - 30.0, curve), (crux + 60.0, curve), (crux + 90.0, 0.0))
    length = float(generator.uniform(360.0, 400.0))
    road_map = carriageway(
        length,
        forward=forward,
        section=section,
        bends=knots,
    )
    road_map = _somewhere(road_map, generator)
    return _approach(road_map, (f"forward_{forward - 1}",), crux, generator, None)


def cut_lane(ground: Ground, station: float) -> Ground:
    """The ground of a road whose lane is cut in two at a station of the route, with a stop line there."""
    name = ground.lanes[0]
    lane = ground.road_map.lane(name)
    arc = arc_lengths(lane.center)
    halves = [
        {side: _part(getattr(lane, side), arc, *span) for side in ("center", "left", "right")}
        for span in ((0.0, station), (station, float(arc[-1])))
    ]
    second = f"{name}_beyond"
    lanes: list[Lane] = [one for one in ground.road_map.lanes if one.id != name]
    lanes.append(replace(lane, **halves[0], successors=(second,)))
    lanes.append(replace(lane, **halves[1], id=second))
    line = StopLine(f"stop_{name}", np.stack([halves[1]["left"][0], halves[1]["right"][0]]), (name,))
    road_map = replace(ground.road_map, lanes=tuple(lanes), stop_lines=(*ground.road_map.stop_lines, line))
    return replace(ground, road_map=road_map, lanes=(name, second), crux=station)


def _part(line: Array, arc: Array, begin: float, end: float) -> Array:
    """The points of a border (n, 3) whose partners on the centre line lie from one station to another."""
    share = arc / arc[-1] * arc_lengths(line)[-1]
    ends = points_along(line, np.interp([begin, end], arc, share))
    inside = line[(arc > begin + 1e-6) & (arc < end - 1e-6)]
    return np.concatenate([ends[:1], inside, ends[1:]])
