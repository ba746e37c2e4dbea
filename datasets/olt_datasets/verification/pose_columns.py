"""Whether histories and futures in a table of frames are of one drive: in the rig frame of their moment, and drivable.

The names of a column tell its numbers, as in `x(-1.5 s)` and `yaw(+0.1 s)`.
"""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from olt_generator.poses import Array, planar_pose, yaw_of
from olt_toolkit.clips.verification.drivability import check_drivable, check_heading
from olt_toolkit.clips.verification.findings import Finding, judge, not_compared

HISTORY, FUTURE = "observation.state", "action"
ORIGIN_ERROR = 1e-3
"""m and rad, of the pose of a history that is now: it is the origin, in float32."""
STEP_ERROR = 0.05
"""m and rad between the future of one frame and the history of the next; roll and pitch are not told, and cost less."""
_NAME = re.compile(r"(x|y|z|yaw)\(([+-]\d+\.\d+) s\)")
_FIELDS = ("x", "y", "z", "yaw")


def check_pose_columns(info: dict[str, Any], episodes: pa.Table, data: pa.Table, where: str) -> Iterator[Finding]:
    """Look at the poses of every episode."""
    steps = [pose_times(info["features"].get(name, {})) for name in (HISTORY, FUTURE)]
    if any(
        times is None or name not in data.column_names for name, times in zip((HISTORY, FUTURE), steps, strict=True)
    ):
        why = f"no columns {HISTORY} and {FUTURE} whose names tell poses, as in x(-1.5 s)"
        yield not_compared("histories and futures", where, why)
        return
    times = [np.array(each) for each in steps if each is not None]
    expected = np.round(np.concatenate(times) * info["fps"])
    in_order = np.array_equal(expected, np.arange(1 - len(times[0]), len(times[1]) + 1))
    detail = "times are not all tenths of a second from the oldest history to the last future, in order"
    yield judge("times of poses", where, float(not in_order), 0.0, detail)
    history, future = (_poses(data, name) for name in (HISTORY, FUTURE))
    begin = 0
    for number, length in enumerate(episodes["length"].to_pylist()):
        rows = slice(begin, begin + length)
        begin += length
        yield from check_episode(history[rows], future[rows], f"{where}: episode {number}")


def pose_times(feature: dict[str, Any]) -> list[float] | None:
    """Seconds from now of each pose of a column; None where its names do not tell poses."""
    found = [_NAME.fullmatch(name) for name in feature.get("names") or ()]
    if not found or any(match is None for match in found):
        return None
    parts = [match.groups() for match in found if match is not None]
    times = [float(time) for _, time in parts[::4]]
    ordered = [(field, f"{time:+.1f}") for time in times for field in _FIELDS]
    return times if [(field, f"{float(time):+.1f}") for field, time in parts] == ordered else None


def check_episode(history: Array, future: Array, where: str) -> Iterator[Finding]:
    """Check histories (n, 16, 4, 4) and futures (n, 64, 4, 4) of frames that follow each other at 10 Hz."""
    now = history[:, -1]
    off = np.maximum(np.linalg.norm(now[:, :3, 3], axis=1), np.abs(yaw_of(now)))
    frame = int(np.argmax(off))
    detail = f"m or rad from the origin, of the last pose of a history (frame {frame}); poses are in the rig frame now"
    yield judge("history ends at the origin", where, float(off[frame]), ORIGIN_ERROR, detail)
    if len(history) > 1:
        yield _check_overlap(history, future, where)
    whole = np.concatenate([history[0], future[0], _continue(future)])
    yield from check_drivable(whole, where)
    yield from check_heading(whole, where)


def _check_overlap(history: Array, future: Array, where: str) -> Finding:
    """Where a frame sees the next is where the next saw it from, turned about."""
    there_and_back = future[:-1, 0] @ history[1:, -2]
    off = np.maximum(np.linalg.norm(there_and_back[:, :3, 3], axis=1), np.abs(yaw_of(there_and_back)))
    frame = int(np.argmax(off))
    detail = f"m or rad between the future of a frame and the history of the next (frame {frame}); of one drive?"
    return judge("history continues future", where, float(off[frame]), STEP_ERROR, detail)


def _continue(future: Array) -> Array:
    """The last pose (m, 4, 4) of the future of each later frame, in the frame of the first."""
    here = np.eye(4)
    poses = []
    for step, after in zip(future[:-1, 0], future[1:, -1], strict=True):
        here = here @ step
        poses.append(here @ after)
    return np.array(poses).reshape(-1, 4, 4)


def _poses(data: pa.Table, name: str) -> NDArray[np.float64]:
    values = data[name].combine_chunks().flatten().to_numpy().astype(np.float64).reshape(len(data), -1, 4)
    return planar_pose(values[..., 0], values[..., 1], values[..., 3], values[..., 2])
