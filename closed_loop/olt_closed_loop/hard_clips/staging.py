"""From a specification to a scene: the road, the drive, and who else is on the road."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from olt_closed_loop.hard_clips.specification import ClipSpecification, Course
from olt_closed_loop.scenes.driving import drive_at_speed
from olt_closed_loop.scenes.hills import lay_hills, put_on_hills
from olt_closed_loop.scenes.roads import Road, lay_road
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scenes.traffic import place_lead, place_parked, place_stream
from olt_generator.seeds import make_generator
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

# Metres of road behind the start and beyond the end of the drive, and seconds driven before the first frame.
START, _AHEAD = 80.0, 180.0
LEAD_IN_SECONDS = 0.2
_SHOULDER = 2.2


def stage_scene(specification: ClipSpecification) -> Scene:
    """The scene that a specification asks for; its ego has driven for `LEAD_IN_SECONDS` when the clip starts."""
    course, traffic = specification.course, specification.traffic
    generator = make_generator("hard clip", specification.name, specification.seed)
    heading = generator.uniform(-np.pi, np.pi)
    road = _lay_course(course, heading)
    times, speeds = np.array(course.times) + LEAD_IN_SECONDS, np.array(course.speeds)
    times, speeds = np.concatenate([[0.0], times]), np.concatenate([speeds[:1], speeds])
    ego = drive_at_speed(road, road.lane_offset(course.lane), START, times, speeds)
    agents: list[Agent] = []
    if traffic.lead is not None:
        agents += place_lead(road, ego, traffic.lead, road.lane_offset(course.lane))
    for index, stream in enumerate(traffic.streams):
        agents += place_stream(f"stream_{index}", road, ego, stream, generator)
    if traffic.parked:
        agents += place_parked(road, ego, generator)
    crossing = [] if course.crossing is None else [_lay_crossing(road, START + course.crossing)]
    roads = [road, *crossing]
    scene = Scene(
        name=specification.name,
        category="nominal",
        factors=(),
        vehicle=DEFAULT_VEHICLE,
        ego=ego.trajectory,
        agents=tuple(agents),
        lanes=tuple(lane for part in roads for lane in part.driving_lanes()),
        road_edges=tuple(edge for part in roads for edge in part.edges),
        drivable=tuple(part.outline for part in roads),
        route=road.polyline(road.lane_offset(course.lane)),
    )
    if not course.waves:
        return scene
    return put_on_hills(scene, lay_hills(heading + course.hill_direction, course.waves))


def _lay_course(course: Course, heading: float) -> Road:
    driven = np.trapezoid(np.abs(course.speeds), course.times)
    knots, end = [(0.0, 0.0)], 0.0
    for bend in course.bends:
        start, curvature = START + bend.after, np.sign(bend.angle) / bend.radius
        arc = max(bend.radius * abs(bend.angle) - bend.easing, 0.5)
        knots += [(start, 0.0), (start + bend.easing, curvature), (start + bend.easing + arc, curvature)]
        end = start + 2.0 * bend.easing + arc
        knots.append((end, 0.0))
    length = max(START + float(driven) + _AHEAD, end + 60.0)
    return lay_road(knots, heading, length, course.lanes, _SHOULDER)


def _lay_crossing(road: Road, station: float) -> Road:
    """A straight road that crosses at a station."""
    middle, heading = road.locate(station, 0.0), float(road.heading(station)) + np.pi / 2
    reach = 120.0
    along = np.array([-reach, 0.0, reach])
    points = middle + along[:, None] * np.array([np.cos(heading), np.sin(heading)])
    return replace(road, length=2.0 * reach, lanes=1, line=CubicSpline(along + reach, points))
