"""NuRec scenes (.usdz) as AlpaSim reads them: ego motion, tracks and map of a reconstructed drive.

Read: `metadata.yaml`, `rig_trajectories.json`, `sequence_tracks.json`, and the first map of `map_data/`, `clipgt/`,
`fastmap/` (Parquet) and `map.xodr` that there is; layout and sources: docs/formats/alpasim.md. Not read: what only a
renderer needs, the USD layers among it, as AlpaSim does not read them either. Rig poses and tracks are taken in the
frame in which they stand, as AlpaSim takes them.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from olt_closed_loop.scenes.maps.lanes import Control, Lane, StopLine
from olt_closed_loop.scenes.polylines import without_repeats
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.sources.archives import Archive
from olt_closed_loop.scenes.sources.assembly import RecordedDrive, assemble_scene, lane_area, usable_line
from olt_closed_loop.scenes.sources.fields import coordinates, expect, member, numbers
from olt_closed_loop.scenes.sources.georeference import map_in_world
from olt_closed_loop.scenes.sources.roads import lane_between, link_by_place
from olt_closed_loop.scenes.sources.tracks import Times, Track, check_times, longest_stretch
from olt_generator.errors import InputError
from olt_generator.poses import Array, pose_from_quaternion, yaw_of
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.parquet_files import open_parquet, read_rows
from olt_toolkit.rigs.rig import VehicleDimensions
from olt_toolkit.runtime.json_files import parse_json
from olt_toolkit.runtime.yaml_files import parse_yaml

_MAP_FOLDERS = ("map_data", "clipgt", "fastmap")
_TO_NUREC = ("world_to_nre", "world_to_nurec")
"""The package was called nre until 26.08, and is called nurec since."""
_DEFAULT_BOX = VehicleDimensions(
    length=5.393, width=2.109, height=1.503, rear_axle_to_bbox_center=1.3965, wheelbase=2.9, track_width=1.7
)
"""AlpaSim's ego box where the scene has none; wheelbase and track width are estimates."""
_CONTROLS: dict[str, Control] = {"STOP": "stop", "YIELD": "yield"}
_LABELS = {
    "automobile",
    "heavy_truck",
    "bus",
    "trailer",
    "other_vehicle",
    "train_or_tram_car",
    "person",
    "rider",
    "bicycle",
    "stroller",
    "animal",
    "protruding_object",
}
_UNIT_TOLERANCE = 1e-3


def read_nurec(path: Path) -> Scene:
    """Read one archive.

    Raises:
        InputError: it is no such archive, is damaged or hostile, or its drive is not one; it names member and field.
    """
    archive = Archive(path)
    rigs = _json(archive, "rig_trajectories.json")
    try:
        return _make_scene(archive, rigs)
    except InputError as error:
        told = str(error)
        raise InputError(told if told.startswith(str(path)) else f"{path}: {told}") from error


def _json(archive: Archive, name: str) -> Any:
    return parse_json(archive.read(name), f"{archive.path}: {name}")


def _make_scene(archive: Archive, rigs: Any) -> Scene:
    where = "rig_trajectories.json"
    drives = member(rigs, "rig_trajectories", list, where)
    if len(drives) != 1:
        raise InputError(f"{where}: {len(drives)} trajectories; one is read")
    drive = expect(drives[0], dict, f"{where}: rig_trajectories")
    times_us, T_world_rig = _read_rig(drive, where)
    kept = longest_stretch(times_us)
    times_us, T_world_rig = times_us[kept], T_world_rig[kept]
    vehicle, size = _read_box(drive.get("rig_bbox"), f"{where}: rig_bbox")
    tracks = list(_read_tracks(_json(archive, "sequence_tracks.json"), int(times_us[0])))
    lanes, areas, stop_lines, road = _read_map(archive, rigs)
    return assemble_scene(
        RecordedDrive(
            name=f"nurec_{_scene_id(archive)}",
            vehicle=vehicle,
            ego=Trajectory(times_us - times_us[0], T_world_rig),
            agents=tracks,
            lanes=lanes,
            areas=areas,
            assumptions=(size, *_word_frames(rigs), *road),
            stop_lines=stop_lines,
        )
    )


def _scene_id(archive: Archive) -> str:
    where = f"{archive.path}: metadata.yaml"
    try:
        text = archive.read("metadata.yaml").decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: is not UTF-8; copy it again") from error
    return member(parse_yaml(text, where), "scene_id", str, "metadata.yaml")


def _word_frames(rigs: dict[str, Any]) -> list[str]:
    """What is to be said of the frames of tracks and rig."""
    for name in _TO_NUREC:
        if name in rigs:
            where = f"rig_trajectories.json: {name}: matrix"
            matrix = numbers(member(rigs[name], "matrix", list, name), where)
            if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
                raise InputError(f"{where} is no 4 x 4 matrix")
            if np.allclose(matrix, np.eye(4), atol=1e-6):
                return []
            return [f"rig and tracks are taken in one frame, as AlpaSim takes them, although {name} is no identity"]
    raise InputError(f"rig_trajectories.json: {' or '.join(_TO_NUREC)} is missing")


def _read_rig(drive: dict[str, Any], where: str) -> tuple[Times, Array]:
    times_us = _read_times(member(drive, "T_rig_world_timestamps_us", list, where), where)
    check_times(times_us, f"{where}: T_rig_world_timestamps_us")
    poses = numbers(member(drive, "T_rig_worlds", list, where), f"{where}: T_rig_worlds")
    if poses.shape != (len(times_us), 4, 4):
        raise InputError(f"{where}: T_rig_worlds is {poses.shape}, and there are {len(times_us)} times")
    coordinates(poses[:, :3, 3], f"{where}: T_rig_worlds", columns=3)
    rotations = poses[:, :3, :3]
    upright = np.abs(rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)) <= _UNIT_TOLERANCE
    rigid = np.allclose(poses[:, 3], [0.0, 0.0, 0.0, 1.0])
    if not (rigid and upright.all() and np.all(np.linalg.det(rotations) > 0.0)):
        raise InputError(f"{where}: a pose of T_rig_worlds is no rotation and translation")
    return times_us, poses


def _read_times(values: Any, where: str) -> Times:
    """Microseconds (n,)."""
    if not all(isinstance(value, int) and abs(value) < 2**62 for value in values):
        raise InputError(f"{where}: a time is no whole number of microseconds")
    return np.array(values, dtype=np.int64)


def _read_box(box: Any, where: str) -> tuple[VehicleDimensions, str]:
    if box is None:
        return _DEFAULT_BOX, "ego box: AlpaSim's default, as the scene has none"
    center, size, turn = (
        coordinates([member(box, name, list, where)], f"{where}: {name}", columns=3)[0]
        for name in ("centroid", "dim", "rot")
    )
    if np.any(np.abs(turn) >= 1e-4) or not np.all((size > 0.0) & (size < 30.0)):
        raise InputError(f"{where}: is turned, or of no usual size")
    length, width, height = size.tolist()
    vehicle = VehicleDimensions(length, width, height, float(center[0]), 0.56 * length, 0.8 * width)
    return vehicle, (
        f"wheelbase {vehicle.wheelbase:.2f} m and track width {vehicle.track_width:.2f} m: a car's usual proportions; "
        "the ego's box is that of the scene"
    )


def _read_tracks(sequences: Any, start_us: int) -> Iterator[Track]:
    where = "sequence_tracks.json"
    if len(expect(sequences, dict, where)) != 1:
        raise InputError(f"{where}: {len(sequences)} sequences; one is read")
    (sequence,) = sequences.values()
    data, boxes = (member(sequence, name, dict, where) for name in ("tracks_data", "cuboidtracks_data"))
    names = ("tracks_id", "tracks_label_class", "tracks_timestamps_us", "tracks_poses")
    columns = [member(data, name, list, where) for name in names]
    columns.append(member(boxes, "cuboids_dims", list, where))
    if len({len(column) for column in columns}) != 1:
        raise InputError(f"{where}: {', '.join(names)} and cuboids_dims are not of one length")
    seen = set[str]()
    for name, label, times, poses, size in zip(*columns, strict=True):
        here = f"{where}: track {name!s:.60}"
        if str(name) in seen:
            raise InputError(f"{here} is there twice")
        seen.add(str(name))
        if not isinstance(label, str) or label.lower() not in _LABELS:
            raise InputError(f"{here}: class {label!s:.60} is not known")
        times_us = _read_times(expect(times, list, here), here)
        rows = coordinates(poses, f"{here}: tracks_poses", columns=7)
        if len(rows) != len(times_us) or len(rows) == 0:
            raise InputError(f"{here}: {len(rows)} poses for {len(times_us)} times")
        if np.any(np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) > _UNIT_TOLERANCE):
            raise InputError(f"{here}: a quaternion whose length is not 1")
        length, width, height = coordinates([size], f"{here}: cuboids_dims", columns=3)[0].tolist()
        yaw = yaw_of(pose_from_quaternion(rows[:, 3:], rows[:, :3]))
        yield Track(
            str(name), label.lower(), length, width, height, times_us - start_us, np.column_stack([rows[:, :3], yaw])
        )


Map = tuple[Sequence[Lane], Sequence[shapely.Polygon], tuple[StopLine, ...], tuple[str, ...]]


def _read_map(archive: Archive, rigs: dict[str, Any]) -> Map:
    names = archive.names()
    for folder in _MAP_FOLDERS:
        tables = {name.rpartition("/")[2]: name for name in names if name.startswith(f"{folder}/")}
        lane_table = _find_table(tables, "lane")
        if lane_table is not None:
            lanes = _read_lanes(archive, lane_table)
            if lanes:
                lines = _find_table(tables, "wait_line")
                stops = tuple(_read_wait_lines(archive, lines, {lane.id for lane in lanes})) if lines else ()
                areas = [lane_area(lane.left, lane.right) for lane in lanes]
                return lanes, areas, stops, (f"drivable area: the lanes of {folder}/; they follow each other by place",)
    if "map.xodr" in names:
        T_world_base = numbers(member(rigs, "T_world_base", list, "rig_trajectories.json"), "T_world_base")
        lanes, areas, notes = map_in_world(archive.read("map.xodr"), T_world_base)
        return lanes, areas, (), notes
    return (), (), (), ()


def _find_table(tables: dict[str, str], kind: str) -> str | None:
    """The member that holds a kind of map element: KIND.parquet, or CLIP.KIND.parquet."""
    found = [name for file, name in sorted(tables.items()) if file.split(".")[-2:] == [kind, "parquet"]]
    return found[0] if found else None


def _rows(archive: Archive, name: str, columns: tuple[str, str]) -> list[dict[str, Any]]:
    where = f"{archive.path}: {name}"
    with open_parquet(archive.read(name), where) as file:
        missing = [column for column in columns if column not in file.schema_arrow.names]
        if missing:
            raise InputError(f"{where}: column {missing[0]} is missing")
        return read_rows(file, where).select(list(columns)).to_pylist()


def _line(points: Any, where: str) -> Array:
    """Points (n, 3) of a list of x, y, z."""
    rows = [[member(point, axis, float, where) for axis in "xyz"] for point in expect(points, list, where)]
    return coordinates(rows, where, columns=3)


def _read_lanes(archive: Archive, name: str) -> list[Lane]:
    lanes = []
    for number, row in enumerate(_rows(archive, name, ("key", "lane"))):
        where = f"{name}: row {number}"
        lane_id = _map_id(row, where)
        lane = member(row, "lane", dict, where)
        left, right = (
            without_repeats(_line(lane.get(side), f"{where}: {side}")) for side in ("left_rail", "right_rail")
        )
        if usable_line(left) and usable_line(right):
            lanes.append(lane_between(lane_id, left, right, ()))
    if len({lane.id for lane in lanes}) < len(lanes):
        raise InputError(f"{name}: two lanes of one id")
    return link_by_place(lanes)


def _map_id(row: dict[str, Any], where: str) -> str:
    value = member(row, "key", dict, where).get("map_id")
    if not isinstance(value, str | int):
        raise InputError(f"{where}: key has no map_id")
    return str(value)


def _read_wait_lines(archive: Archive, name: str, lanes: set[str]) -> Iterator[StopLine]:
    for number, row in enumerate(_rows(archive, name, ("key", "wait_line"))):
        where = f"{name}: row {number}"
        line_id = _map_id(row, where)
        line = member(row, "wait_line", dict, where)
        points = _line(line.get("location"), f"{where}: location")
        if len(points) >= 2:
            lane = line_id.rpartition("-")[2]
            control = _CONTROLS.get(str(line.get("category")).upper())
            yield StopLine(line_id, points[[0, -1]], (lane,) if lane in lanes else (), control)
