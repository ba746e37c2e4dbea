"""Smoothing of measured trajectories: forward Kalman filter and backward Rauch-Tung-Striebel pass (paper, section 3.2).

`smooth_trajectory` takes out jitter and outliers, bridges gaps, holds standstills, and says how certain each pose is.
The motion model is `car_motion`, the method `iterated_smoother`; noise levels that are not given are estimated from the
trajectory itself (`noise_levels`). Long trajectories are cut into windows that overlap by far more than the smoother's
memory, which is a few seconds, and are smoothed side by side as other trajectories are.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.motion.car_motion import POSE, STATES, CarMotion
from olt_generator.motion.iterated_smoother import STANDSTILL_SPEED, MeasuredPoses, smooth_poses
from olt_generator.motion.noise_levels import POSITION_GRID, ROTATION_GRID, estimate_levels
from olt_generator.motion.outlier_rejection import replace_outliers
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_generator.twists import vector_from_rotation

# Poses of one window and of its overlap with each neighbour.
WINDOW, OVERLAP = 2000, 400
# Noise levels of a trajectory are judged by so many stretches of so many poses at most.
LEVEL_STRETCHES, LEVEL_POSES = 4, 500
# Poses that are smoothed side by side: more gain little and need 14 kB of memory each.
BATCH_POSES = 20_000

# Spread of the state at the first pose: about the measured pose, and about rest.
_INITIAL_POSE = (10.0, 10.0, 10.0, 0.3, 0.3, 0.3)
_INITIAL_SPEED, _INITIAL_TURN_RATE, _INITIAL_ACCELERATION = 100.0, 1.0, 5.0


@dataclass(frozen=True)
class SmootherSettings:
    """Noise of the measured poses and of the motion itself; None where it is to be estimated.

    Attributes:
        position_sigma: standard deviation of a measured position, m, per axis.
        rotation_sigma: standard deviation of a measured rotation, rad, per axis.
        jerk_density: root spectral density of the forward jerk, m/s3 per root Hz.
        angular_acceleration_density: root spectral density of the angular acceleration, rad/s2 per root Hz.
        least_position_sigma, least_rotation_sigma: what estimated noise counts as at least, since recovered poses
            also err in ways that do not look like jitter.
        slip_sigma: standard deviation of the velocities sideways and up, m/s.
        slip_seconds: time in which they return to 0.
    """

    position_sigma: float | None = None
    rotation_sigma: float | None = None
    jerk_density: float | None = None
    angular_acceleration_density: float | None = None
    least_position_sigma: float = 0.05
    least_rotation_sigma: float = 3e-4
    slip_sigma: float = 0.1
    slip_seconds: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            lowest_is_fine = name.startswith("least")
            if value is not None and not (0.0 < value < np.inf or (lowest_is_fine and value == 0.0)):
                raise InputError(f"smoother: {name} is {value}; give a positive number")


# Visual odometry hardly jitters: it errs in speed, over tenths of a second, which looks like acceleration. Noise levels
# cannot be told from such a trajectory. These make the smoother average speed over about half a second: with more of it
# true braking is smoothed away, with less the odometry's errors stay, and either way accelerations get worse.
ODOMETRY_SETTINGS = SmootherSettings(position_sigma=0.1, rotation_sigma=4e-5, jerk_density=0.3)


@dataclass(frozen=True)
class SmoothedMotion:
    """A smoothed trajectory, its derivatives, and how certain they are.

    Attributes:
        trajectory: smoothed poses at the times of the measured ones.
        velocity: (n, 3) m/s in world axes.
        acceleration: (n, 3) m/s2 in world axes.
        curvature: (n,) 1/m, turn rate about the rig's z axis over forward speed; positive to the left, 0 at standstill.
        covariance: (n, 6, 6) of the error of each pose in its own axes, translation (m) before rotation (rad): the
            true pose is about `pose @ exponential(error)` (`twists`).
        rate_covariance: (n, 7, 7) of the errors of velocity (m/s) and turn rate (rad/s) in body axes and of the forward
            acceleration (m/s2).
        outliers: (n,) measured poses that were not believed.
        standing: (n,) whether the vehicle stands.
        position_sigma, rotation_sigma: the measurement noise that was given or found, m and rad.
    """

    trajectory: Trajectory
    velocity: Array
    acceleration: Array
    curvature: Array
    covariance: Array
    rate_covariance: Array
    outliers: NDArray[np.bool_]
    standing: NDArray[np.bool_]
    position_sigma: float
    rotation_sigma: float


@dataclass(frozen=True)
class _Window:
    """Poses start to stop - 1 of a trajectory; the outer ones of a window with margins belong to its neighbours."""

    trajectory: int
    start: int
    stop: int
    margins: tuple[int, int] = (0, 0)

    def __len__(self) -> int:
        return self.stop - self.start


_Part = tuple[NDArray[Any], ...]
"""What is kept of a window: poses (k, 4, 4), rates (k, 7), covariances (k, 13, 13), outliers (k,) and standing (k,)."""


class _Levels(NamedTuple):
    """Noise levels of a trajectory; see `SmootherSettings`."""

    position: float
    rotation: float
    jerk: float
    angular_acceleration: float


def smooth_trajectory(trajectory: Trajectory, settings: SmootherSettings | None = None) -> SmoothedMotion:
    """Remove jitter from a trajectory, using all of it for every pose.

    Args:
        trajectory: measured poses of a rig whose origin is on the rear axle and whose x axis points ahead; turns
            between two poses must be below half a turn, since longer ones cannot be told from their complements.
        settings: noise levels; None to estimate them all.
    """
    return smooth_trajectories([trajectory], settings)[0]


def smooth_trajectories(
    trajectories: Sequence[Trajectory], settings: SmootherSettings | None = None
) -> list[SmoothedMotion]:
    """What `smooth_trajectory` gives for each of the trajectories, to the last bit, in less time."""
    settings = settings or SmootherSettings()
    starts = [replace_outliers(trajectory) for trajectory in trajectories]
    levels = _find_levels(trajectories, starts, settings)
    windows = [_cut(index, len(trajectory)) for index, trajectory in enumerate(trajectories)]
    parts: dict[_Window, _Part] = {}
    for batch in _batches(chain.from_iterable(windows)):
        parts.update(_smooth_batch(batch, trajectories, starts, levels, settings))
    return [
        _join([parts[window] for window in own], trajectory, level)
        for own, trajectory, level in zip(windows, trajectories, levels, strict=True)
    ]


def _cut(trajectory: int, length: int) -> list[_Window]:
    """Windows of about equal size that, without their margins, follow upon each other."""
    count = max(1, round(length / WINDOW))
    edges = np.linspace(0, length, count + 1).round().astype(int).tolist()
    windows = []
    for first, last in pairwise(edges):
        start, stop = max(0, first - OVERLAP), min(length, last + OVERLAP)
        windows.append(_Window(trajectory, start, stop, (first - start, stop - last)))
    return windows


def _batches(windows: Iterable[_Window]) -> Iterator[list[_Window]]:
    """Windows by falling length, so many at a time as may be smoothed side by side."""
    waiting = sorted(windows, key=len, reverse=True)
    while waiting:
        count = max(1, BATCH_POSES // len(waiting[0]))
        yield waiting[:count]
        waiting = waiting[count:]


def _find_levels(
    trajectories: Sequence[Trajectory], starts: Sequence[Array], settings: SmootherSettings
) -> list[_Levels]:
    """Noise levels of each trajectory: medians over its stretches of what is not given."""
    stretches = []
    for index, trajectory in enumerate(trajectories):
        length = len(trajectory)
        count = min(LEVEL_STRETCHES, -(-length // LEVEL_POSES))
        firsts = np.linspace(0, max(0, length - LEVEL_POSES), count).round().astype(int).tolist()
        stretches.append([_Window(index, first, min(length, first + LEVEL_POSES)) for first in firsts])
    found: dict[_Window, Array] = {}
    for batch in _batches(chain.from_iterable(stretches)):
        found.update(zip(batch, _estimate_levels(batch, trajectories, starts, settings), strict=True))
    levels = []
    for own in stretches:
        position, rotation, jerk, turning = np.median([found[stretch] for stretch in own], axis=0).tolist()
        if settings.position_sigma is None:
            position = max(position, settings.least_position_sigma)
        if settings.rotation_sigma is None:
            rotation = max(rotation, settings.least_rotation_sigma)
        levels.append(_Levels(position, rotation, jerk, turning))
    return levels


def _estimate_levels(
    batch: Sequence[_Window], trajectories: Sequence[Trajectory], starts: Sequence[Array], settings: SmootherSettings
) -> Array:
    """Levels (b, 4) of stretches, in the order of `_Levels`."""
    lengths, seconds = np.array([len(stretch) for stretch in batch]), _time_steps(batch, trajectories)
    poses = _gather(batch, starts)
    grid = POSITION_GRID.where_known(settings.position_sigma, settings.jerk_density)
    position, jerk = estimate_levels(lengths, seconds, poses[..., :3, 3] - poses[0, :, :3, 3], grid)
    # Sums of the rotation vectors from pose to pose: a full turn is as good as none.
    turns = np.zeros((*poses.shape[:2], 3))
    rotations = poses[..., :3, :3]
    steps = vector_from_rotation(np.swapaxes(rotations[:-1], -1, -2) @ rotations[1:])
    np.cumsum(steps, axis=0, out=turns[1:])
    grid = ROTATION_GRID.where_known(settings.rotation_sigma, settings.angular_acceleration_density)
    rotation, turning = estimate_levels(lengths, seconds, turns, grid)
    return np.stack([position, rotation, jerk, turning], axis=-1)


def _smooth_batch(
    batch: Sequence[_Window],
    trajectories: Sequence[Trajectory],
    starts: Sequence[Array],
    levels: Sequence[_Levels],
    settings: SmootherSettings,
) -> dict[_Window, _Part]:
    measured = _gather(batch, [trajectory.T_world_rig for trajectory in trajectories])
    start = _gather(batch, starts)
    origins = start[0, :, :3, 3].copy()
    measured[..., :3, 3] -= origins
    start[..., :3, 3] -= origins
    position, rotation, jerk, turning = np.array([levels[window.trajectory] for window in batch]).T
    lengths = np.array([len(window) for window in batch])
    sigmas = np.stack([*3 * [position], *3 * [rotation]], axis=-1)
    poses = MeasuredPoses(lengths, _time_steps(batch, trajectories), measured, sigmas)
    rates = (_INITIAL_SPEED, settings.slip_sigma, settings.slip_sigma, *3 * [_INITIAL_TURN_RATE], _INITIAL_ACCELERATION)
    initial_sigmas = np.array([*_INITIAL_POSE, *rates])
    car = CarMotion(jerk, turning, settings.slip_sigma, settings.slip_seconds, initial_sigmas)
    motion, covariances, outliers, standing = smooth_poses(poses, start, car)
    motion.poses[..., :3, 3] += origins
    arrays = motion.poses, motion.rates(), covariances, outliers, standing
    kept = [slice(window.margins[0], len(window) - window.margins[1]) for window in batch]
    return {window: tuple(array[kept[k], k] for array in arrays) for k, window in enumerate(batch)}


def _join(parts: Sequence[_Part], trajectory: Trajectory, levels: _Levels) -> SmoothedMotion:
    poses, rates, covariances, outliers, standing = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    velocity, turn_rate = rates[:, :3], rates[:, 3:6]
    acceleration = np.cross(turn_rate, velocity)
    acceleration[:, 0] += rates[:, 6]
    R_world_rig, forward_speed = poses[:, :3, :3], velocity[:, 0]
    moving = np.abs(forward_speed) > STANDSTILL_SPEED
    return SmoothedMotion(
        trajectory=Trajectory(trajectory.timestamps_us, poses),
        velocity=np.matmul(R_world_rig, velocity[..., None])[..., 0],
        acceleration=np.matmul(R_world_rig, acceleration[..., None])[..., 0],
        curvature=np.where(moving, turn_rate[:, 2] / np.where(moving, forward_speed, 1.0), 0.0),
        covariance=covariances[:, POSE, POSE],
        rate_covariance=covariances[:, POSE.stop : STATES, POSE.stop : STATES],
        outliers=outliers,
        standing=standing,
        position_sigma=levels.position,
        rotation_sigma=levels.rotation,
    )


def _time_steps(batch: Sequence[_Window], trajectories: Sequence[Trajectory]) -> Array:
    """Seconds (n - 1, b) between the poses of each window; 1 behind its end."""
    seconds = np.ones((max(len(window) for window in batch) - 1, len(batch)))
    for column, window in enumerate(batch):
        steps = np.diff(trajectories[window.trajectory].times[window.start : window.stop])
        seconds[: len(steps), column] = steps
    return seconds


def _gather(batch: Sequence[_Window], arrays: Sequence[Array]) -> Array:
    """Windows of arrays side by side, (n, b, ...); each goes on with its last value behind its end."""
    longest = max(len(window) for window in batch)
    gathered = np.empty((longest, len(batch), *arrays[0].shape[1:]))
    for column, window in enumerate(batch):
        values = arrays[window.trajectory][window.start : window.stop]
        gathered[: len(values), column] = values
        gathered[len(values) :, column] = values[-1]
    return gathered
