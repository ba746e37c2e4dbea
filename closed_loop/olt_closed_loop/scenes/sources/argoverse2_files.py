"""Tables and maps of Argoverse 2 as arrays; every complaint names the file, the column or field, and the row's place.

Formats: docs/formats/source_datasets.md, and the public documentation of av2-api.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.scenes.maps.lanes import Crossing, Marking
from olt_closed_loop.scenes.polylines import length_of
from olt_closed_loop.scenes.scene import Lane
from olt_closed_loop.scenes.sources.fields import FARTHEST, coordinates, expect, member
from olt_closed_loop.scenes.sources.roads import lane_between
from olt_closed_loop.scenes.sources.tracks import FARTHEST_FROM_EGO
from olt_generator.errors import InputError
from olt_generator.poses import Array, pose_from_quaternion
from olt_toolkit.runtime.json_files import read_json

EGO_COLUMNS = "timestamp_ns qw qx qy qz tx_m ty_m tz_m"
_TEXTS = ("track_uuid", "category", "track_id", "object_type", "scenario_id")
_INTEGERS = ("timestamp_ns", "timestep")
_ROW_NAMES = ("track_uuid", "track_id", "timestamp_ns", "timestep")
_NORM_TOLERANCE = 1e-3
_VEHICLE_LANES = ("VEHICLE", "BUS")
_SHORTEST_LANE = 0.1
# Whether a single solid white line may be crossed differs by state; of half-solid lines the side is not recorded.
_MARKINGS = {
    **{
        f"{line}_{color}": Marking("dashed", True)
        for line in ("DASHED", "DOUBLE_DASH")
        for color in ("WHITE", "YELLOW")
    },
    "NONE": Marking("none"),
    "SOLID_WHITE": Marking("solid"),
    "SOLID_BLUE": Marking("solid"),
    "SOLID_YELLOW": Marking("solid", False),
    "DOUBLE_SOLID_WHITE": Marking("double", False),
    "DOUBLE_SOLID_YELLOW": Marking("double", False),
    **{f"{line}_{color}": Marking("double") for line in ("DASH_SOLID", "SOLID_DASH") for color in ("WHITE", "YELLOW")},
}
"""Markings by their types; others, and UNKNOWN, are not known."""

Columns = dict[str, NDArray[Any]]


def read_table(path: Path, names: str) -> Columns:
    """The named columns of a Feather or Parquet file: texts, integers, and finite numbers up to FARTHEST.

    Raises:
        InputError: the file cannot be read, or a column is missing, of another kind, or holds something else.
    """
    import pyarrow
    from pyarrow import feather, parquet

    columns = names.split()
    try:
        read = feather.read_table if path.suffix == ".feather" else parquet.read_table
        table = read(path, columns=columns)
        values = {name: table[name].to_numpy() for name in columns if name in table.column_names}
    except (OSError, pyarrow.ArrowException) as error:
        why = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read ({why}); give an unchanged copy of the log") from error
    missing = [name for name in columns if name not in values]
    if missing:
        raise InputError(f"{path}: column {missing[0]} is missing; give an unchanged copy of the log")
    return {name: _checked(path, name, values) for name in columns}


def _checked(path: Path, name: str, values: Columns) -> NDArray[Any]:
    column = values[name]
    if name in _TEXTS:
        if column.dtype.kind not in "OUiu" or any(value is None for value in column):
            raise InputError(f"{path}: column {name} holds what is no text; give an unchanged copy of the log")
        return column.astype(str)
    if column.dtype.kind not in ("iu" if name in _INTEGERS else "iuf"):
        kind = "whole numbers" if name in _INTEGERS else "numbers"
        raise InputError(
            f"{path}: column {name} holds {column.dtype}, {kind} are expected; give an unchanged copy of the log"
        )
    most = np.iinfo(np.int64).max if name == "timestamp_ns" else FARTHEST
    wrong = ~((column >= -most) & (column <= most))
    if wrong.any():
        row = int(np.argmax(wrong))
        place = " ".join(f"{other} {values[other][row]!s:.80}" for other in _ROW_NAMES if other in values)
        raise InputError(
            f"{path}: column {name} holds {column[row]} ({place or f'row {row}'}), which is no finite number of that "
            "kind; give an unchanged copy of the log"
        )
    return column.astype(np.int64 if name in _INTEGERS else np.float64)


def table_poses(table: Columns, path: Path) -> Array:
    """Poses (n, 4, 4) of a table with quaternions and translations.

    Raises:
        InputError: a quaternion's length is not 1.
    """
    quaternions = np.column_stack([table[name] for name in ("qx", "qy", "qz", "qw")])
    wrong = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) > _NORM_TOLERANCE
    if wrong.any():
        row = int(np.argmax(wrong))
        place = " ".join(f"{name} {table[name][row]!s:.80}" for name in _ROW_NAMES if name in table)
        raise InputError(f"{path}: a quaternion qw, qx, qy, qz whose length is not 1 ({place}); give an unchanged copy")
    return pose_from_quaternion(quaternions, np.column_stack([table[name] for name in ("tx_m", "ty_m", "tz_m")]))


def ego_poses(path: Path, times_ns: NDArray[np.int64]) -> Array:
    """Ego poses (n, 4, 4) at exactly these times.

    Raises:
        InputError: the file or a column is missing, or there is no pose, or several that differ, at such a time.
    """
    table = read_table(path, EGO_COLUMNS)
    order = np.argsort(table["timestamp_ns"], kind="stable")
    known = table["timestamp_ns"][order]
    first, last = (np.searchsorted(known, times_ns, side=side) for side in ("left", "right"))
    missing = times_ns[first == last]
    if len(missing):
        raise InputError(f"{path}: no ego pose at timestamp_ns {missing[0]} of the annotations; give the whole log")
    values = np.column_stack([table[name][order] for name in EGO_COLUMNS.split()[1:]])
    several = np.any(values[first] != values[last - 1], axis=1)
    if several.any():
        twice = times_ns[np.argmax(several)]
        raise InputError(f"{path}: two ego poses at timestamp_ns {twice} that differ; give an unchanged copy")
    return table_poses({name: column[order][first] for name, column in table.items()}, path)


def rows_of(tracks: NDArray[Any], times_us: NDArray[np.int64]) -> list[tuple[str, NDArray[np.intp]]]:
    """The rows of each track in order of time, by track."""
    names, index = np.unique(tracks, return_inverse=True)
    order = np.lexsort((times_us, index))
    bounds = np.searchsorted(index[order], np.arange(len(names) + 1))
    return [(str(name), order[bounds[i] : bounds[i + 1]]) for i, name in enumerate(names)]


RoadParts = tuple[list[Lane], tuple[Array, ...], tuple[Crossing, ...]]


def read_map(folder: Path, origin: Array, flat: bool = False) -> RoadParts:
    """Driving lanes, outlines (n, 3) of the drivable areas, and crossings; with heights 0 if `flat`.

    Nothing without a map file. Right of way, stop lines and lights are not recorded.

    Raises:
        InputError: there are several maps, or the one is damaged or of another place.
    """
    found = sorted(folder.glob("log_map_archive_*.json"))
    if not found:
        return [], (), ()
    path = single(folder, "log_map_archive_*.json")
    content = read_json(path, "map")
    try:
        segments, areas = (member(content, name, dict, "map") for name in ("lane_segments", "drivable_areas"))
        lanes = [_lane(name, segment, origin, flat) for name, segment in segments.items()]
        outlines = [
            _points(area, "area_boundary", f"drivable area {name:.40}", origin, flat, fewest=3)
            for name, area in areas.items()
        ]
        driven = [lane for lane in lanes if lane is not None and length_of(lane.center) > _SHORTEST_LANE]
        walked = expect(content.get("pedestrian_crossings") or {}, dict, "map: pedestrian_crossings")
        crossings = tuple(_crossing(name, crossing, origin, flat, driven) for name, crossing in walked.items())
    except InputError as error:
        raise InputError(f"{path}: not an Argoverse 2 map ({error}); give an unchanged copy of the log") from error
    areas = tuple(line if shapely.LinearRing(line[:, :2]).is_ccw else line[::-1] for line in outlines)
    return driven, areas, crossings


def _lane(name: str, segment: Any, origin: Array, flat: bool) -> Lane | None:
    where = f"lane segment {name:.40}"
    if member(segment, "lane_type", str, where) not in _VEHICLE_LANES:
        return None
    left, right = (
        _points(segment, f"{side}_lane_boundary", where, origin, flat, fewest=1) for side in ("left", "right")
    )
    successors = tuple(str(successor) for successor in member(segment, "successors", list, where))
    return replace(
        lane_between(str(segment.get("id", name)), left, right, successors),
        type="driving" if segment["lane_type"] == "VEHICLE" else None,
        left_neighbours=_neighbours(segment, "left_neighbor_id"),
        right_neighbours=_neighbours(segment, "right_neighbor_id"),
        left_marking=_MARKINGS.get(str(segment.get("left_lane_mark_type"))),
        right_marking=_MARKINGS.get(str(segment.get("right_lane_mark_type"))),
        junction="intersection" if segment.get("is_intersection") is True else None,
    )


def _neighbours(segment: Any, name: str) -> tuple[str, ...] | None:
    if name not in segment:
        return None
    return () if segment[name] is None else (str(segment[name]),)


def _crossing(name: str, crossing: Any, origin: Array, flat: bool, lanes: Sequence[Lane]) -> Crossing:
    """A crossing between its two edges; how it is painted is not recorded."""
    first, second = (
        _points(crossing, edge, f"pedestrian crossing {name:.40}", origin, flat, fewest=2)
        for edge in ("edge1", "edge2")
    )
    # The edges may run either way.
    ends = np.linalg.norm(first[-1, :2] - second[[0, -1], :2], axis=1)
    outline = np.concatenate([first, second if ends[0] <= ends[1] else second[::-1]])
    if not shapely.LinearRing(outline[:, :2]).is_ccw:
        outline = outline[::-1].copy()
    area = shapely.make_valid(shapely.Polygon(outline[:, :2]))
    crossed = tuple(lane.id for lane in lanes if area.intersects(shapely.LineString(lane.center[:, :2])))
    return Crossing(name, outline, crossed)


def _points(holder: Any, name: str, where: str, origin: Array, flat: bool, fewest: int) -> Array:
    """Points (n, 3) from the origin of the drive, within FARTHEST_FROM_EGO."""
    where, points = f"{where}: {name}", member(holder, name, list, where)
    axes = ("x", "y") if flat else ("x", "y", "z")
    if not all(isinstance(point, dict) and all(axis in point for axis in axes) for point in points):
        raise InputError(f"{where} has a point without {', '.join(axes)}")
    rows = [[*(point[axis] for axis in axes), *([0.0] if flat else [])] for point in points]
    line = coordinates(rows, where, columns=3, fewest=fewest) - origin
    if np.any(np.abs(line) > FARTHEST_FROM_EGO):
        raise InputError(f"{where} is more than {FARTHEST_FROM_EGO * 1e-3:g} km from the ego: not its map")
    return line


def single(folder: Path, pattern: str) -> Path:
    """The one file that the pattern finds."""
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        raise InputError(f"{folder}: {len(found)} files {pattern}, one is needed; give an unchanged copy of the log")
    return found[0]
