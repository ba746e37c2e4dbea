"""nuScenes drives as ScenarioNet writes them: all tracks at 10 Hz and the lanes around, one JSON object, often gzipped.

The recording is planar: the ego's height is 0 throughout, and heights of others are relative to it at the moment of
annotation. So all boxes are put on flat ground. The ego's position is that of the rear axle (in bends it does not move
sideways, and it equals nuScenes' own ego pose), its box in the file has length and width swapped and is not used.
"""

import gzip
import io
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.scenes.actors import footprints
from olt_closed_loop.scenes.polylines import length_of, without_repeats
from olt_closed_loop.scenes.scene import Agent, Lane, Scene
from olt_closed_loop.scenes.sources.roads import edges, lane_around, link_by_place, outlines, route_along
from olt_generator.errors import InputError
from olt_generator.files import read_bounded
from olt_generator.poses import Array, planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions
from olt_toolkit.runtime.json_files import MOST_BYTES, parse_json

RENAULT_ZOE = VehicleDimensions(
    length=4.084, width=1.730, height=1.562, rear_axle_to_bbox_center=1.385, wheelbase=2.588, track_width=1.51
)
"""The recording car (docs/formats/source_datasets.md); where its box is over the axle is estimated."""
LANE_WIDTH = 3.7
"""Metres, for lanes of which only the centre line is recorded (AlpaSim's: docs/formats/alpasim.md)."""

_LABELS = {
    kind: label
    for label, kinds in {
        "animal": "animal",
        "automobile": "vehicle.car",
        "barrier": "movable_object.barrier",
        "bus": "vehicle.bus",
        "cone": "movable_object.trafficcone",
        "heavy_truck": "vehicle.truck",
        "other_vehicle": "vehicle.construction vehicle.emergency",
        "person": "human.pedestrian",
        "protruding_object": "movable_object static_object",
        "rider": "vehicle.bicycle vehicle.motorcycle",
        "stroller": "human.pedestrian.stroller",
        "trailer": "vehicle.trailer",
    }.items()
    for kind in kinds.split()
}


def read_scenario(path: Path) -> Scene:
    """Read one scenario.

    Raises:
        InputError: the file is not such a scenario.
    """
    try:
        scenario = parse_json(_read_content(path), str(path))
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a scenario as .json or .json.gz") from error
    try:
        return _make_scene(scenario)
    except (KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise InputError(
            f"{path}: not a ScenarioNet scenario of nuScenes ({error!r}); give an unchanged copy"
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
    seconds = np.array(scenario["metadata"]["ts"], dtype=np.float64)
    times_us = np.round((seconds - seconds[0]) * 1e6).astype(np.int64)
    tracks = dict(scenario["tracks"])
    driven = tracks.pop(scenario["metadata"]["sdc_id"])["state"]
    origin = np.array(driven["position"], dtype=np.float64)[0, :2]
    x, y, yaw = _motion(driven, origin).T
    ego = Trajectory(times_us, planar_pose(x, y, yaw))
    lanes, areas = _read_lanes(scenario["map_features"], origin)
    swath, beyond = _ego_swath(ego, areas)
    return Scene(
        name=f"nuscenes_{scenario['id']}",
        category="recorded",
        factors=(),
        vehicle=RENAULT_ZOE,
        ego=ego,
        agents=tuple(_agent(name, track, times_us, origin) for name, track in tracks.items()),
        lanes=tuple(lanes),
        road_edges=edges([*areas, *swath]),
        drivable=outlines([*areas, *swath]),
        route=route_along(ego.positions, float(yaw[-1]), lanes),
        assumptions=(
            "ego box: data sheet of a Renault Zoe",
            "flat ground, all boxes on it",
            f"drivable area: the lanes, {LANE_WIDTH:g} m wide where only a centre line is recorded, and where the "
            f"recorded ego drove ({beyond} of its {len(ego)} poses reach beyond the lanes)",
        ),
    )


def _motion(state: dict[str, Any], origin: Array) -> Array:
    """x, y and heading (n, 3) at all steps."""
    position = np.array(state["position"], dtype=np.float64)[:, :2] - origin
    return np.column_stack([position, np.array(state["heading"], dtype=np.float64)])


def _agent(name: str, track: dict[str, Any], times_us: NDArray[np.int64], origin: Array) -> Agent:
    state = track["state"]
    valid = np.array(state["valid"]) > 0
    length, width, height = (
        float(np.median(np.array(state[size], dtype=np.float64).ravel()[valid]))
        for size in ("length", "width", "height")
    )
    x, y, yaw = _motion(state, origin)[valid].T
    poses = np.column_stack([x, y, np.full_like(x, 0.5 * height), yaw])
    # The longest known beginning of a category such as `vehicle.bus.rigid`.
    words = track["metadata"]["type"].split(".")
    labels = [_LABELS.get(".".join(words[:count])) for count in range(len(words), 0, -1)]
    label = next(filter(None, labels), None)
    if label is None:
        raise ValueError(f"category {'.'.join(words)} is not known")
    return Agent(name, label, length, width, height, times_us[valid], poses)


def _read_lanes(features: dict[str, Any], origin: Array) -> tuple[list[Lane], list[shapely.Polygon]]:
    """Lanes with their successors, and the area of each."""
    lanes, areas = [], []
    for name, feature in features.items():
        center = np.array(feature["polyline"], dtype=np.float64)[:, :2] - origin
        center = without_repeats(center)
        if not feature["type"].startswith("LANE") or len(center) < 2:
            continue
        if feature.get("polygon"):
            area = shapely.Polygon(np.array(feature["polygon"], dtype=np.float64)[:, :2] - origin)
            width = area.area / length_of(center)
        else:
            area, width = shapely.LineString(center).buffer(0.5 * LANE_WIDTH), LANE_WIDTH
        areas.append(area)
        lanes.append(lane_around(name, np.column_stack([center, np.zeros(len(center))]), 0.5 * width))
    return link_by_place(lanes), areas


def _ego_swath(ego: Trajectory, areas: list[shapely.Polygon]) -> tuple[list[shapely.Polygon], int]:
    """What the ego's box swept between successive poses, where it leaves the areas, and how many poses do."""
    x, y, yaw = ego.T_world_rig[:, 0, 3], ego.T_world_rig[:, 1, 3], np.arctan2(*ego.T_world_rig[:, 1::-1, 0].T)
    ahead = RENAULT_ZOE.rear_axle_to_bbox_center
    centers = np.column_stack([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), np.zeros_like(x), yaw])
    boxes = footprints(centers, RENAULT_ZOE.length, RENAULT_ZOE.width)
    union = shapely.union_all([shapely.make_valid(area) for area in areas])
    beyond = ~shapely.covers(union, boxes)
    touched = beyond[:-1] | beyond[1:]
    pairs = shapely.union(boxes[:-1][touched], boxes[1:][touched])
    return list(shapely.convex_hull(pairs)), int(beyond.sum())
