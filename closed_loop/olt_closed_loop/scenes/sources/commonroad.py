"""CommonRoad scenarios (XML, versions 2018b to 2020a): lanelets and recorded road users, https://commonroad.in.tum.de.

A scenario is a planning problem: of the car that plans only the start and the goal are known, its drive is not in the
file. The ego of the scene is therefore one of the recorded cars, which a problem named by its number (`ego`) or the
farthest drive decides, and the car of the planning problem is not there. The package commonroad-io reads the same
files; it brings some twenty packages, this is one page.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from olt_closed_loop.scenes.maps.lanes import Control, Crossing, Lane, LaneType, Light, LightState, Marking, StopLine
from olt_closed_loop.scenes.polylines import without_repeats
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.sources.assembly import (
    RecordedDrive,
    assemble_scene,
    behind,
    lane_area,
    scaled_car,
    usable_line,
)
from olt_closed_loop.scenes.sources.roads import lane_between
from olt_closed_loop.scenes.sources.tracks import LARGEST_BOX, Track, check_times, longest_stretch
from olt_closed_loop.scenes.sources.xml_files import child, number_of, parse_number, read_xml, text_of
from olt_generator.errors import InputError
from olt_generator.omissions import Omission, word_omission
from olt_generator.poses import Array, planar_pose
from olt_generator.trajectory import Trajectory

ROOT = "commonRoad"
_VERSIONS = ("2018b", "2020a")
# Label and height in metres, which the format does not hold.
_KINDS = {
    "car": ("automobile", 1.5),
    "taxi": ("automobile", 1.5),
    "parkedVehicle": ("automobile", 1.5),
    "priorityVehicle": ("other_vehicle", 2.0),
    "truck": ("heavy_truck", 3.2),
    "bus": ("bus", 3.2),
    "train": ("train_or_tram_car", 3.5),
    "motorcycle": ("rider", 1.7),
    "bicycle": ("rider", 1.75),
    "pedestrian": ("person", 1.75),
    "constructionZone": ("barrier", 1.0),
    "roadBoundary": ("barrier", 1.0),
    "building": ("protruding_object", 4.0),
    "pillar": ("protruding_object", 3.0),
    "median_strip": ("barrier", 0.5),
    "unknown": ("other_vehicle", 1.5),
}
_LANE_TYPES: dict[str, LaneType] = {
    "sidewalk": "sidewalk",
    "bicycleLane": "cycle",
    "shoulder": "shoulder",
    "border": "shoulder",
    **dict.fromkeys(("urban", "interstate", "country", "highway", "driveWay", "mainCarriageWay"), "driving"),
    **dict.fromkeys(("accessRamp", "exitRamp", "busLane", "busStop", "intersection", "parking"), "driving"),
}
_MARKINGS = {
    "solid": Marking("solid", False),
    "broad_solid": Marking("solid", False),
    "dashed": Marking("dashed", True),
    "broad_dashed": Marking("dashed", True),
    "solid_solid": Marking("double", False),
    "dashed_dashed": Marking("double", True),
    "solid_dashed": Marking("double"),
    "dashed_solid": Marking("double"),
    "curb": Marking("kerb", False),
    "lowered_curb": Marking("kerb"),
    "no_marking": Marking("none"),
}
_COLORS: dict[str, LightState] = {
    "red": "red",
    "redYellow": "amber",
    "yellow": "amber",
    "green": "green",
    "inactive": "off",
}
_NO_DRIVERS = ("truck", "bus", "pedestrian", "bicycle", "motorcycle", "train")


def read_commonroad(path: Path, ego: str | None = None) -> Scene:
    """Read one scenario with a recorded car as the ego.

    Args:
        path: the XML file.
        ego: id of that car; by default the car that is there from the start and drives farthest.

    Raises:
        InputError: the file is no such scenario, uses what is not read (it says what), or has no such car.
    """
    root = read_xml(path, "CommonRoad scenario", ROOT)
    try:
        return _read(root, ego)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _read(root: Element, ego: str | None) -> Scene:
    version = text_of(root, "commonRoadVersion", ROOT)
    if version not in _VERSIONS:
        raise InputError(f"commonRoadVersion {version:.40}; {' and '.join(_VERSIONS)} are read")
    step = number_of(root, "timeStepSize", ROOT)
    if not 0.01 <= step <= 0.25:
        raise InputError(f"timeStepSize of {step:g} s; 0.01 to 0.25 s are expected")
    tracks = [_read_obstacle(obstacle, step) for obstacle in _obstacles(root)]
    names = [track.id for track, _ in tracks]
    if len(set(names)) < len(names):
        raise InputError("two obstacles of one id; give an unchanged copy")
    last_us = max((int(track.timestamps_us[-1]) for track, _ in tracks), default=0)
    chosen, why = _choose_ego(tracks, ego)
    vehicle, size = scaled_car(chosen.length, chosen.width)
    kept = longest_stretch(chosen.timestamps_us)
    times_us, poses = chosen.timestamps_us[kept], chosen.poses[kept]
    if len(times_us) < 2:
        raise InputError(f"obstacle {chosen.id}: one pose; the ego drives")
    check_times(times_us, f"obstacle {chosen.id}")
    x, y = behind(poses[:, :2], poses[:, 3], vehicle.rear_axle_to_bbox_center).T
    start_us = int(times_us[0])
    lanes, areas, crossings, skipped = _read_lanelets(root)
    by_id = {lane.id: lane for lane in lanes}
    lights = tuple(_read_lights(root, by_id, step, start_us, int(times_us[-1])))
    problems = [problem.get("id", "?") for problem in root.iter("planningProblem")]
    notes = [
        why,
        size,
        "flat ground, heights of boxes are the usual ones of their class",
        f"the cars that solve planning problems ({', '.join(problems)[:80]}) are not recorded and not there"
        if problems
        else "",
        word_omission(Omission("lanelets", "without length", skipped, skipped + len(lanes))) if skipped else "",
        f"the {len(lights)} traffic lights run through the cycle of the file, which nobody recorded" if lights else "",
    ]
    return assemble_scene(
        RecordedDrive(
            name=f"commonroad_{text_of(root, 'benchmarkID', ROOT)}_{chosen.id}",
            vehicle=vehicle,
            ego=Trajectory(times_us - start_us, planar_pose(x, y, poses[:, 3])),
            agents=[_shifted(track, start_us, last_us) for track, _ in tracks if track is not chosen],
            lanes=lanes,
            areas=areas,
            assumptions=tuple(note for note in notes if note),
            stop_lines=tuple(_read_stop_lines(root, by_id)),
            crossings=tuple(crossings),
            lights=lights,
        )
    )


def _choose_ego(tracks: list[tuple[Track, str]], ego: str | None) -> tuple[Track, str]:
    cars = [track for track, kind in tracks if kind not in _NO_DRIVERS and len(track.timestamps_us) > 2]
    if ego is not None:
        found = next((car for car in cars if car.id == ego), None)
        if found is None:
            known = ", ".join(car.id for car in cars[:20])
            raise InputError(f"obstacle {ego:.40} is no car that moves; the cars are {known}")
        return found, f"the ego is the recorded car {ego}, as asked for"
    if not cars:
        raise InputError("no recorded car moves, so that there is no drive for an ego; give another scenario")
    first = min(int(car.timestamps_us[0]) for car in cars)
    ways = {
        car.id: float(np.linalg.norm(np.diff(car.poses[:, :2], axis=0), axis=1).sum())
        for car in cars
        if car.timestamps_us[0] == first
    }
    farthest = max(ways, key=lambda name: ways[name])
    why = f"the ego is the recorded car {farthest}: of those there at the start the one that drives farthest"
    return next(car for car in cars if car.id == farthest), why


def _shifted(track: Track, start_us: int, last_us: int) -> Track:
    """The agent with its times from the ego's start on; one that stands is there all the time."""
    times_us, poses = track.timestamps_us, track.poses
    if len(times_us) == 1:
        steps = np.arange(0, max(last_us, 1) + 100_001, 100_000, dtype=np.int64)
        times_us, poses = steps, np.repeat(poses, len(steps), axis=0)
    return Track(track.id, track.label, track.length, track.width, track.height, times_us - start_us, poses)


def _obstacles(root: Element) -> Iterator[Element]:
    for element in root:
        if element.tag in ("staticObstacle", "dynamicObstacle", "obstacle"):
            yield element
        elif element.tag in ("environmentObstacle", "phantomObstacle"):
            raise InputError(f"<{element.tag}> {element.get('id', '')} is not read")


def _read_obstacle(element: Element, step: float) -> tuple[Track, str]:
    """An obstacle with all its samples, and its type."""
    name = text_of(element, "id", f"<{element.tag}>")
    where = f"obstacle {name:.40}"
    kind = (child(element, "type", where).text or "").strip()
    if kind not in _KINDS:
        raise InputError(f"{where}: type {kind:.40} is not known")
    label, height = _KINDS[kind]
    length, width = _read_shape(child(element, "shape", where), where)
    if not all(0.0 < side <= LARGEST_BOX for side in (length, width)):
        raise InputError(f"{where}: a box of {length:g} x {width:g} m")
    states = [child(element, "initialState", where)]
    trajectory = element.find("trajectory")
    if trajectory is not None:
        states += trajectory.findall("state")
    elif element.find("occupancySet") is not None:
        raise InputError(f"{where}: <occupancySet> is not read, a <trajectory> is")
    rows = np.array([_read_state(state, where) for state in states])
    steps, x, y, yaw = rows.T
    if np.any(steps != np.round(steps)):
        raise InputError(f"{where}: a time that is no whole number of steps")
    times_us = np.round(steps * step * 1e6).astype(np.int64)
    poses = np.column_stack([x, y, np.full(len(x), 0.5 * height), yaw])
    return Track(name, label, length, width, height, times_us, poses), kind


def _read_shape(shape: Element, where: str) -> tuple[float, float]:
    if len(shape) != 1:
        raise InputError(f"{where}: a shape of {len(shape)} parts; one is read")
    (part,) = shape
    if part.tag == "rectangle":
        length, width = _exact(part, "length", where), _exact(part, "width", where)
    elif part.tag == "circle":
        length = width = 2.0 * _exact(part, "radius", where)
    else:
        raise InputError(f"{where}: shape <{part.tag:.40}> is not read, <rectangle> and <circle> are")
    if part.find("center") is not None or part.find("orientation") is not None:
        offsets = [part.findtext(f"center/{axis}") for axis in "xy"] + [part.findtext("orientation")]
        if any(offset is not None and parse_number(offset, f"{where}: shape") != 0.0 for offset in offsets):
            raise InputError(f"{where}: a shape that is not centred on its position is not read")
    return length, width


def _read_state(state: Element, where: str) -> tuple[float, float, float, float]:
    """Step, x, y and heading."""
    point = state.find("position/point")
    if point is None:
        raise InputError(f"{where}: a state whose position is no <point>; uncertain positions are not read")
    return (
        _exact(child(state, "time", where), "exact", where),
        _exact(point, "x", where),
        _exact(point, "y", where),
        _exact(child(state, "orientation", where), "exact", where),
    )


def _exact(element: Element, name: str, where: str) -> float:
    return parse_number(child(element, name, f"{where}: <{element.tag}>").text, f"{where}: {element.tag} {name}")


def _read_lanelets(root: Element) -> tuple[list[Lane], list[shapely.Polygon], list[Crossing], int]:
    """Lanes, the area of each on which cars drive, crossings, and how many lanelets have no length."""
    junctions = _read_junctions(root)
    lanes: list[Lane] = []
    areas, crossings, skipped = [], [], 0
    for element in root.findall("lanelet"):
        name = text_of(element, "id", "<lanelet>")
        where = f"lanelet {name:.40}"
        left, right = (without_repeats(_read_bound(element, side, where)) for side in ("leftBound", "rightBound"))
        if not (usable_line(left) and usable_line(right)):
            skipped += 1
            continue
        kinds = {(kind.text or "").strip() for kind in element.findall("laneletType")}
        area = lane_area(left, right)
        if "crosswalk" in kinds:
            outline = np.concatenate([right, left[::-1]])
            crossings.append(Crossing(name, outline if area.exterior.is_ccw else outline[::-1]))
            continue
        lane = _describe(lane_between(name, left, right, ()), element, kinds, junctions.get(name))
        lanes.append(lane)
        if lane.for_cars or lane.type == "shoulder":
            areas.append(area)
    if len({lane.id for lane in lanes}) < len(lanes):
        raise InputError("two lanelets of one id; give an unchanged copy")
    return lanes, areas, crossings, skipped


def _describe(lane: Lane, element: Element, kinds: set[str], junction: str | None) -> Lane:
    """The lane with what the file says of it."""
    where = f"lanelet {lane.id:.40}"
    limit = element.findtext("speedLimit")
    return replace(
        lane,
        successors=tuple(text_of(link, "ref", where) for link in element.findall("successor")),
        type=next((_LANE_TYPES[kind] for kind in sorted(kinds) if kind in _LANE_TYPES), None),
        left_neighbours=tuple(text_of(link, "ref", where) for link in element.findall("adjacentLeft")),
        right_neighbours=tuple(text_of(link, "ref", where) for link in element.findall("adjacentRight")),
        left_marking=_MARKINGS.get((element.findtext("leftBound/lineMarking") or "").strip()),
        right_marking=_MARKINGS.get((element.findtext("rightBound/lineMarking") or "").strip()),
        junction=junction,
        speed_limit=None if limit is None else parse_number(limit, f"{where}: speedLimit"),
    )


def _read_junctions(root: Element) -> dict[str, str]:
    """The junction of each lanelet that leads through one."""
    return {
        text_of(link, "ref", "<intersection>"): text_of(junction, "id", "<intersection>")
        for junction in root.findall("intersection")
        for turn in ("successorsLeft", "successorsStraight", "successorsRight")
        for link in junction.findall(f"incoming/{turn}")
    }


def _read_stop_lines(root: Element, lanes: dict[str, Lane]) -> Iterator[StopLine]:
    """Stop lines: at their points, or across the end of their lane."""
    for element in root.findall("lanelet"):
        line, lane = element.find("stopLine"), lanes.get(element.get("id", ""))
        if line is None or lane is None:
            continue
        where = f"lanelet {lane.id:.40}: stopLine"
        points = [(_exact(point, "x", where), _exact(point, "y", where), 0.0) for point in line.findall("point")]
        ends = np.array(points) if len(points) == 2 else np.stack([lane.left[-1], lane.right[-1]])
        control: Control | None = "light" if line.find("trafficLightRef") is not None else None
        yield StopLine(f"stop_{lane.id}", ends, (lane.id,), control)


def _read_lights(root: Element, lanes: dict[str, Lane], step: float, start_us: int, end_us: int) -> Iterator[Light]:
    """Traffic lights with their states over the drive, at the ways that follow the lanes that refer to them."""
    ways: dict[str, list[str]] = {}
    for element in root.findall("lanelet"):
        lane = lanes.get(element.get("id", ""))
        if lane is None:
            continue
        for reference in element.findall("trafficLightRef"):
            ways.setdefault(text_of(reference, "ref", "trafficLightRef"), []).extend(lane.successors)
    for element in root.findall("trafficLight"):
        name = text_of(element, "id", "<trafficLight>")
        where = f"trafficLight {name:.40}"
        direction = (element.findtext("direction") or "all").strip()
        cycle = element.find("cycle")
        ruled = [lane for lane in dict.fromkeys(ways.get(name, [])) if lane in lanes]
        if direction != "all" or cycle is None or not ruled or (element.findtext("active") or "").strip() == "false":
            continue
        begins, states = _read_cycle(cycle, step, start_us, end_us, where)
        yield Light(name, tuple(ruled), begins, states)


def _read_cycle(
    cycle: Element, step: float, start_us: int, end_us: int, where: str
) -> tuple[np.ndarray, tuple[LightState, ...]]:
    parts: list[tuple[float, LightState]] = [
        (_exact(part, "duration", where), _COLORS.get((part.findtext("color") or "").strip(), "unknown"))
        for part in cycle.findall("cycleElement")
    ]
    lengths = np.round(np.array([duration for duration, _ in parts]) * step * 1e6)
    if not parts or not np.all((lengths >= 1e4) & (lengths < 1e12)):
        raise InputError(f"{where}: a cycle without phases, or one shorter than 0.01 s")
    offset = cycle.findtext("timeOffset")
    first = 0 if offset is None else int(parse_number(offset, f"{where}: timeOffset") * step * 1e6)
    period, borders = int(lengths.sum()), np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64)
    # The cycle that runs at the start, and all that begin before the end.
    rounds = range((start_us - first) // period, (end_us - first) // period + 1)
    begins = np.concatenate([first + number * period + borders for number in rounds]) - start_us
    return begins, tuple(state for _ in rounds for _, state in parts)


def _read_bound(element: Element, side: str, where: str) -> Array:
    """Points (n, 3) on the ground."""
    points = child(element, side, where).findall("point")
    rows = [(_exact(point, "x", f"{where}: {side}"), _exact(point, "y", f"{where}: {side}"), 0.0) for point in points]
    if len(rows) < 2:
        raise InputError(f"{where}: {side} has {len(rows)} points; two or more are needed")
    return np.array(rows)
