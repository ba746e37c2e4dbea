"""Whether poses are those of a road vehicle: limits are the physics of vehicles and roads, not those of recordings.

Poses are looked at as the policy eats them: interpolated at 10 Hz by the rule of the public reader. Every measure is
taken over a time or a way that is long against the noise of positions (some centimetres).
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array, yaw_of
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.verification.findings import Finding, Verdict, judge, not_compared
from olt_toolkit.policy.contract import STEP_SECONDS, STEP_US

FASTEST = 70.0
"""m/s: cars are limited to 250 km/h."""
STRONGEST_ACCELERATION = 12.0
"""m/s2 over 0.5 s, level: the grip of road tyres ends at about 1.2 g."""
STRONGEST_JERK = 150.0
"""m/s3 over 0.2 s: full brakes are applied or released within 0.1 to 0.2 s, which is at most 100."""
TIGHTEST_CURVATURE = 0.5
"""1/m, of the rear axle: the smallest turning circles of cars are 8.5 m wide, 0.4 at the rear axle."""
STEEPEST_TILT = 0.5
"""rad between the rig and gravity: the steepest streets rise by 0.34 rad (35 %), and bank little."""
LARGEST_SLIP = 0.2
"""rad between heading and way, of 95 % of the way: tyres slide from 0.1 to 0.2 rad on."""
FASTEST_BACKWARD = 7.0
"""m/s: reverse gears end at about 25 km/h."""
LONGEST_BACKWARD = 30.0
"""m: longer than the way back out of a blocked road or a parking lane."""
TURN_ERROR = 0.35
"""Relative, of turns of the way against turns of the heading."""

_SLOW_STEPS, _FAST_STEPS = 5, 2  # of the grid: 0.5 s and 0.2 s
_CHORD = 4.0  # metres over which the direction of the way is taken
_LEAST_TURN = 0.05  # radians (root mean square) from which on left can be told from right
_HEADING_NOISE = 0.05  # radians in 0.5 s, of a vehicle that stands
_BACKWARD_NOISE = 0.5  # metres
_STANDS = 0.3  # m/s


def check_poses(motion: EgoMotion, where: str) -> Iterator[Finding]:
    """Whether a vehicle can have driven along the poses, upright and along its heading."""
    poses = grid_poses(motion)
    if len(poses) < 3 * _SLOW_STEPS:
        yield not_compared("drivable poses", where, f"the motion has {len(poses)} poses at 10 Hz; too few to judge")
        return
    yield from check_drivable(poses, where)
    yield from check_heading(poses, where)


def grid_poses(motion: EgoMotion) -> Array:
    """The poses (n, 4, 4) at all whole tenths of a second that a motion covers."""
    first, last = motion.span_us
    grid = np.arange(-(-first // STEP_US), last // STEP_US + 1, dtype=np.int64) * STEP_US
    return motion.interpolate(grid) if len(grid) else np.empty((0, 4, 4))


def check_drivable(poses: Array, where: str) -> Iterator[Finding]:
    """Speed, acceleration, jerk, curvature and tilt of poses (n, 4, 4) at 10 Hz."""
    position = poses[:, :3, 3]
    tilt = np.arccos(np.clip(poses[:, 2, 2], -1.0, 1.0))
    yield _judge_largest("upright", where, tilt, STEEPEST_TILT, "rad between the rig's z axis and gravity")
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / STEP_SECONDS
    yield _judge_largest("speed", where, speed, FASTEST, "m/s; are positions in metres and times in microseconds?")
    level = position[:, :2]
    acceleration = np.linalg.norm(_differences(level, 2, _SLOW_STEPS), axis=1)
    yield _judge_largest(
        "acceleration", where, acceleration, STRONGEST_ACCELERATION, "m/s2 over 0.5 s; the motion jumps"
    )
    jerk = np.linalg.norm(_differences(level, 3, _FAST_STEPS), axis=1)
    yield _judge_largest("jerk", where, jerk, STRONGEST_JERK, "m/s3 over 0.2 s; the motion jumps")
    yield _judge_largest(
        "curvature of the way", where, _curvature(poses), TIGHTEST_CURVATURE, "rad of turn a metre; no vehicle can"
    )


def check_heading(poses: Array, where: str) -> Iterator[Finding]:
    """Whether a vehicle moves along its heading, forward, and turns to the side to which its way bends."""
    heading, way, signed = _headings_and_ways(poses)
    backward = signed < 0.0
    yield _check_backward(poses, where)
    if len(way) < _SLOW_STEPS:
        yield not_compared("along the heading", where, f"the vehicle drives less than {_CHORD:g} m")
        yield not_compared("turns with its way", where, f"the vehicle drives less than {_CHORD:g} m")
        return
    slip = np.abs(_wrapped(way - heading + np.pi * backward))
    yield judge(
        "along the heading",
        where,
        float(np.quantile(slip, 0.95)),
        LARGEST_SLIP,
        "rad between heading and way, over 95 % of it; are rotations those of rig to anchor, x y z w, with x ahead?",
    )
    yield _check_turns(heading, way + np.pi * backward, where)


def check_repeated_poses(motion: EgoMotion, where: str) -> Finding:
    """Whether positions stand still, to the last bit, while the velocity column says that the vehicle moves."""
    speed = np.linalg.norm(motion.velocity, axis=1)
    if speed.max() <= _STANDS:
        return not_compared("repeated poses", where, f"the vehicle never moves by more than {_STANDS:g} m/s")
    still = (np.diff(motion.trajectory.positions, axis=0) == 0.0).all(axis=1)
    moves = speed > _STANDS
    repeated = np.flatnonzero(still & moves[1:] & moves[:-1])
    at = f", first in row {repeated[0] + 1}" if len(repeated) else ""
    return judge("repeated poses", where, float(len(repeated)), 0.0, f"rows repeat the pose before them{at}")


def _check_backward(poses: Array, where: str) -> Finding:
    step = np.diff(poses[:, :3, 3], axis=0)
    along = np.einsum("ni,ni->n", step, poses[:-1, :3, 0])
    # A stretch counts as a whole, so that noise of a vehicle that stands does not add up.
    stretches = np.split(along, np.flatnonzero(np.diff(np.sign(along))) + 1)
    way = sum(max(0.0, -float(part.sum()) - _BACKWARD_NOISE) for part in stretches)
    fastest = float(max(0.0, -_smoothed(along).min() / STEP_SECONDS))
    if way == 0.0:
        return judge("drives forward", where, 0.0, LONGEST_BACKWARD, "m driven backward")
    if fastest > FASTEST_BACKWARD:
        advice = "m/s backward; are the poses reversed in time, or the rig turned about?"
        return judge("drives forward", where, fastest, FASTEST_BACKWARD, advice)
    if way > LONGEST_BACKWARD:
        advice = "m driven backward; are the poses reversed in time, or the rig turned about?"
        return judge("drives forward", where, way, LONGEST_BACKWARD, advice)
    why = f"{way:.1f} m are driven backward, as vehicles sometimes do; only images can tell whether this one did"
    return Finding("drives forward", where, Verdict.NOT_COMPARED, why, way, LONGEST_BACKWARD)


def _check_turns(heading: Array, way: Array, where: str) -> Finding:
    """Turns of the way for one of the heading: 1 for a vehicle, -1 where left and right are exchanged in one."""
    heading, way = (np.unwrap(values) - np.unwrap(values).mean() for values in (heading, way))
    if max(heading.std(), way.std()) < _LEAST_TURN:
        return not_compared("turns with its way", where, "the vehicle drives straight on, which has no left and right")
    covariance = np.cov(heading, way)
    axis = np.linalg.eigh(covariance)[1][:, -1]
    ratio = float(axis[1] / axis[0]) if axis[0] != 0.0 else np.inf
    detail = (
        f"off 1, by relative error: the way turns by {ratio:.2f} rad for each of the heading; is y to the left, are "
        "angles in radians, and rotations not transposed?"
    )
    return judge("turns with its way", where, float(abs(ratio - 1.0)), TURN_ERROR, detail)


def _headings_and_ways(poses: Array) -> tuple[Array, Array, Array]:
    """Heading and direction of the way (rad), and metres ahead (negative backward), of stretches of `_CHORD` metres."""
    level, yaw = poses[:, :2, 3], np.unwrap(yaw_of(poses))
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(level, axis=0), axis=1))])
    start = np.arange(len(poses))
    end = np.searchsorted(driven, driven + _CHORD)
    start, end = start[end < len(poses)], end[end < len(poses)]
    chord = level[end] - level[start]
    length = np.linalg.norm(chord, axis=1)
    long = length > 0.75 * (driven[end] - driven[start])  # not where a turn back or noise took up the way
    chord, heading = chord[long], 0.5 * (yaw[start[long]] + yaw[end[long]])
    ahead = chord[:, 0] * np.cos(heading) + chord[:, 1] * np.sin(heading)
    return heading, np.arctan2(chord[:, 1], chord[:, 0]), ahead


def _curvature(poses: Array) -> Array:
    turn = np.abs(_wrapped(yaw_of(poses)[_SLOW_STEPS:] - yaw_of(poses)[:-_SLOW_STEPS]))
    step = np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1)
    length = np.convolve(step, np.ones(_SLOW_STEPS), "valid")
    return np.maximum(turn - _HEADING_NOISE, 0.0) / np.maximum(length, 0.1)


def _differences(values: Array, order: int, steps: int) -> Array:
    """Differences (m, k) of values (n, k) on the grid, of an order, over so many steps each, per second."""
    for _ in range(order):
        values = (values[steps:] - values[:-steps]) / (steps * STEP_SECONDS)
    return values


def _smoothed(values: Array) -> Array:
    return np.convolve(values, np.full(_SLOW_STEPS, 1.0 / _SLOW_STEPS), "valid")


def _wrapped(angle: Array) -> NDArray[np.float64]:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def _judge_largest(check: str, where: str, values: Array, limit: float, detail: str) -> Finding:
    """Judge the largest of values along the grid; tells where it is."""
    place = int(np.argmax(values))
    return judge(check, where, float(values[place]), limit, f"{detail} (pose {place} at 10 Hz)")
