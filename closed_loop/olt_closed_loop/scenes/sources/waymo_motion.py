"""The Waymo Open motion data set: scenarios of 9.1 s at 10 Hz (20 s in some shards) as TFRecord files of `Scenario`.

Field numbers are those of Waymo's `scenario.proto` and `map.proto`. A file holds some hundred scenarios; one is named
by its id, `FILE#SCENARIO_ID`. Positions are the middles of boxes. Reading needs neither TensorFlow nor Waymo's package,
which exists for few versions of Python.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from google.protobuf.message import DecodeError

from olt_closed_loop.scenes.maps.lanes import Crossing, Lane, LaneType, Light, LightState, Marking
from olt_closed_loop.scenes.polylines import without_repeats
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.sources.assembly import (
    JAGUAR_I_PACE,
    RecordedDrive,
    assemble_scene,
    behind,
    usable_line,
)
from olt_closed_loop.scenes.sources.fields import coordinates
from olt_closed_loop.scenes.sources.roads import lane_around
from olt_closed_loop.scenes.sources.tracks import Times, Track, check_times, longest_stretch, whole_microseconds
from olt_generator.errors import InputError
from olt_generator.omissions import Omission, word_omission
from olt_generator.poses import Array, planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.recordings.messages import make_message_class
from olt_toolkit.recordings.tfrecord import map_records, read_record, record_spans
from olt_toolkit.rigs.rig import VehicleDimensions

LANE_WIDTH = 3.7
"""Metres: of lanes only the centre line is recorded (AlpaSim's: docs/formats/alpasim.md)."""
MOST_RECORD_BYTES = 256 << 20

_MESSAGES = {
    "Scenario": (
        (1, "timestamps_seconds", "double*"),
        (2, "tracks", "Track*"),
        (5, "scenario_id", "bytes"),
        (6, "sdc_track_index", "int32"),
        (7, "dynamic_map_states", "DynamicMapState*"),
        (8, "map_features", "MapFeature*"),
    ),
    "Track": ((1, "id", "int32"), (2, "object_type", "int32"), (3, "states", "ObjectState*")),
    "ObjectState": (
        (2, "center_x", "double"),
        (3, "center_y", "double"),
        (5, "length", "float"),
        (6, "width", "float"),
        (7, "height", "float"),
        (8, "heading", "float"),
        (11, "valid", "bool"),
    ),
    "DynamicMapState": ((1, "lane_states", "LaneState*"),),
    "LaneState": ((1, "lane", "int64"), (2, "state", "int32"), (3, "stop_point", "MapPoint")),
    "MapFeature": ((1, "id", "int64"), (3, "lane", "LaneCenter"), (8, "crosswalk", "Outline")),
    "LaneCenter": (
        (1, "speed_limit_mph", "double"),
        (2, "type", "int32"),
        (8, "polyline", "MapPoint*"),
        (10, "exit_lanes", "int64*"),
        (11, "left_neighbors", "Neighbor*"),
        (12, "right_neighbors", "Neighbor*"),
        (13, "left_boundaries", "Boundary*"),
        (14, "right_boundaries", "Boundary*"),
    ),
    "Neighbor": ((1, "feature_id", "int64"),),
    "Boundary": ((1, "first", "int32"), (2, "last", "int32"), (4, "type", "int32")),
    "Outline": ((1, "polygon", "MapPoint*"),),
    "MapPoint": ((1, "x", "double"), (2, "y", "double")),
}
_SCENARIO: Any = make_message_class("olt.waymo_motion", _MESSAGES, "Scenario")
_NAME: Any = make_message_class("olt.waymo_name", {"Scenario": ((5, "scenario_id", "bytes"),)}, "Scenario")
_LABELS = {1: "automobile", 2: "person", 3: "rider"}
_LANE_TYPES: dict[int, LaneType] = {1: "driving", 2: "driving", 3: "cycle"}
_STATES: Mapping[int, LightState] = {
    0: "unknown",
    **dict.fromkeys((1, 4, 7), "red"),
    **dict.fromkeys((2, 5, 8), "amber"),
    **dict.fromkeys((3, 6), "green"),
}
_MARKINGS = {
    1: Marking("dashed", True),
    2: Marking("solid", False),
    3: Marking("double", False),
    4: Marking("dashed", True),
    5: Marking("double", True),
    6: Marking("solid", False),
    7: Marking("double", False),
    8: Marking("double"),
}
_MILES_PER_HOUR = 0.44704


def scenario_ids(path: Path) -> list[str]:
    """The ids of the scenarios in a TFRecord file, in its order.

    Raises:
        InputError: the file or a record in it is damaged, or two scenarios have one id.
    """
    names = [name for name, _ in _records(path)]
    if len(set(names)) < len(names):
        raise InputError(f"{path}: two scenarios of one id; give an unchanged copy")
    return names


def read_waymo_scenario(path: Path, scenario_id: str | None = None) -> Scene:
    """Read one scenario of a TFRecord file: that of an id, or the only one.

    Raises:
        InputError: the file is damaged, holds no such scenario or several, or the scenario is not as Waymo's are.
    """
    found = [(name, record) for name, record in _records(path) if scenario_id in (None, name)]
    if len(found) != 1:
        what = f"scenarios of id {scenario_id:.80}" if scenario_id else "scenarios; name one as FILE#SCENARIO_ID"
        raise InputError(f"{path}: holds {len(found)} {what}")
    ((name, record),) = found
    where = f"{path}: scenario {name:.80}"
    try:
        return _make_scene(_SCENARIO.FromString(record), name)
    except DecodeError as error:
        raise InputError(f"{where}: cut off or damaged; copy the file again") from error
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _records(path: Path) -> Iterator[tuple[str, bytes]]:
    content = map_records(path)
    for start, length in record_spans(content, str(path)):
        if length > MOST_RECORD_BYTES:
            raise InputError(f"{path}: a record of {length} bytes; a scenario has up to {MOST_RECORD_BYTES}")
        record = read_record(content, start, length, str(path))
        try:
            name = _NAME.FromString(record).scenario_id.decode()
        except (DecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: the record at byte {start} is no scenario of Waymo's motion data set") from error
        if not name:
            raise InputError(f"{path}: the record at byte {start} has no scenario_id, as Waymo's have")
        yield name, record


def _make_scene(scenario: Any, name: str) -> Scene:
    seconds = np.array(scenario.timestamps_seconds)
    if len(seconds) < 2 or not np.isfinite(seconds).all():
        raise InputError("timestamps_seconds are not two or more finite times")
    times_us = whole_microseconds(seconds)
    check_times(times_us, "timestamps_seconds")
    index = scenario.sdc_track_index
    if not 0 <= index < len(scenario.tracks):
        raise InputError(f"sdc_track_index {index} is none of {len(scenario.tracks)} tracks")
    vehicle, ego, start_us, notes = _read_ego(scenario.tracks[index], times_us)
    others = [track for number, track in enumerate(scenario.tracks) if number != index]
    unknown = sum(track.object_type not in _LABELS for track in others)
    agents = [track for track in others if track.object_type in _LABELS]
    tracks = [track for one in agents if (track := _read_track(one, times_us - start_us)) is not None]
    if unknown:
        notes.append(word_omission(Omission("tracks", "of unknown class", unknown, len(others))))
    lanes, areas = _read_lanes(scenario.map_features)
    if areas:
        notes.append(f"drivable area: the lanes, {LANE_WIDTH:g} m wide, of which the centre lines are recorded")
    return assemble_scene(
        RecordedDrive(
            name=f"waymo_{name}",
            vehicle=vehicle,
            ego=ego,
            agents=tracks,
            lanes=lanes,
            areas=areas,
            assumptions=(
                "ego box: length and width as recorded, the rest from the data sheet of a Jaguar I-Pace",
                "flat ground, all boxes on it",
                *notes,
            ),
            crossings=tuple(_read_crossings(scenario.map_features)),
            lights=tuple(_read_lights(scenario.dynamic_map_states, times_us - start_us)),
        )
    )


def _states(track: Any, times_us: Times) -> Array:
    """Step, x, y, heading, length, width and height (n, 7) of the valid steps."""
    if len(track.states) != len(times_us):
        raise InputError(f"track {track.id} has {len(track.states)} states for {len(times_us)} times")
    rows = np.array(
        [
            (step, one.center_x, one.center_y, one.heading, one.length, one.width, one.height)
            for step, one in enumerate(track.states)
            if one.valid
        ]
    ).reshape(-1, 7)
    return coordinates(rows, f"track {track.id}", columns=7)


def _read_ego(track: Any, times_us: Times) -> tuple[VehicleDimensions, Trajectory, int, list[str]]:
    rows = _states(track, times_us)
    if len(rows) == 0:
        raise InputError(f"track {track.id} is the ego and is valid at no time")
    known_us = times_us[rows[:, 0].astype(np.intp)]
    kept = longest_stretch(known_us)
    known_us, (_, x, y, heading) = known_us[kept], rows[kept, :4].T
    length, width = (float(np.median(rows[:, column])) for column in (4, 5))
    if not (2.0 < length < 20.0 and 1.0 < width < 4.0):
        raise InputError(f"track {track.id} is the ego, and its box has {length:g} x {width:g} m")
    car = JAGUAR_I_PACE
    vehicle = VehicleDimensions(length, width, car.height, car.rear_axle_to_bbox_center, car.wheelbase, car.track_width)
    x, y = behind(np.column_stack([x, y]), heading, vehicle.rear_axle_to_bbox_center).T
    ego = Trajectory(known_us - known_us[0], planar_pose(x, y, heading))
    missing = len(times_us) - len(known_us)
    left_out = Omission("steps of the ego", "not valid, or beside its longest stretch", missing, len(times_us))
    return vehicle, ego, int(known_us[0]), [word_omission(left_out)] if missing else []


def _read_track(track: Any, times_us: Times) -> Track | None:
    """A road user; None for one that is never there."""
    rows = _states(track, times_us)
    if len(rows) == 0:
        return None
    steps, x, y, heading = rows[:, :4].T
    length, width, height = np.median(rows[:, 4:], axis=0).tolist()
    poses = np.column_stack([x, y, np.full(len(x), 0.5 * height), heading])
    label = _LABELS[track.object_type]
    return Track(str(track.id), label, length, width, height, times_us[steps.astype(np.intp)], poses)


def _points(points: Any, where: str) -> Array:
    """Points (n, 3) on the ground."""
    rows = coordinates([(point.x, point.y) for point in points], where)
    return np.column_stack([rows, np.zeros(len(rows))])


def _read_lanes(features: Any) -> tuple[list[Lane], list[shapely.Polygon]]:
    lanes, areas = [], []
    for feature in features:
        if not feature.HasField("lane"):
            continue
        lane = feature.lane
        center = without_repeats(_points(lane.polyline, f"lane {feature.id}"))
        if not usable_line(center):
            continue
        around = lane_around(str(feature.id), center, 0.5 * LANE_WIDTH)
        kind = _LANE_TYPES.get(lane.type)
        limit = lane.speed_limit_mph * _MILES_PER_HOUR
        lanes.append(
            Lane(
                around.id,
                around.center,
                around.left,
                around.right,
                successors=tuple(str(other) for other in lane.exit_lanes),
                type=kind,
                left_neighbours=tuple(str(other.feature_id) for other in lane.left_neighbors),
                right_neighbours=tuple(str(other.feature_id) for other in lane.right_neighbors),
                left_marking=_read_marking(lane.left_boundaries),
                right_marking=_read_marking(lane.right_boundaries),
                speed_limit=float(limit) if 0.0 < limit < 100.0 else None,
            )
        )
        if kind != "cycle":
            areas.append(shapely.LineString(center[:, :2]).buffer(0.5 * LANE_WIDTH, cap_style="flat"))
    names = {lane.id for lane in lanes}
    if len(names) < len(lanes):
        raise InputError("two lanes of one id; give an unchanged copy")
    return lanes, areas


def _read_marking(boundaries: Any) -> Marking | None:
    """What lies along most of one side, None where that is not known."""
    longest = max(boundaries, key=lambda one: one.last - one.first, default=None)
    return None if longest is None else _MARKINGS.get(longest.type)


def _read_crossings(features: Any) -> Iterator[Crossing]:
    for feature in features:
        if feature.HasField("crosswalk"):
            outline = _points(feature.crosswalk.polygon, f"crosswalk {feature.id}")
            polygon = shapely.Polygon(outline[:, :2]) if len(outline) >= 3 else None
            if polygon is not None and polygon.is_valid and polygon.area > 0.0:
                yield Crossing(str(feature.id), outline if polygon.exterior.is_ccw else outline[::-1])


def _read_lights(moments: Any, times_us: Times) -> Iterator[Light]:
    """The light of each lane that has one, with its changes."""
    if not moments:
        return
    if len(moments) != len(times_us):
        raise InputError(f"dynamic_map_states has {len(moments)} moments for {len(times_us)} times")
    seen: dict[int, list[tuple[int, LightState]]] = {}
    for time_us, moment in zip(times_us.tolist(), moments, strict=True):
        states: dict[int, LightState] = {one.lane: _STATES.get(one.state, "unknown") for one in moment.lane_states}
        for lane in {*states, *seen}:
            state: LightState = states.get(lane, "unknown")
            changes = seen.setdefault(lane, [])
            if not changes or changes[-1][1] != state:
                changes.append((time_us, state))
    for lane, changes in sorted(seen.items()):
        yield Light(
            f"light_{lane}",
            (str(lane),),
            np.array([begin for begin, _ in changes], dtype=np.int64),
            tuple(one for _, one in changes),
        )
