"""Route, boxes of others, holds and road of a clip as tables, and as samples take them.

`{clip}.route.parquet` has x, y of the route in the anchor frame; `{clip}.obstacle.offline.parquet` the columns of the
public table of that name, in the rig frame at each time; `{clip}.hold.parquet` what `Holds` has; `{clip}.road.parquet`
points of the route with the metres of road to their right and left.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.poses import Array, transform, yaw_of
from olt_toolkit.clips.clip import Clip, EgoMotion
from olt_toolkit.clips.pai_layout import HOLDS, OBSTACLES, ROAD, ROUTE
from olt_toolkit.clips.pai_tables import read_table
from olt_toolkit.policy.contract import STEP_US
from olt_toolkit.policy.route import ROUTE_POINTS, routes_ahead
from olt_toolkit.policy.sample import MOST_OBSTACLES, TRUTH_OFFSETS_US
from olt_toolkit.policy.window import LONGEST_REFUSED_T0_US
from olt_toolkit.recordings.truth import OBSTACLE_CLASSES, Holds, ObstacleTracks

_CENTER = ("center_x", "center_y", "center_z")
_SIZE = ("size_x", "size_y", "size_z")
_ORIENTATION = ("orientation_x", "orientation_y", "orientation_z", "orientation_w")
_ROAD = ("x", "y", "right", "left")
_SYNTHETIC = "truth"
_OTHER = OBSTACLE_CLASSES.index("other")


def truth_tables(clip: Clip) -> dict[str, pd.DataFrame]:
    """The tables of a clip by feature, of what its source knows."""
    tables: dict[str, pd.DataFrame] = {}
    if clip.route is not None:
        tables[ROUTE] = pd.DataFrame({"x": clip.route[:, 0], "y": clip.route[:, 1]})
    if clip.obstacles is not None:
        tables[OBSTACLES] = _obstacle_table(clip.obstacles)
    if clip.holds is not None:
        tables[HOLDS] = pd.DataFrame(
            {"timestamp_us": clip.holds.timestamps_us, "is_held": clip.holds.is_held, "distance": clip.holds.distance}
        )
    if clip.road is not None:
        tables[ROAD] = pd.DataFrame(dict(zip(_ROAD, clip.road.T, strict=True)))
    return tables


def _obstacle_table(tracks: ObstacleTracks) -> pd.DataFrame:
    columns: dict[str, object] = {
        "timestamp_us": tracks.timestamps_us,
        "track_id": tracks.track_ids,
        "label_class": tracks.labels,
        "reference_frame": "rig",
        "reference_frame_timestamp_us": tracks.timestamps_us,
    }
    half, level = 0.5 * tracks.boxes[:, 3], np.zeros(len(tracks.boxes))
    turns = np.column_stack([level, level, np.sin(half), np.cos(half)])
    for names, values in ((_CENTER, tracks.boxes[:, :3]), (_SIZE, tracks.boxes[:, 4:]), (_ORIENTATION, turns)):
        columns |= dict(zip(names, values.T, strict=True))
    return pd.DataFrame(columns | {"source": _SYNTHETIC})


def read_route(data: bytes, where: str) -> Array:
    """The route (n, 2) of `{clip}.route.parquet`; an `InputError` where it is no line of two finite points or more."""
    route = _floats(read_table(data, ["x", "y"], where), ("x", "y"), where)
    if len(route) < 2:
        raise InputError(f"{where}: {len(route)} points; a route has two or more")
    return route


def read_road(data: bytes, where: str) -> Array:
    """Points and road (n, 4) of `{clip}.road.parquet`; an `InputError` where they are not two or more or not finite."""
    road = _floats(read_table(data, list(_ROAD), where), _ROAD, where)
    if len(road) < 2:
        raise InputError(f"{where}: {len(road)} points; a road has two or more")
    if np.any(road[:, 2:] < 0.0):
        raise InputError(f"{where}: columns right and left hold negative metres")
    return road


def read_obstacles(data: bytes, where: str) -> ObstacleTracks:
    """Read `{clip}.obstacle.offline.parquet`; an `InputError` where a column is missing or not as it must be."""
    words = ["track_id", "label_class", "reference_frame"]
    numbers = (*_CENTER, *_ORIENTATION, *_SIZE)
    table = read_table(data, ["timestamp_us", "reference_frame_timestamp_us", *words, *numbers], where)
    times, frames = (_integers(table, name, where) for name in ("timestamp_us", "reference_frame_timestamp_us"))
    track_ids, labels, reference = (_words(table, name, where) for name in words)
    if not np.array_equal(times, frames) or np.any(reference != "rig"):
        raise InputError(f"{where}: boxes must be in the frame of the rig at their own time")
    values = _floats(table, numbers, where)
    quaternions = values[:, 3:7]
    if np.any(np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) > 1e-3):
        raise InputError(f"{where}: columns {', '.join(_ORIENTATION)} hold quaternions that are not unit length")
    yaw = 2.0 * np.arctan2(quaternions[:, 2], quaternions[:, 3])
    return ObstacleTracks(times, track_ids, labels, np.column_stack([values[:, :3], yaw, values[:, 7:]]))


def read_holds(data: bytes, where: str) -> Holds:
    """Read `{clip}.hold.parquet`; an `InputError` where a column is missing or not as it must be."""
    table = read_table(data, ["timestamp_us", "is_held", "distance"], where)
    times = _integers(table, "timestamp_us", where)
    held, distance = table.column("is_held"), table.column("distance")
    if not pa.types.is_boolean(held.type) or not pa.types.is_floating(distance.type) or held.null_count:
        raise InputError(f"{where}: is_held must be true or false, distance a number")
    if len(times) == 0 or np.any(np.diff(times) <= 0):
        raise InputError(f"{where}: column timestamp_us must hold strictly increasing times")
    return Holds(times, np.array(held.to_pylist(), dtype=bool), np.asarray(distance.to_numpy(), dtype=np.float64))


@dataclass(frozen=True)
class SampleTruth:
    """What samples hand on of the truth; arrays (n, ...) are those of `PolicySample`."""

    obstacle_boxes: NDArray[np.float32]
    obstacle_classes: NDArray[np.int64]
    hold: NDArray[np.float32]
    road: NDArray[np.float32]

    def of(self, row: int) -> dict[str, Any]:
        """Those of one sample, by name."""
        return {name: values[row] for name, values in vars(self).items()}


def sample_routes(route: Array | None, motion: EgoMotion, t0s_us: NDArray[np.int64]) -> NDArray[np.float32]:
    """The route ahead (n, 20, 2) at times t0 on the 0.1 s grid, as the closed loop would show it; NaN if not known."""
    return _ahead(route, 2, motion, t0s_us)


def _ahead(line: Array | None, columns: int, motion: EgoMotion, t0s_us: NDArray[np.int64]) -> NDArray[np.float32]:
    """What lies ahead on a line (n, columns) at times t0: (times, 20, columns), NaN if not known."""
    if line is None:
        return np.full((len(t0s_us), ROUTE_POINTS, columns), np.nan, dtype=np.float32)
    first = LONGEST_REFUSED_T0_US + STEP_US
    times = np.arange(first, int(t0s_us.max()) + 1, STEP_US, dtype=np.int64)
    poses = motion.interpolate(times)
    ahead = routes_ahead(line, np.column_stack([poses[:, :2, 3], yaw_of(poses)]))
    return ahead[(t0s_us - first) // STEP_US].astype(np.float32)


def sample_truth(
    obstacles: ObstacleTracks | None,
    holds: Holds | None,
    road: Array | None,
    motion: EgoMotion,
    t0s_us: NDArray[np.int64],
) -> SampleTruth:
    """What is known about times t0 (n,), which lie on the grid of the labels where there are any."""
    boxes = np.full((len(t0s_us), len(TRUTH_OFFSETS_US), MOST_OBSTACLES, 5), np.nan, dtype=np.float32)
    classes = np.full((len(t0s_us), MOST_OBSTACLES), -1, dtype=np.int64)
    hold = np.full((len(t0s_us), 2), np.nan, dtype=np.float32)
    for row, t0_us in enumerate(t0s_us.tolist()):
        if obstacles is not None:
            _fill_obstacles(obstacles, motion, t0_us, boxes[row], classes[row])
        if holds is not None and (place := np.flatnonzero(holds.timestamps_us == t0_us)).size:
            hold[row] = holds.is_held[place[0]], holds.distance[place[0]]
    return SampleTruth(boxes, classes, hold, _ahead(road, len(_ROAD), motion, t0s_us))


def _fill_obstacles(
    tracks: ObstacleTracks, motion: EgoMotion, t0_us: int, boxes: NDArray[np.float32], classes: NDArray[np.int64]
) -> None:
    """Write the nearest obstacles at t0, and where these are later, seen from the rig at t0."""
    now = np.flatnonzero(tracks.timestamps_us == t0_us)
    nearest = now[np.argsort(np.hypot(*tracks.boxes[now, :2].T), kind="stable")[:MOST_OBSTACLES]]
    slots = {track: slot for slot, track in enumerate(tracks.track_ids[nearest].tolist())}
    known = {label: number for number, label in enumerate(OBSTACLE_CLASSES)}
    classes[: len(nearest)] = [known.get(label, _OTHER) for label in tracks.labels[nearest].tolist()]
    times = [t0_us + offset for offset in TRUTH_OFFSETS_US if t0_us + offset <= motion.span_us[1]]
    poses = motion.interpolate(np.array(times, dtype=np.int64))
    T_t0_later = np.linalg.inv(poses[0]) @ poses
    for step, time_us in enumerate(times):
        rows = np.flatnonzero(tracks.timestamps_us == time_us)
        rows = rows[[track in slots for track in tracks.track_ids[rows].tolist()]] if len(rows) else rows
        places = [slots[track] for track in tracks.track_ids[rows].tolist()]
        centers = transform(T_t0_later[step], tracks.boxes[rows, :3])
        yaw = tracks.boxes[rows, 3] + yaw_of(T_t0_later[step])
        boxes[step, places] = np.column_stack([centers[:, :2], yaw, tracks.boxes[rows, 4:6]])


def _words(table: pa.Table, name: str, where: str) -> NDArray[np.str_]:
    column = table.column(name)
    if not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)) or column.null_count:
        raise InputError(f"{where}: column {name} is {column.type}; it must be text, none missing")
    return np.array(column.to_pylist(), dtype=np.str_)


def _floats(table: pa.Table, names: tuple[str, ...], where: str) -> Array:
    for name in names:
        if not pa.types.is_floating(table.column(name).type) or table.column(name).null_count:
            raise InputError(f"{where}: column {name} must be numbers, none missing")
    values = np.stack([table.column(name).to_numpy().astype(np.float64) for name in names], axis=-1)
    if not np.isfinite(values).all():
        raise InputError(f"{where}: columns {', '.join(names)} hold values that are not finite")
    return values


def _integers(table: pa.Table, name: str, where: str) -> NDArray[np.int64]:
    column = table.column(name)
    if not pa.types.is_signed_integer(column.type) or column.null_count:
        raise InputError(f"{where}: column {name} is {column.type}; it must be int64 microseconds, none missing")
    return column.to_numpy().astype(np.int64)
