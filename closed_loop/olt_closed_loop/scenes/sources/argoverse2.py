"""Argoverse 2: sensor logs (3-D boxes and map) and motion-forecasting scenarios (tracks and map); no pictures.

Formats: docs/formats/source_datasets.md, and the public documentation of av2-api. City coordinates are moved so
that the scene begins at the recorded ego's first position.
"""

from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Agent, Lane, Scene
from olt_closed_loop.scenes.sources.roads import edges, lane_between, route_along
from olt_generator.errors import InputError
from olt_generator.poses import Array, make_pose, planar_pose, pose_from_quaternion, yaw_of
from olt_generator.trajectory import Trajectory
from olt_toolkit.policy.contract import STEP_US
from olt_toolkit.rigs.rig import VehicleDimensions
from olt_toolkit.runtime.json_files import read_json

FORD_FUSION = VehicleDimensions(
    length=4.872, width=1.852, height=1.473, rear_axle_to_bbox_center=1.34, wheelbase=2.850, track_width=1.58
)
"""The recording car, a Ford Fusion Hybrid of 2013 to 2020, from its data sheet, without mirrors; the place of the box
over the rear axle is an estimate."""
AXLE_HEIGHT = 0.32
"""Metres from the ground to the ego frame's origin on the rear axle: median over the public sensor log and its map."""

_T_EGO_RIG = make_pose(np.eye(3), [0.0, 0.0, -AXLE_HEIGHT])
_EGO_COLUMNS = "timestamp_ns qw qx qy qz tx_m ty_m tz_m"
_NORM_TOLERANCE = 1e-3
_EGO_TRACK = "AV"
_VEHICLE_LANES = ("VEHICLE", "BUS")
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
        "protruding_object": "BOLLARD MOBILE_PEDESTRIAN_CROSSING_SIGN SIGN STOP_SIGN",
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


def read_sensor_log(folder: Path) -> Scene:
    """Read a sensor log; the scene lasts from its first to its last annotated sweep, at the rate of the sweeps.

    Raises:
        InputError: a file or column is missing, or a sweep has no ego pose.
    """
    boxes = _table(
        folder / "annotations.feather",
        "timestamp_ns track_uuid category length_m width_m height_m qw qx qy qz tx_m ty_m tz_m",
    )
    sweeps_ns, sweep = np.unique(boxes["timestamp_ns"], return_inverse=True)
    T_city_ego = _ego_poses(folder / "city_SE3_egovehicle.feather", sweeps_ns)
    T_city_rig = T_city_ego @ _T_EGO_RIG
    origin = T_city_rig[0, :3, 3].copy()
    T_city_rig[:, :3, 3] -= origin

    T_city_box = T_city_ego[sweep] @ _poses(boxes)
    poses = np.column_stack([T_city_box[:, :3, 3] - origin, yaw_of(T_city_box)])
    times_us = np.round((sweeps_ns - sweeps_ns[0]) / 1000).astype(np.int64)
    agents = []
    for track, rows in _rows_of(boxes["track_uuid"], times_us[sweep]):
        label = _look_up(_SENSOR_LABELS, str(boxes["category"][rows[0]]), folder / "annotations.feather")
        length, width, height = (float(boxes[name][rows[0]]) for name in ("length_m", "width_m", "height_m"))
        agents.append(Agent(track, label, length, width, height, times_us[sweep][rows], poses[rows]))
    return _scene(
        folder.name.removeprefix("argoverse2_sensor_log_"),
        Trajectory(times_us, T_city_rig),
        agents,
        _read_map(folder / "map", origin),
        (
            "ego box: data sheet of a Ford Fusion without mirrors",
            f"rig on the ground {AXLE_HEIGHT:g} m below the recorded axle",
        ),
    )


def read_motion_scenario(folder: Path) -> Scene:
    """Read a motion scenario: 11 s at 10 Hz in the plane.

    Raises:
        InputError: a file or column is missing, or there is no track `AV`.
    """
    path = _single(folder, "scenario_*.parquet")
    tracks = _table(path, "track_id object_type timestep position_x position_y heading scenario_id")
    ego, first = _motion_ego(tracks, path)
    times_us = STEP_US * (tracks["timestep"] - tracks["timestep"][first]).astype(np.int64)
    origin = np.array([tracks["position_x"][first], tracks["position_y"][first], 0.0])
    x, y, heading = tracks["position_x"] - origin[0], tracks["position_y"] - origin[1], tracks["heading"]
    agents, left_out = [], 0
    for track, rows in _rows_of(tracks["track_id"], times_us):
        kind = str(tracks["object_type"][rows[0]])
        if track == _EGO_TRACK or kind in _WITHOUT_SIZE:
            left_out += track != _EGO_TRACK
            continue
        label, length, width, height = _look_up(_MOTION_CLASSES, kind, path)
        poses = np.column_stack([x[rows], y[rows], np.full(len(rows), 0.5 * height), heading[rows]])
        agents.append(Agent(track, label, length, width, height, times_us[rows], poses))
    return _scene(
        tracks["scenario_id"][0],
        ego,
        agents,
        _read_map(folder, origin, flat=True),
        (
            "ego box: data sheet of a Ford Fusion without mirrors, its rear axle at the recorded position (its "
            "sideways speed in bends is that of the rear axle)",
            "boxes of agents: the usual size of their class",
            "flat ground",
            f"{left_out} tracks of unknown size ({', '.join(_WITHOUT_SIZE)}) left out",
        ),
    )


def _scene(
    name: str,
    ego: Trajectory,
    agents: list[Agent],
    road: tuple[list[Lane], tuple[Array, ...]],
    assumptions: tuple[str, ...],
) -> Scene:
    lanes, areas = road
    return Scene(
        name=f"argoverse2_{name}",
        category="recorded",
        factors=(),
        vehicle=FORD_FUSION,
        ego=ego,
        agents=tuple(agents),
        lanes=tuple(lanes),
        road_edges=edges([shapely.Polygon(area[:, :2]) for area in areas]),
        drivable=areas,
        route=route_along(ego.positions, float(yaw_of(ego.T_world_rig[-1])), lanes),
        assumptions=assumptions,
    )


def read_sensor_ego(folder: Path) -> Trajectory:
    """The ego's motion in a sensor log at its full rate, from its first pose on; the frame is the city's.

    Raises:
        InputError: the file or a column is missing, or a pose is damaged.
    """
    path = folder / "city_SE3_egovehicle.feather"
    table = _table(path, _EGO_COLUMNS)
    norms = np.linalg.norm([table[name] for name in ("qw", "qx", "qy", "qz")], axis=0)
    if len(norms) == 0 or np.abs(norms - 1.0).max() > _NORM_TOLERANCE:
        raise InputError(f"{path}: holds no poses, or a quaternion qw, qx, qy, qz whose length is not 1")
    times_ns = table["timestamp_ns"]
    # Real logs have poses a few nanoseconds apart: one of each microsecond is kept.
    times_us, first = np.unique(np.round((times_ns - times_ns.min()) / 1000).astype(np.int64), return_index=True)
    T_city_ego = _poses({name: values[first] for name, values in table.items()})
    return Trajectory(times_us, T_city_ego @ _T_EGO_RIG)


def read_motion_ego(folder: Path) -> Trajectory:
    """The ego's motion in a motion scenario, in the plane, from its first position.

    Raises:
        InputError: the file or a column is missing, or there is no track `AV`.
    """
    path = _single(folder, "scenario_*.parquet")
    return _motion_ego(_table(path, "track_id timestep position_x position_y heading"), path)[0]


def read_scenario_id(path: Path) -> str | None:
    """The id that stands in a readable file of tracks, None where it has no column of ids; InputError for several."""
    from pyarrow import parquet

    if "scenario_id" not in parquet.read_schema(path).names:
        return None
    ids = np.unique(_table(path, "scenario_id")["scenario_id"].astype(str))
    if len(ids) != 1:
        raise InputError(f"{path}: column scenario_id holds {len(ids)} ids; give an unchanged copy of the scenario")
    return str(ids[0])


Columns = dict[str, NDArray[Any]]


def _table(path: Path, names: str) -> Columns:
    """The named columns of a Feather or Parquet file."""
    import pyarrow
    from pyarrow import feather, parquet

    columns = names.split()
    try:
        read = feather.read_table if path.suffix == ".feather" else parquet.read_table
        table = read(path, columns=columns)
    except (OSError, pyarrow.ArrowException) as error:
        why = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read ({why}); give an unchanged copy of the log") from error
    missing = [name for name in columns if name not in table.column_names]
    if missing:
        raise InputError(f"{path}: column {missing[0]} is missing; give an unchanged copy of the log")
    values = {name: table[name].to_numpy() for name in columns}
    for name, column in values.items():
        if column.dtype.kind == "f" and not np.all(np.isfinite(column)):
            raise InputError(f"{path}: column {name} holds what is no finite number; give an unchanged copy of the log")
    return values


def _poses(table: Columns) -> Array:
    quaternions = np.column_stack([table[name] for name in ("qx", "qy", "qz", "qw")])
    return pose_from_quaternion(quaternions, np.column_stack([table[name] for name in ("tx_m", "ty_m", "tz_m")]))


def _motion_ego(tracks: Columns, path: Path) -> tuple[Trajectory, int]:
    """The ego's motion from its first position, and the row of that."""
    rows = np.flatnonzero(tracks["track_id"] == _EGO_TRACK)
    if len(rows) == 0:
        raise InputError(f"{path}: no track {_EGO_TRACK}, which is the ego; give another scenario")
    rows = rows[np.argsort(tracks["timestep"][rows])]
    steps = tracks["timestep"][rows].astype(np.int64)
    if np.any(np.diff(steps) == 0):
        twice = steps[np.argmin(np.diff(steps))]
        raise InputError(f"{path}: track {_EGO_TRACK} has two rows of timestep {twice}; give an unchanged copy")
    times_us = STEP_US * steps
    x, y, heading = (tracks[name][rows] for name in ("position_x", "position_y", "heading"))
    return Trajectory(times_us - times_us[0], planar_pose(x - x[0], y - y[0], heading)), int(rows[0])


def _ego_poses(path: Path, times_ns: NDArray[np.int64]) -> Array:
    """Ego poses (n, 4, 4) at exactly these times."""
    table = _table(path, _EGO_COLUMNS)
    order = np.argsort(table["timestamp_ns"])
    known = table["timestamp_ns"][order]
    at = np.minimum(np.searchsorted(known, times_ns), len(known) - 1)
    missing = times_ns[known[at] != times_ns]
    if len(missing):
        raise InputError(f"{path}: no ego pose at timestamp_ns {missing[0]} of the annotations; give the whole log")
    return _poses({name: values[order[at]] for name, values in table.items()})


def _rows_of(tracks: NDArray[Any], times_us: NDArray[np.int64]) -> list[tuple[str, NDArray[np.intp]]]:
    """The rows of each track in order of time, by track."""
    names, index = np.unique(tracks.astype(str), return_inverse=True)
    order = np.lexsort((times_us, index))
    bounds = np.searchsorted(index[order], np.arange(len(names) + 1))
    return [(str(name), order[bounds[i] : bounds[i + 1]]) for i, name in enumerate(names)]


def _look_up(known: dict[str, Any], kind: str, path: Path) -> Any:
    if kind not in known:
        raise InputError(f"{path}: class {kind} is not known; one of {', '.join(known)} is expected")
    return known[kind]


def _read_map(folder: Path, origin: Array, flat: bool = False) -> tuple[list[Lane], tuple[Array, ...]]:
    """Driving lanes, and outlines (n, 3) of the drivable areas; with heights 0 if `flat`."""
    path = _single(folder, "log_map_archive_*.json")
    try:
        content = read_json(path, "map")
        segments, areas = content["lane_segments"].values(), content["drivable_areas"].values()
        lanes = [
            lane_between(
                str(segment["id"]),
                _points(segment["left_lane_boundary"], origin, flat),
                _points(segment["right_lane_boundary"], origin, flat),
                tuple(str(name) for name in segment["successors"]),
            )
            for segment in segments
            if segment["lane_type"] in _VEHICLE_LANES
        ]
        outlines = [_points(area["area_boundary"], origin, flat) for area in areas]
        return lanes, tuple(line if shapely.LinearRing(line[:, :2]).is_ccw else line[::-1] for line in outlines)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, shapely.errors.GEOSException) as error:
        raise InputError(f"{path}: not an Argoverse 2 map ({error!r}); give an unchanged copy of the log") from error


def _points(points: list[dict[str, float]], origin: Array, flat: bool) -> Array:
    line = np.array([[point["x"], point["y"], 0.0 if flat else point["z"]] for point in points], dtype=np.float64)
    return line - origin


def _single(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        raise InputError(f"{folder}: {len(found)} files {pattern}, one is needed; give an unchanged copy of the log")
    return found[0]
