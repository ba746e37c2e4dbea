"""Argoverse 2: sensor logs (3-D boxes and map) and motion-forecasting scenarios (tracks and map); no pictures.

Formats: docs/formats/source_datasets.md, and the public documentation of av2-api. City coordinates are moved so
that the scene begins at the recorded ego's first position. Gaps: `tracks`.
"""

from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scenes.sources.argoverse2_files import (
    EGO_COLUMNS,
    Columns,
    RoadParts,
    ego_poses,
    read_map,
    read_table,
    rows_of,
    single,
    table_poses,
)
from olt_closed_loop.scenes.sources.roads import NO_ROAD, edges, route_along
from olt_closed_loop.scenes.sources.tracks import (
    MOST_GAP_US,
    Track,
    agents_of,
    check_motion,
    check_times,
    longest_stretch,
    word_away,
)
from olt_generator.errors import InputError
from olt_generator.omissions import Omission, word_omission
from olt_generator.poses import make_pose, planar_pose, yaw_of
from olt_generator.trajectory import Trajectory
from olt_toolkit.policy.contract import STEP_US
from olt_toolkit.rigs.rig import VehicleDimensions

ANNOTATIONS = ("annotations.feather", "annotations_with_ego.feather")
"""Files of boxes, the first that is there is read; the second also holds the ego, as scenario mining writes it."""
FORD_FUSION = VehicleDimensions(
    length=4.872, width=1.852, height=1.473, rear_axle_to_bbox_center=1.34, wheelbase=2.850, track_width=1.58
)
"""The recording car, a Ford Fusion Hybrid of 2013 to 2020, from its data sheet, without mirrors; the place of the box
over the rear axle is an estimate."""
AXLE_HEIGHT = 0.32
"""Metres from the ground to the ego frame's origin on the rear axle: median over the public sensor log and its map."""

_T_EGO_RIG = make_pose(np.eye(3), [0.0, 0.0, -AXLE_HEIGHT])
_EGO_TRACK, _EGO_CLASS = "AV", "EGO_VEHICLE"
_SENSOR_LABELS = {
    kind: label
    for label, kinds in {
        "animal": "ANIMAL DOG",
        "automobile": "REGULAR_VEHICLE",
        "barrier": "CONSTRUCTION_BARREL",
        "bicycle": "BICYCLE",
        "bus": "ARTICULATED_BUS BUS SCHOOL_BUS",
        "cone": "CONSTRUCTION_CONE",
        "heavy_truck": "BOX_TRUCK TRUCK TRUCK_CAB",
        "other_vehicle": "LARGE_VEHICLE",
        "person": "OFFICIAL_SIGNALER PEDESTRIAN WHEELCHAIR",
        "protruding_object": "BOLLARD MOBILE_PEDESTRIAN_CROSSING_SIGN MOBILE_PEDESTRIAN_SIGN SIGN STOP_SIGN",
        "rider": "BICYCLIST MOTORCYCLE MOTORCYCLIST WHEELED_DEVICE WHEELED_RIDER",
        "stroller": "STROLLER",
        "trailer": "MESSAGE_BOARD_TRAILER TRAFFIC_LIGHT_TRAILER VEHICULAR_TRAILER",
        "train_or_tram_car": "RAILED_VEHICLE",
    }.items()
    for kind in kinds.split()
}
# Label, length, width, height: motion scenarios hold no sizes.
_MOTION_CLASSES = {
    "vehicle": ("automobile", 4.6, 1.85, 1.5),
    "bus": ("bus", 12.0, 2.55, 3.2),
    "pedestrian": ("person", 0.5, 0.6, 1.75),
    "motorcyclist": ("rider", 2.1, 0.8, 1.7),
    "cyclist": ("rider", 1.8, 0.65, 1.75),
    "riderless_bicycle": ("bicycle", 1.8, 0.6, 1.1),
}
_WITHOUT_SIZE = ("static", "background", "construction", "unknown")


def find_annotations(folder: Path) -> Path | None:
    """The file of boxes of a sensor log; None if there is none."""
    return next((folder / name for name in ANNOTATIONS if (folder / name).is_file()), None)


def read_sensor_log(folder: Path) -> Scene:
    """Read a sensor log; the scene lasts from its first to its last annotated sweep, at the rate of the sweeps.

    Rows of the class EGO_VEHICLE are the ego and no obstacle. Without a map there are no lanes and no drivable area.

    Raises:
        InputError: a file or column is missing or damaged, nothing is annotated, or a sweep has no ego pose.
    """
    path = find_annotations(folder)
    if path is None:
        raise InputError(f"{folder}: none of {', '.join(ANNOTATIONS)}; give a log with annotations")
    boxes = read_table(path, "timestamp_ns track_uuid category length_m width_m height_m qw qx qy qz tx_m ty_m tz_m")
    sweeps_ns, sweep = np.unique(boxes["timestamp_ns"], return_inverse=True)
    if len(sweeps_ns) == 0:
        raise InputError(f"{path}: holds no rows; a drive lasts as long as its annotations, give a log with some")
    times_us = np.round((sweeps_ns - sweeps_ns[0]) / 1000).astype(np.int64)
    check_times(times_us, f"{path}: timestamp_ns")
    poses_path = folder / "city_SE3_egovehicle.feather"
    T_city_ego = ego_poses(poses_path, sweeps_ns)
    kept = longest_stretch(times_us)
    T_city_rig = (T_city_ego @ _T_EGO_RIG)[kept]
    origin = T_city_rig[0, :3, 3].copy()
    T_city_rig[:, :3, 3] -= origin
    ego = Trajectory(times_us[kept] - times_us[kept][0], T_city_rig)
    check_motion(ego, str(poses_path))

    T_city_box = T_city_ego[sweep] @ table_poses(boxes, path)
    poses = np.column_stack([T_city_box[:, :3, 3] - origin, yaw_of(T_city_box)])
    sampled_us = (times_us - times_us[kept][0])[sweep]
    tracks = []
    for track, rows in rows_of(boxes["track_uuid"], sampled_us):
        kind = str(boxes["category"][rows[0]]).upper()
        if kind == _EGO_CLASS:
            continue
        label = _look_up(_SENSOR_LABELS, kind, path, track)
        length, width, height = (float(boxes[name][rows[0]]) for name in ("length_m", "width_m", "height_m"))
        tracks.append(Track(track, label, length, width, height, sampled_us[rows], poses[rows]))
    return _scene(
        folder.name.removeprefix("argoverse2_sensor_log_"),
        ego,
        _in_stretches(tracks, ego, path),
        read_map(folder / "map", origin),
        (
            "ego box: data sheet of a Ford Fusion without mirrors",
            f"rig on the ground {AXLE_HEIGHT:g} m below the recorded axle",
            *_word_cut(len(ego), len(times_us)),
        ),
    )


def read_motion_scenario(folder: Path) -> Scene:
    """Read a motion scenario: 11 s at 10 Hz in the plane.

    Raises:
        InputError: a file or column is missing or damaged, or there is no track `AV`.
    """
    path = single(folder, "scenario_*.parquet")
    tracks = read_table(path, "track_id object_type timestep position_x position_y heading scenario_id")
    whole = _motion_rows(tracks, path)
    rows = whole[longest_stretch(STEP_US * tracks["timestep"][whole])]
    ego, first = _motion_ego(tracks, rows), int(rows[0])
    check_times(ego.timestamps_us, f"{path}: track {_EGO_TRACK}")
    check_motion(ego, f"{path}: track {_EGO_TRACK}")
    times_us = STEP_US * (tracks["timestep"] - tracks["timestep"][first])
    origin = np.array([tracks["position_x"][first], tracks["position_y"][first], 0.0])
    x, y, heading = tracks["position_x"] - origin[0], tracks["position_y"] - origin[1], tracks["heading"]
    agents, left_out = [], 0
    for track, rows in rows_of(tracks["track_id"], times_us):
        kind = str(tracks["object_type"][rows[0]]).lower()
        if track == _EGO_TRACK or kind in _WITHOUT_SIZE:
            left_out += track != _EGO_TRACK
            continue
        label, length, width, height = _look_up(_MOTION_CLASSES, kind, path, track)
        poses = np.column_stack([x[rows], y[rows], np.full(len(rows), 0.5 * height), heading[rows]])
        agents.append(Track(track, label, length, width, height, times_us[rows], poses))
    return _scene(
        tracks["scenario_id"][0],
        ego,
        _in_stretches(agents, ego, path),
        read_map(folder, origin, flat=True),
        (
            "ego box: data sheet of a Ford Fusion without mirrors, its rear axle at the recorded position (its "
            "sideways speed in bends is that of the rear axle)",
            "boxes of agents: the usual size of their class",
            "flat ground",
            f"{left_out} tracks of unknown size ({', '.join(_WITHOUT_SIZE)}) left out",
            *_word_cut(len(ego), len(whole)),
        ),
    )


def _in_stretches(tracks: list[Track], ego: Trajectory, path: Path) -> tuple[list[Agent], list[str]]:
    """The agents without gaps while the ego drives, and what is to be said of them."""
    parts = {
        track.id: list(agents_of(track, int(ego.timestamps_us[-1]), f"{path}: track {track.id:.80}"))
        for track in tracks
    }
    apart, away = ([name for name, some in parts.items() if matches(len(some))] for matches in ((1).__lt__, (0).__eq__))
    notes = [word_away(apart)] if apart else []
    if away:
        notes.append(word_omission(Omission("agents", "there at no time of the drive", len(away), len(tracks))))
    return [agent for some in parts.values() for agent in some], notes


def _word_cut(kept: int, count: int) -> list[str]:
    if kept == count:
        return []
    why = f"the ego is away for more than {MOST_GAP_US * 1e-6:g} s before or after the others"
    return [word_omission(Omission("poses of the ego", why, count - kept, count))]


def _scene(
    name: str,
    ego: Trajectory,
    agents: tuple[list[Agent], list[str]],
    road: RoadParts,
    assumptions: tuple[str, ...],
) -> Scene:
    lanes, areas, crossings = road
    known, notes = agents
    return Scene(
        name=f"argoverse2_{name:.200}",
        category="recorded",
        factors=(),
        vehicle=FORD_FUSION,
        ego=ego,
        agents=tuple(known),
        lanes=tuple(lanes),
        road_edges=edges([shapely.Polygon(area[:, :2]) for area in areas]),
        drivable=areas,
        route=route_along(ego.positions, float(yaw_of(ego.T_world_rig[-1])), lanes),
        assumptions=(*assumptions, *notes, *([] if areas or lanes else [NO_ROAD])),
        crossings=crossings,
    )


def read_sensor_ego(folder: Path) -> Trajectory:
    """The ego's motion in a sensor log at its full rate, from its first pose on; the frame is the city's.

    Raises:
        InputError: the file or a column is missing, or a pose is damaged.
    """
    path = folder / "city_SE3_egovehicle.feather"
    table = read_table(path, EGO_COLUMNS)
    times_ns = table["timestamp_ns"]
    if len(times_ns) == 0:
        raise InputError(f"{path}: holds no poses; give an unchanged copy of the log")
    # Real logs have poses a few nanoseconds apart: one of each microsecond is kept.
    times_us, first = np.unique(np.round((times_ns - times_ns.min()) / 1000).astype(np.int64), return_index=True)
    T_city_ego = table_poses({name: values[first] for name, values in table.items()}, path)
    return Trajectory(times_us, T_city_ego @ _T_EGO_RIG)


def read_motion_ego(folder: Path) -> Trajectory:
    """The ego's motion in a motion scenario, in the plane, from its first position.

    Raises:
        InputError: the file or a column is missing, or there is no track `AV`.
    """
    path = single(folder, "scenario_*.parquet")
    tracks = read_table(path, "track_id timestep position_x position_y heading")
    return _motion_ego(tracks, _motion_rows(tracks, path))


def read_scenario_id(path: Path) -> str | None:
    """The id that stands in a readable file of tracks, None where it has no column of ids; InputError for several."""
    from pyarrow import parquet

    if "scenario_id" not in parquet.read_schema(path).names:
        return None
    ids = np.unique(read_table(path, "scenario_id")["scenario_id"])
    if len(ids) != 1:
        raise InputError(f"{path}: column scenario_id holds {len(ids)} ids; give an unchanged copy of the scenario")
    return str(ids[0])


def _motion_rows(tracks: Columns, path: Path) -> NDArray[np.intp]:
    """The rows of the ego in order of time."""
    rows = np.flatnonzero(tracks["track_id"] == _EGO_TRACK)
    if len(rows) == 0:
        raise InputError(f"{path}: no track {_EGO_TRACK}, which is the ego; give another scenario")
    rows = rows[np.argsort(tracks["timestep"][rows], kind="stable")]
    steps = tracks["timestep"][rows]
    if np.any(np.diff(steps) == 0):
        twice = steps[np.argmin(np.diff(steps))]
        raise InputError(f"{path}: track {_EGO_TRACK} has two rows of timestep {twice}; give an unchanged copy")
    return rows


def _motion_ego(tracks: Columns, rows: NDArray[np.intp]) -> Trajectory:
    """The ego's motion at these rows from its first position."""
    times_us = STEP_US * tracks["timestep"][rows]
    x, y, heading = (tracks[name][rows] for name in ("position_x", "position_y", "heading"))
    return Trajectory(times_us - times_us[0], planar_pose(x - x[0], y - y[0], heading))


def _look_up(known: dict[str, Any], kind: str, path: Path, track: str) -> Any:
    if kind not in known:
        raise InputError(
            f"{path}: class {kind:.80} of track {track:.80} is not known; one of {', '.join(known)} is expected"
        )
    return known[kind]
