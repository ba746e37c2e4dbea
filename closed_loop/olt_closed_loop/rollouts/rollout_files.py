"""Reads single rollouts from JSON, in the format in which AlpaSim's scores of them were taken.

One object:

- `timestamps_us` [T]; `render_start_us` and `force_gt_duration_us`, whose sum is the hand-over;
- `ego` {length, width, height, rear_axle_to_center, poses [T][x, y, yaw]}: poses of the rig;
- `agents` {id: {length, width, height, timestamps_us [n], poses [n][x, y, yaw] or [x, y, yaw, z]}}: box centres;
  without z they stand on the ground z = 0, as the ego does. Only samples at one of the ego's times count, and of whom
  none does is left out of the score, which says so;
- `gt` {timestamps_us [n], poses [n][x, y, yaw]}: the recorded ego, poses of the rig;
- `map` {lanes [{id, center, left?, right?, red_us?}], road_edges [polyline], resample_m?} or null; polylines are points
  [x, y] or [x, y, z] and get more until none is farther than `resample_m` from the next (2 m when absent, 0: none);
  `red_us` [[from, until]..] says when the light at the start of a lane was red ([]: never; absent: not known);
- `plans` [{now_us, query_us?, timestamps_us [n], poses [n][x, y, yaw], samples? [[n][x, y, yaw]]}];
- `failure`? text, why the rollout broke off; `driver_ended`? whether the driver asked for the end of the session
  (AlpaSim's `terminate_session`).
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout_record import PLAN_STEP_US, EgoBox, LaneLines, PlanRecord, RolloutRecord
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scenes.sources.fields import FARTHEST
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.runtime.json_files import read_json

RESAMPLE_M = 2.0
LARGEST = 10_000.0
"""Metres of a box: no wall beside a road is longer."""
_LATEST_US = 2**53
_MOST_POINTS = 1_000_000


def read_rollout_file(path: Path) -> RolloutRecord:
    """Read one rollout.

    Raises:
        InputError: the file is missing, is not JSON, or a field is missing or of another form.
    """
    try:
        values = read_json(path, "rollout")
    except InputError as error:
        raise InputError(f"{path}: not a JSON file ({error}); give one rollout") from error
    try:
        return parse_rollout(values, path.stem)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except KeyError as error:
        raise InputError(f"{path}: field {error} is missing; add it") from error
    except (AttributeError, OverflowError, RecursionError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: a field is of another form ({error}); see olt_closed_loop.rollouts.rollout_files"
        ) from error


def parse_rollout(values: dict[str, Any], name: str) -> RolloutRecord:
    """The rollout that `values` describe.

    Raises:
        InputError: times do not increase, numbers are not finite or no metres, counts do not fit, or a size is none.
        KeyError: a field is missing.
    """
    times = _times(values["timestamps_us"], "timestamps_us")
    ego, recorded, road = values["ego"], values["gt"], values.get("map") or {}
    recorded_us = _times(recorded["timestamps_us"], "gt timestamps_us")
    agents = {key: _agent(key, value, times) for key, value in values["agents"].items()}
    resample_m = float(road.get("resample_m", RESAMPLE_M))
    if not resample_m >= 0.0:
        raise InputError(f"map resample_m is {resample_m}; give 0 or more")
    return RolloutRecord(
        name=name,
        handover_us=_time(values, "render_start_us", "rollout") + _time(values, "force_gt_duration_us", "rollout"),
        timestamps_us=times,
        poses=_on_ground(_rows(ego["poses"], (3,), len(times), "ego poses")),
        box=EgoBox(*_sizes(ego, "ego"), _finite(ego["rear_axle_to_center"], "ego rear_axle_to_center")),
        agents=tuple(agent for agent in agents.values() if agent),
        recorded_us=recorded_us,
        recorded_poses=_on_ground(_rows(recorded["poses"], (3,), len(recorded_us), "gt poses")),
        lanes=tuple(_lane(lane, resample_m) for lane in road.get("lanes", ())),
        road_edges=tuple(_line(edge, resample_m, "road edge") for edge in road.get("road_edges", ())),
        plans=tuple(_plan(index, plan) for index, plan in enumerate(values["plans"]) if plan["poses"]),
        failure=_choice(values, "failure", str, None),
        driver_ended=_choice(values, "driver_ended", bool, False),
        absent=tuple(key for key, agent in agents.items() if agent is None),
    )


def _choice(values: dict[str, Any], name: str, kind: type, absent: Any) -> Any:
    """A value that may be left out."""
    value = values.get(name, absent)
    if value is not absent and not isinstance(value, kind):
        raise InputError(f"{name} is {value!r}; give {kind.__name__} or leave it out")
    return value


def _agent(name: str, values: dict[str, Any], scored_us: NDArray[np.int64]) -> Agent | None:
    """An agent at the ego's times; None when it has no sample at any of them."""
    where = f"agent {name}"
    length, width, height = _sizes(values, where)
    if not values["timestamps_us"]:
        return None
    times = _times(values["timestamps_us"], f"{where} timestamps_us")
    rows = _rows(values["poses"], (3, 4), len(times), f"{where} poses")
    heights = rows[:, 3] if rows.shape[1] == 4 else np.full(len(rows), 0.5 * height)
    poses = np.column_stack([rows[:, :2], heights, rows[:, 2]])
    counts = np.isin(times, scored_us)
    return Agent(name, "unknown", length, width, height, times[counts], poses[counts]) if counts.any() else None


def _lane(values: dict[str, Any], resample_m: float) -> LaneLines:
    where = f"lane {values['id']}"
    borders = (values.get("left"), values.get("right"))
    left, right = (_line(line, resample_m, f"{where} border") if line else None for line in borders)
    return LaneLines(_line(values["center"], resample_m, f"{where} center"), left, right, _red(values, where))


def _red(values: dict[str, Any], where: str) -> NDArray[np.int64] | None:
    """From when until when (k, 2) a light was red; None where nothing is said."""
    if values.get("red_us") is None:
        return None
    red_us = np.array(values["red_us"], dtype=np.int64).reshape(-1, 2)
    if (red_us[:, 0] >= red_us[:, 1]).any():
        raise InputError(f"{where} red_us: a phase ends before it begins; give [from, until]")
    return red_us


def _plan(index: int, values: dict[str, Any]) -> PlanRecord:
    where = f"plan {index}"
    times = _times(values["timestamps_us"], f"{where} timestamps_us")
    now_us = _time(values, "now_us", where)
    return PlanRecord(
        now_us=now_us,
        query_us=_time(values, "query_us", where) if "query_us" in values else now_us + PLAN_STEP_US,
        timestamps_us=times,
        poses=_rows(values["poses"], (3,), len(times), f"{where} poses"),
        samples=tuple(_rows(s, (3,), len(times), f"{where} samples") for s in values.get("samples") or ()),
    )


def _line(points: list[list[float]], resample_m: float, where: str) -> Array:
    """A polyline (n, 3) with points added at equal distances in each segment that is `resample_m` long or longer."""
    rows = _rows(points, (2, 3), len(points), where)
    if len(rows) < 2:
        raise InputError(f"{where} has {len(rows)} points; give two or more")
    line = np.column_stack([rows, np.zeros(len(rows))]) if rows.shape[1] == 2 else rows
    if resample_m == 0.0:
        return line
    parts = 1 + np.floor(np.linalg.norm(np.diff(line, axis=0), axis=1) / resample_m)
    if not parts.sum() < _MOST_POINTS:
        raise InputError(f"{where} would get {parts.sum():.3g} points; give a resample_m above {resample_m:g}")
    parts = parts.astype(int)
    ends = np.concatenate([[0], np.cumsum(parts)])
    return np.stack([np.interp(np.arange(ends[-1] + 1), ends, column) for column in line.T], axis=-1)


def _times(values: list[int], where: str) -> NDArray[np.int64]:
    """Strictly increasing times (n,), n >= 1."""
    times = np.array(values)
    if times.ndim != 1 or len(times) == 0 or not np.issubdtype(times.dtype, np.integer):
        raise InputError(f"{where}: give one or more integer microseconds")
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        raise InputError(
            f"{where}: time {late[0] + 1} ({times[late[0] + 1]}) is not after the one before it; sort them"
        )
    if max(abs(int(times[0])), abs(int(times[-1]))) > _LATEST_US:
        raise InputError(f"{where}: a time is beyond 2^53 us, 285 years; is it another unit?")
    return times.astype(np.int64)


def _time(values: dict[str, Any], name: str, where: str) -> int:
    if not abs(float(values[name])) <= _LATEST_US:
        raise InputError(f"{where}: {name} is {float(values[name]):g}; give integer microseconds")
    return int(values[name])


def _rows(values: list[list[float]], columns: tuple[int, ...], count: int, where: str) -> Array:
    """Numbers (count, c), no farther from 0 than any map projection reaches, where c is one of `columns`."""
    rows = np.array(values, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] not in columns:
        raise InputError(f"{where}: give rows of {' or '.join(map(str, columns))} numbers")
    if len(rows) != count:
        raise InputError(f"{where}: {len(rows)} rows for {count} times; give one each")
    if not np.isfinite(rows).all():
        raise InputError(f"{where}: row {int(np.argmin(np.isfinite(rows).all(axis=1)))} is not finite")
    if rows.size and np.abs(rows).max() > FARTHEST:
        raise InputError(f"{where}: {np.abs(rows).max():g} is no place in metres or heading in radians")
    return rows


def _sizes(values: dict[str, Any], where: str) -> tuple[float, float, float]:
    length, width, height = (_finite(values[key], f"{where} {key}") for key in ("length", "width", "height"))
    if min(length, width, height) <= 0.0 or max(length, width, height) > LARGEST:
        raise InputError(
            f"{where}: box {length:g} x {width:g} x {height:g} m; sizes must be positive and at most {LARGEST:g} m"
        )
    return length, width, height


def _finite(value: float, where: str) -> float:
    if not abs(float(value)) <= FARTHEST:
        raise InputError(f"{where} is {value}; give a finite number of metres")
    return float(value)


def _on_ground(rows: Array) -> Array:
    """Rig poses (n, 4) x, y, z, yaw of rows (n, 3) x, y, yaw."""
    return np.column_stack([rows[:, :2], np.zeros(len(rows)), rows[:, 2]])
