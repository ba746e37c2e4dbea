"""Drives of nuScenes and Waymo as ScenarioNet writes them: one JSON object, often gzipped: tracks at 10 Hz, lanes.

nuScenes' recordings are planar: the ego's height is 0 throughout, and heights of others are relative to it at the
moment of annotation. So all boxes are put on flat ground. Their ego's position is that of the rear axle (in bends it
does not move sideways, and it equals nuScenes' own ego pose), its box in the file has length and width swapped and is
not used. Waymo's are the middles of boxes.
"""

import gzip
import io
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.scenes.polylines import length_of, without_repeats
from olt_closed_loop.scenes.scene import Agent, Lane, Scene
from olt_closed_loop.scenes.sources.assembly import JAGUAR_I_PACE, behind
from olt_closed_loop.scenes.sources.fields import FARTHEST, coordinates, expect, member, numbers
from olt_closed_loop.scenes.sources.roads import NO_ROAD, edges, lane_around, link_by_place, outlines, route_along
from olt_closed_loop.scenes.sources.swath import ego_swath
from olt_closed_loop.scenes.sources.tracks import (
    FARTHEST_FROM_EGO,
    MOST_GAP_US,
    Times,
    Track,
    agents_of,
    check_motion,
    check_times,
    listed,
    longest_stretch,
    whole_microseconds,
    word_away,
)
from olt_generator.errors import InputError
from olt_generator.files import read_bounded
from olt_generator.omissions import Omission, word_omission
from olt_generator.poses import Array, planar_pose, yaw_of
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions
from olt_toolkit.runtime.json_files import MOST_BYTES, parse_json

RENAULT_ZOE = VehicleDimensions(
    length=4.084, width=1.730, height=1.562, rear_axle_to_bbox_center=1.385, wheelbase=2.588, track_width=1.51
)
"""The recording car (docs/formats/source_datasets.md); where its box is over the axle is estimated."""
LANE_WIDTH = 3.7
"""Metres, for lanes of which only the centre line is recorded (AlpaSim's: docs/formats/alpasim.md)."""

_CARS = {
    "nuscenes": (RENAULT_ZOE, 0.0, "Renault Zoe"),
    "waymo": (JAGUAR_I_PACE, JAGUAR_I_PACE.rear_axle_to_bbox_center, "Jaguar I-Pace, whose middle is recorded"),
}
"""The car of each data set, how far its rear axle is behind the recorded position, and its name."""
_EGO = ("vehicle.ego", "ego_vehicle")
# nuScenes' categories; after them, for tracks without one, the types of ScenarioNet.
_LABELS = {
    kind: label
    for label, kinds in {
        "animal": "animal",
        "automobile": "vehicle.car vehicle",
        "barrier": "movable_object.barrier traffic_barrier guardrail",
        "bus": "vehicle.bus",
        "cone": "movable_object.trafficcone traffic_cone",
        "heavy_truck": "vehicle.truck",
        "other_vehicle": "vehicle.construction vehicle.emergency",
        "person": "human.pedestrian pedestrian",
        "protruding_object": "movable_object static_object traffic_object",
        "rider": "vehicle.bicycle vehicle.motorcycle cyclist",
        "stroller": "human.pedestrian.stroller",
        "trailer": "vehicle.trailer",
    }.items()
    for kind in kinds.split()
}


def read_scenario(path: Path) -> Scene:
    """Read one scenario.

    Steps in which the ego is not valid are no poses: a gap of up to `tracks.MOST_GAP_US` is bridged on a line, of a
    drive with a longer one the longest stretch is kept. Agents that are never valid are left out, and one that is away
    for longer is another agent when it is back. The scene's assumptions say all that.

    Raises:
        InputError: the file is not such a scenario; it names the track or map feature, the field and the time.
    """
    try:
        scenario = parse_json(_read_content(path), str(path))
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a scenario as .json or .json.gz") from error
    try:
        return _make_scene(scenario)
    except InputError as error:
        raise InputError(
            f"{path}: not a ScenarioNet scenario of nuScenes or Waymo ({error}); give an unchanged copy"
        ) from error


def _read_content(path: Path) -> bytes:
    content = read_bounded(path, "scenario", MOST_BYTES)
    if path.suffix != ".gz":
        return content
    with gzip.open(io.BytesIO(content)) as file:
        unpacked = file.read(MOST_BYTES + 1)
    if len(unpacked) > MOST_BYTES:
        raise InputError(f"{path}: unpacks to more than {MOST_BYTES} bytes; a scenario is smaller")
    return unpacked


def _make_scene(scenario: Any) -> Scene:
    metadata = member(scenario, "metadata", dict, "scenario")
    dataset = str(metadata.get("dataset", "nuscenes"))
    source = next((name for name in _CARS if dataset.lower().startswith(name)), None)
    if source is None:
        raise InputError(f"metadata: dataset is {dataset:.40}, of which neither the car nor the frame is known")
    vehicle, back, car = _CARS[source]
    times_us = _read_times(metadata)
    tracks = dict(member(scenario, "tracks", dict, "scenario"))
    driver = member(metadata, "sdc_id", str, "metadata")
    if driver not in tracks:
        raise InputError(f"tracks: {driver:.80} is missing, which is the ego (metadata: sdc_id)")
    ego, first, origin, ego_notes = _read_ego(tracks.pop(driver), f"track {driver:.80}", times_us, back)
    agents, agent_notes = _read_agents(tracks, times_us - times_us[first], origin, int(ego.timestamps_us[-1]))
    lanes, areas = _read_lanes(member(scenario, "map_features", dict, "scenario"), origin)
    swath, beyond = ego_swath(ego, vehicle, areas) if areas else ([], 0)
    road = (
        f"drivable area: the lanes, {LANE_WIDTH:g} m wide where only a centre line is recorded, and where the "
        f"recorded ego drove ({beyond} of its {len(ego)} poses reach beyond the lanes)"
    )
    return Scene(
        name=f"{source}_{scenario.get('id', driver)!s:.200}",
        category="recorded",
        factors=(),
        vehicle=vehicle,
        ego=ego,
        agents=tuple(agents),
        lanes=tuple(lanes),
        road_edges=edges([*areas, *swath]),
        drivable=outlines([*areas, *swath]),
        route=route_along(ego.positions, float(yaw_of(ego.T_world_rig[-1])), lanes),
        assumptions=(
            f"ego box: data sheet of a {car}",
            "flat ground, all boxes on it",
            *ego_notes,
            *agent_notes,
            road if areas else NO_ROAD,
        ),
    )


def _read_times(metadata: dict[str, Any]) -> Times:
    """Microseconds (n,) from the first step on."""
    where = "metadata: ts"
    seconds = numbers(member(metadata, "ts", list, "metadata"), where)
    if seconds.ndim != 1 or len(seconds) == 0 or not np.isfinite(seconds).all():
        raise InputError(f"{where} is no row of one or more finite seconds")
    times_us = whole_microseconds(seconds)
    check_times(times_us, where)
    return times_us


def _read_ego(track: Any, where: str, times_us: Times, back: float) -> tuple[Trajectory, int, Array, list[str]]:
    """The ego's drive from its first pose on, the step and place (2,) of that, and what was left out."""
    valid, motion = _read_motion(track, where, times_us)
    if len(valid) == 0:
        raise InputError(f"{where} is never valid, and it is the ego")
    kept = longest_stretch(times_us[valid])
    steps, poses = valid[kept], motion[kept]
    if len(steps) < 2:
        raise InputError(f"{where}: the ego is valid in {len(steps)} step at a time; a drive has more")
    poses[:, :2] = behind(poses[:, :2], poses[:, 2], back)
    first, origin = int(steps[0]), poses[0, :2].copy()
    x, y = (poses[:, :2] - origin).T
    ego = Trajectory(times_us[steps] - times_us[first], planar_pose(x, y, poses[:, 2]))
    check_motion(ego, where)
    return ego, first, origin, list(_word_gaps(steps, valid, times_us))


def _word_gaps(steps: NDArray[np.intp], valid: NDArray[np.intp], times_us: Times) -> Iterator[str]:
    count, span = len(times_us), times_us[[steps[0], steps[-1]]] * 1e-6
    longest = f"{MOST_GAP_US * 1e-6:g} s"
    if len(valid) < count:
        left_out = Omission("steps of the ego", "not valid; the way between is straight", count - len(valid), count)
        yield word_omission(left_out)
    if len(steps) < len(valid):
        yield f"only {span[0]:.1f} to {span[1]:.1f} s of the recording: beside it the ego is away for over {longest}"


def _read_motion(track: Any, where: str, times_us: Times) -> tuple[NDArray[np.intp], Array]:
    """The valid steps (k,) of a track, and x, y and heading (k, 3) at them."""
    state = member(track, "state", dict, where)
    valid = np.flatnonzero(_column(state, "valid", where, len(times_us)) > 0)
    position = numbers(member(state, "position", list, where), f"{where}: position")
    if position.ndim != 2 or len(position) != len(times_us) or position.shape[1] < 2:
        raise InputError(f"{where}: position has no x and y for each of the {len(times_us)} steps")
    heading = _column(state, "heading", where, len(times_us))
    motion = np.column_stack([position[:, :2], heading])[valid]
    wrong = ~(np.abs(motion) <= FARTHEST).all(axis=1)
    if wrong.any():
        index = int(np.argmax(wrong))
        values = ", ".join(f"{value:g}" for value in motion[index])
        time = times_us[valid[index]] * 1e-6
        raise InputError(f"{where} is valid at {time:.2f} s, where its position x, y and heading are {values}")
    return valid, motion


def _column(state: dict[str, Any], name: str, where: str, count: int) -> Array:
    """One number for each step (count,)."""
    values = numbers(member(state, name, list, where), f"{where}: {name}").ravel()
    if len(values) != count:
        raise InputError(f"{where}: {name} has {len(values)} values for {count} steps")
    return values


def _read_agents(tracks: dict[str, Any], times_us: Times, origin: Array, end_us: int) -> tuple[list[Agent], list[str]]:
    """All agents of a drive that begins at time 0 and `origin` (2,), and what was left out and taken apart."""
    agents: list[Agent] = []
    never, apart, doubles = [], [], 0
    for name, track in tracks.items():
        kinds = _kinds(track, f"track {name:.80}")
        if any(kind in _EGO for kind in kinds):
            doubles += 1
            continue
        parts = list(_read_agent(name, track, kinds, times_us, origin, end_us))
        if not parts:
            never.append(name)
        if len(parts) > 1:
            apart.append(name)
        agents += parts
    notes = []
    if never:
        notes.append(
            word_omission(
                Omission(f"agents ({listed(never)})", "valid at no time of the drive", len(never), len(tracks))
            )
        )
    if apart:
        notes.append(word_away(apart))
    if doubles:
        notes.append(word_omission(Omission("tracks", "of the ego's class: the ego itself", doubles, len(tracks))))
    return agents, notes


def _kinds(track: Any, where: str) -> list[str]:
    """What a track may be, the most particular first: beginnings of its category, else its type."""
    described = track.get("metadata") if isinstance(track, dict) else None
    category = described.get("type") if isinstance(described, dict) else None
    words = (category if isinstance(category, str) else member(track, "type", str, where)).lower().split(".")
    return [".".join(words[:count]) for count in range(len(words), 0, -1)]


def _read_agent(
    name: str, track: Any, kinds: list[str], times_us: Times, origin: Array, end_us: int
) -> Iterator[Agent]:
    where = f"track {name:.80}"
    label = next((_LABELS[kind] for kind in kinds if kind in _LABELS), None)
    if label is None:
        raise InputError(f"{where}: category {kinds[0]:.80} is not known")
    valid, motion = _read_motion(track, where, times_us)
    if len(valid) == 0:
        return
    state = member(track, "state", dict, where)
    length, width, height = (
        float(np.median(_column(state, size, where, len(times_us))[valid])) for size in ("length", "width", "height")
    )
    poses = np.column_stack([motion[:, :2] - origin, np.full(len(valid), 0.5 * height), motion[:, 2]])
    yield from agents_of(Track(name, label, length, width, height, times_us[valid], poses), end_us, where)


def _read_lanes(features: dict[str, Any], origin: Array) -> tuple[list[Lane], list[shapely.Polygon]]:
    """Lanes with their successors, and the area of each."""
    lanes, areas = [], []
    for name, feature in features.items():
        where = f"map feature {name:.80}"
        if not member(feature, "type", str, where).startswith("LANE"):
            continue
        center = without_repeats(_near(member(feature, "polyline", list, where), f"{where}: polyline", origin))
        if len(center) < 2:
            continue
        border = expect(feature.get("polygon") or [], list, f"{where}: polygon")
        area = shapely.Polygon(_near(border, f"{where}: polygon", origin, fewest=3)) if border else None
        if area is not None and area.area > 0.0:
            width = area.area / length_of(center)
        else:
            area, width = shapely.LineString(center).buffer(0.5 * LANE_WIDTH), LANE_WIDTH
        areas.append(area)
        lane = lane_around(name, np.column_stack([center, np.zeros(len(center))]), 0.5 * width)
        lanes.append(replace(lane, type="driving" if feature["type"] == "LANE_SURFACE_STREET" else None))
    return link_by_place(lanes), areas


def _near(values: Any, where: str, origin: Array, fewest: int = 0) -> Array:
    """Points (n, 2) from the origin of the drive, within FARTHEST_FROM_EGO."""
    points = coordinates(values, where, fewest=fewest) - origin
    if np.any(np.abs(points) > FARTHEST_FROM_EGO):
        raise InputError(
            f"{where} is more than {FARTHEST_FROM_EGO * 1e-3:g} km from the ego; not the map of this drive"
        )
    return points
