"""The acceleration-curvature action space of a unicycle, in which the policy plans.

An action is (acceleration, curvature) for one step of 0.1 s, normalised to zero mean and unit spread. Equations and
constants: docs/formats/alpamayo.md. Trajectories are in the rig frame at t0 (x forward, y left), where the vehicle
stands at the origin with heading 0.

Everything here is float64 and takes leading batch dimensions `...`. In float64 the ridge terms keep every normal matrix
positive definite, so the reference's retries with a larger ridge are not needed.
"""

from functools import lru_cache

import numpy as np

from olt_generator.poses import Array, planar_pose, yaw_of
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS
from olt_toolkit.rigs.names import ContractName

# Of the released checkpoint; they differ from the defaults of its classes. Acceleration in m/s^2, curvature in 1/m.
ACTION_MEAN: Array = np.array([0.02902694707164455, 0.0002692167976330542])
ACTION_STD: Array = np.array([0.6810426736454882, 0.026148280660833106])

ACTION_LIMIT = 10.0
"""Normalised actions beyond it cannot be told in tokens (docs/formats/alpamayo.md), in either direction."""

CURVATURE_BOUND = 0.33
SLOWEST_CURVE = 0.6
"""1/m and m/s: Alpamayo 2 cuts curvatures off at the one, and takes 0 for those of steps slower than the other."""

ROUND_TRIP_TOLERANCE = 0.3
"""Mean distance in metres from which on a future counts as one that the action space cannot express."""

Weights = tuple[float, float]
"""Of a regularised least-squares fit: that of its difference penalty, and its ridge."""

HEADING_FIT: Weights = (1e-6, 1e-8)
SPEED_FIT: Weights = (1e-6, 1e-4)
ACCELERATION_FIT: Weights = (1e-4, 1e-4)
CURVATURE_FIT: Weights = (1e-4, 1e-4)


def normalise_actions(acceleration: Array, curvature: Array) -> Array:
    """Actions (..., 2) from acceleration (...) in m/s^2 and curvature (...) in 1/m."""
    return (np.stack([acceleration, curvature], axis=-1) - ACTION_MEAN) / ACTION_STD


def physical_actions(actions: Array) -> tuple[Array, Array]:
    """Acceleration (...) in m/s^2 and curvature (...) in 1/m of normalised actions (..., 2)."""
    physical = actions * ACTION_STD + ACTION_MEAN
    return physical[..., 0], physical[..., 1]


def actions_to_trajectory(actions: Array, initial_speed: Array | float) -> tuple[Array, Array]:
    """Roll normalised actions (..., n, 2) out from a speed (...) in m/s at t0.

    Returns:
        xyz (..., n, 3) in metres and rotation (..., n, 3, 3) about z, at the ends of the steps.
    """
    dt = STEP_SECONDS
    acceleration, curvature = physical_actions(np.asarray(actions, dtype=np.float64))
    speed = _accumulate(initial_speed, acceleration * dt)
    heading = _accumulate(0.0, curvature * _step_lengths(speed[..., :-1], acceleration))
    velocity = speed[..., None] * _direction(heading)
    xy = np.cumsum(0.5 * dt * (velocity[..., :-1, :] + velocity[..., 1:, :]), axis=-2)
    xyz = np.concatenate([xy, np.zeros_like(xy[..., :1])], axis=-1)
    return xyz, planar_pose(0.0, 0.0, heading[..., 1:])[..., :3, :3]


def trajectory_to_actions(
    history_xyz: Array,
    history_rotation: Array,
    future_xyz: Array,
    future_rotation: Array,
    policy: ContractName = ContractName.ALPAMAYO_R1,
) -> Array:
    """Fit the normalised actions (..., 64, 2) that drive the given future, as the code of a policy makes its labels.

    Positions are (..., 16, 3) and (..., 64, 3) metres, rotations (..., 16, 3, 3) and (..., 64, 3, 3); the last pose of
    the history is the origin.
    """
    dt = STEP_SECONDS
    initial_speed = estimate_initial_speed(history_xyz, history_rotation)
    heading = _prepend(0.0, np.unwrap(yaw_of(future_rotation)) @ _smoothing_matrix(3, 1, HEADING_FIT).T)
    path = np.concatenate([history_xyz[..., -1:, :2], future_xyz[..., :2]], axis=-2)
    speed = _prepend(initial_speed, _fit_speeds(path, heading, initial_speed))
    acceleration = np.diff(speed) / dt @ _smoothing_matrix(2, 0, ACCELERATION_FIT).T
    curvature = _fit_curvatures(np.diff(heading), _step_lengths(speed[..., :-1], acceleration))
    if policy is ContractName.ALPAMAYO_2:
        slow = np.minimum(np.abs(speed[..., :-1]), np.abs(speed[..., 1:])) < SLOWEST_CURVE
        curvature = np.where(slow, 0.0, np.clip(curvature, -CURVATURE_BOUND, CURVATURE_BOUND))
    return normalise_actions(acceleration, curvature)


def round_trip_errors(
    history_xyz: Array,
    history_rotation: Array,
    future_xyz: Array,
    future_rotation: Array,
    policy: ContractName = ContractName.ALPAMAYO_R1,
) -> Array:
    """How far a future is from the one that its own actions drive: mean distance in the plane (...) in metres.

    Futures are fitted by actions, those are cut off at `ACTION_LIMIT` as tokens are, and driven from the speed that the
    history gives. Arguments as of `trajectory_to_actions`. What is lost is what a unicycle cannot do (motion across the
    heading), what the fit smooths away, and what tokens cut off; not their rounding, which is below 0.03 m.
    """
    actions = trajectory_to_actions(history_xyz, history_rotation, future_xyz, future_rotation, policy)
    speed = estimate_initial_speed(history_xyz, history_rotation)
    driven, _ = actions_to_trajectory(np.clip(actions, -ACTION_LIMIT, ACTION_LIMIT), speed)
    return np.asarray(np.linalg.norm(driven[..., :2] - future_xyz[..., :2], axis=-1).mean(axis=-1), dtype=np.float64)


def estimate_initial_speed(history_xyz: Array, history_rotation: Array) -> Array:
    """Speed (...) in m/s at t0, fitted to a history of positions (..., n, 3) and rotations (..., n, 3, 3)."""
    return _fit_speeds(history_xyz[..., :2], yaw_of(history_rotation))[..., -1]


def _fit_speeds(path: Array, heading: Array, first: Array | None = None) -> Array:
    """Speeds whose trapezoidal rule along the headings gives the path.

    With u_t the direction at step t, minimises sum |v_t u_t + v_{t+1} u_{t+1} - 2 dp_t / dt|^2
    + w |D3 v|^2 + ridge |v|^2. Only neighbours meet in the first sum, so its normal matrix is tridiagonal, with
    u_t . u_{t+1} beside the diagonal.

    Args:
        path: (..., n, 2) positions.
        heading: (..., n) radians.
        first: (...) the first speed where it is known; then only the other n - 1 are fitted and returned.
    """
    smoothness, ridge = SPEED_FIT
    direction = _direction(heading)
    n = heading.shape[-1]
    beside = np.sum(direction[..., :-1, :] * direction[..., 1:, :], axis=-1)
    normal = np.zeros((*heading.shape, n))
    index = np.arange(n)
    normal[..., index, index] = np.where((index == 0) | (index == n - 1), 1.0, 2.0)
    normal[..., index[:-1], index[1:]] = normal[..., index[1:], index[:-1]] = beside
    normal += _penalty(n, 3, smoothness / STEP_SECONDS**6)

    wanted = 2.0 / STEP_SECONDS * np.diff(path, axis=-2)
    right = np.zeros(heading.shape)
    right[..., :-1] += np.sum(direction[..., :-1, :] * wanted, axis=-1)
    right[..., 1:] += np.sum(direction[..., 1:, :] * wanted, axis=-1)

    if first is not None:
        right = right[..., 1:] - normal[..., 1:, 0] * np.asarray(first)[..., None]
        normal = normal[..., 1:, 1:]
    normal = normal + ridge * np.eye(normal.shape[-1])
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], dtype=np.float64)


def _fit_curvatures(turn: Array, length: Array) -> Array:
    """Curvatures (..., n) whose product with the step lengths gives the turns; 0 where nothing moves."""
    n, (smoothness, ridge) = turn.shape[-1], CURVATURE_FIT
    normal = _penalty(n, 2, smoothness / STEP_SECONDS**4) + (length**2 + ridge)[..., None] * np.eye(n)
    return np.asarray(np.linalg.solve(normal, (length * turn)[..., None])[..., 0], dtype=np.float64)


@lru_cache(maxsize=8)
def _smoothing_matrix(order: int, known: int, fit: Weights) -> Array:
    """Matrix (64, 64) from a series to the smoothed one, by differences of the given order.

    `known` values before the series are 0, as the heading at t0 is; they add nothing to the right side.
    """
    penalty = _penalty(FUTURE_STEPS + known, order, fit[0] / STEP_SECONDS ** (2 * order))[known:, known:]
    return np.asarray(np.linalg.inv((1.0 + fit[1]) * np.eye(FUTURE_STEPS) + penalty), dtype=np.float64)


@lru_cache(maxsize=32)
def _penalty(n: int, order: int, weight: float) -> Array:
    """weight * D^T D (n, n), with D the differences of the given order."""
    difference = np.diff(np.eye(n), n=order, axis=0)
    return np.asarray(weight * difference.T @ difference, dtype=np.float64)


def _step_lengths(speed: Array, acceleration: Array) -> Array:
    """Path length in metres of each step, from the speed at its start and its constant acceleration."""
    return speed * STEP_SECONDS + 0.5 * acceleration * STEP_SECONDS**2


def _accumulate(first: Array | float, increments: Array) -> Array:
    """The value (..., n + 1) at the start and after each of the increments (..., n)."""
    return np.cumsum(_prepend(first, increments), axis=-1)


def _prepend(first: Array | float, values: Array) -> Array:
    first = np.broadcast_to(np.asarray(first, dtype=np.float64), values.shape[:-1])
    return np.concatenate([first[..., None], values], axis=-1)


def _direction(heading: Array) -> Array:
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)
