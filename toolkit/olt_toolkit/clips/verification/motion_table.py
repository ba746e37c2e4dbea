"""Whether the columns of an ego motion table fit each other, its frame, and its own rules (docs/formats)."""

from collections.abc import Iterator

import numpy as np
from scipy.integrate import cumulative_trapezoid

from olt_generator.poses import Array, yaw_of
from olt_toolkit.clips import pai_tables as tables
from olt_toolkit.clips.clip import STANDSTILL_SPEED, EgoMotion
from olt_toolkit.clips.pai_layout import EGOMOTION
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.drivability import check_poses, check_repeated_poses
from olt_toolkit.clips.verification.findings import Finding, Verdict, judge, not_compared

QUATERNION_ERROR = 1e-3
"""Of the length of a quaternion: three decimals."""
ANCHOR_DISTANCE = 0.05
"""m between the rig at clip time 0 and the anchor's origin: a fifth of a video's pixel at 10 m, or 0.1 s at 0.5 m/s."""
ANCHOR_HEADING = 0.01
"""rad of the rig at clip time 0."""
VELOCITY_ERROR = 0.1
"""Relative, of the way in a second by the velocity column against that by the positions."""
ACCELERATION_ERROR = 0.4
"""Relative, of the change of velocity in a second: measured accelerations are noisy."""
CURVATURE_ERROR = 0.4
"""Relative, of the turn in a second."""

_WINDOW_SECONDS = 1.0
# A velocity is one in another frame where that explains the way so many times better, and its error, metres in a
# second, is more than the noise of positions.
_FRAME_GAIN, _LEAST_FRAME_ERROR = 3.0, 0.1
_SLOWEST_CURVE = 2.0 * STANDSTILL_SPEED  # m/s
_LEAST_WAY, _WAY_FLOOR = 0.1, 1.0  # metres in a second
_LEAST_CHANGE, _CHANGE_FLOOR = 0.25, 0.5  # m/s in a second
_LEAST_TURN, _TURN_FLOOR = 0.01, 0.05  # radians in a second


def check_motion(store: ClipStore, clip_id: str) -> Iterator[Finding]:
    """All that the ego motion of a clip can be asked without looking at an image."""
    data = store.read_member(clip_id, EGOMOTION, EGOMOTION)
    where = f"{store.root}: clip {clip_id}: {EGOMOTION}"
    yield check_quaternions(data, where)
    motion = tables.read_egomotion(data, where)
    yield from check_anchor(motion, where)
    yield from check_columns(motion, where)
    yield check_repeated_poses(motion, where)
    yield from check_poses(motion, where)


def check_quaternions(data: bytes, where: str) -> Finding:
    """Whether the quaternions of an ego motion table have unit length."""
    table = tables.read_table(data, tables.QUATERNION, where)
    quaternions = np.stack([table.column(name).to_numpy().astype(np.float64) for name in tables.QUATERNION], axis=-1)
    error = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0)
    row = int(np.argmax(error))
    return judge("unit quaternions", where, float(error[row]), QUATERNION_ERROR, f"off unit length (row {row})")


def check_anchor(motion: EgoMotion, where: str) -> Iterator[Finding]:
    """Whether the rig stands at the origin, heading along x, at clip time 0."""
    first, last = motion.span_us
    if not first <= 0 <= last:
        why = f"the motion covers {first} to {last} us, and not clip time 0"
        yield not_compared("anchor position", where, why)
        yield not_compared("anchor heading", where, why)
        return
    start = motion.interpolate(np.zeros(1, np.int64))[0]
    advice = "of the rig at clip time 0; poses must be those of the rig in its own frame at time 0, on the same clock"
    yield judge("anchor position", where, float(np.linalg.norm(start[:3, 3])), ANCHOR_DISTANCE, f"m {advice}")
    yield judge("anchor heading", where, float(abs(yaw_of(start))), ANCHOR_HEADING, f"rad {advice}")


def check_columns(motion: EgoMotion, where: str) -> Iterator[Finding]:
    """Whether velocity, acceleration and curvature are those of the positions and rotations, second by second."""
    times = motion.trajectory.timestamps_us * 1e-6
    begin = np.arange(len(times))
    end = np.searchsorted(times, times + _WINDOW_SECONDS - 1e-6)
    begin, end = begin[end < len(times)], end[end < len(times)]
    checks = ("velocity column", "acceleration column", "curvature column")
    if len(begin) == 0:
        yield from (not_compared(check, where, "the motion is shorter than a second") for check in checks)
        return

    def change(values: Array) -> Array:
        return values[end] - values[begin]

    def integral(values: Array) -> Array:
        return change(cumulative_trapezoid(values, times, axis=0, initial=0.0))

    way = change(motion.trajectory.positions)
    speed = np.linalg.norm(motion.velocity, axis=1)
    # The curvature of a vehicle that stands is 0 by convention, whatever its heading does.
    drives = (speed[begin] > _SLOWEST_CURVE) & (speed[end] > _SLOWEST_CURVE)
    as_said = _compare(
        checks[0],
        where,
        (way, integral(motion.velocity)),
        (_LEAST_WAY, _WAY_FLOOR, VELOCITY_ERROR),
        ("the vehicle stands", "vx, vy, vz must be m/s in the anchor frame, and x, y, z metres"),
    )
    turned = np.einsum("nij,nj->ni", motion.trajectory.T_world_rig[:, :3, :3], motion.velocity)
    errors = _rms(way - integral(motion.velocity)), _rms(way - integral(turned))
    yield _judge_frame(as_said, *errors)
    yield _compare(
        checks[1],
        where,
        (change(motion.velocity), integral(motion.acceleration)),
        (_LEAST_CHANGE, _CHANGE_FLOOR, ACCELERATION_ERROR),
        ("the velocity does not change", "ax, ay, az must be m/s2 in the anchor frame"),
    )
    yield _compare(
        checks[2],
        where,
        (
            change(np.unwrap(yaw_of(motion.trajectory.T_world_rig)))[drives, None],
            integral(motion.curvature * speed)[drives, None],
        ),
        (_LEAST_TURN, _TURN_FLOOR, CURVATURE_ERROR),
        ("the vehicle does not turn", "curvature must be 1/m, positive to the left"),
    )


def _judge_frame(as_said: Finding, error: float, error_in_rig: float) -> Finding:
    """The finding of the velocity column, unless it is explained much better as one in the rig frame."""
    if as_said.verdict is not Verdict.PASSED or error < max(_LEAST_FRAME_ERROR, _FRAME_GAIN * error_in_rig):
        return as_said
    detail = (
        f"m in a second off the way of the poses, and {error_in_rig:.2g} if it is taken for one in the rig frame; "
        "vx, vy, vz must be in the anchor frame"
    )
    return Finding(as_said.check, as_said.where, Verdict.FAILED, detail, error, _LEAST_FRAME_ERROR)


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).sum(axis=1).mean()))


def _compare(
    check: str, where: str, pair: tuple[Array, Array], limits: tuple[float, float, float], words: tuple[str, str]
) -> Finding:
    """Hold changes (n, k) in each second against the integrals of another column, relative to the larger of both."""
    (least, floor, limit), (why_not, advice) = limits, words
    if len(pair[0]) == 0:
        return not_compared(check, where, "the vehicle stands")
    sizes = [_rms(values) for values in pair]
    if max(sizes) < least:
        return not_compared(check, where, f"{why_not}: {max(sizes):.2g} in a second at most, of {least:g} needed")
    error = _rms(pair[0] - pair[1]) / max(*sizes, floor)
    if error <= limit and max(sizes) < 2.0 * limit * floor:
        why = f"it changes by {max(sizes):.2g} in a second at most: a column that is twice as large would pass, too"
        return not_compared(check, where, why)
    return judge(check, where, error, limit, f"relative difference from the poses, second by second; {advice}")
