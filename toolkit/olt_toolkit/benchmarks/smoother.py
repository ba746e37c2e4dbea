"""Trajectory smoother against the exact solution of the same linear-Gaussian problem."""

from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, lil_matrix
from scipy.sparse.linalg import spsolve

from olt_generator.motion.car_motion import BodyMotion, CarMotion
from olt_generator.motion.iterated_smoother import MeasuredPoses, linear_system
from olt_generator.motion.kalman import LinearSystem, filter_forward, smooth_states, smoothing_gains
from olt_generator.poses import Array, planar_pose
from olt_generator.seeds import make_generator
from olt_generator.twists import exponential
from olt_toolkit.bench.benchmark import Benchmark, list_settings

Floats = NDArray[np.floating]

POSES = 150
SIGMAS = np.array([0.05, 0.05, 0.05, 0.002, 0.002, 0.002])
LAGS = (2, 5, 10, 20)
CAR = CarMotion(
    jerk_density=np.array([0.5]),
    angular_acceleration_density=np.array([0.05]),
    slip_sigma=0.1,
    slip_seconds=1.0,
    initial_sigmas=np.array([10.0, 10.0, 10.0, 0.3, 0.3, 0.3, 100.0, 0.1, 0.1, 1.0, 1.0, 1.0, 5.0]),
)


@lru_cache(maxsize=1)
def make_system() -> LinearSystem:
    """The smoother's problem about a drive that brakes and turns, at about 10 Hz with jitter, gaps and noise."""
    random = make_generator("smoother benchmark")
    steps = random.uniform(0.07, 0.13, POSES)
    steps[:: POSES // 4] += 0.4
    times = np.cumsum(steps)
    heading, speed = 0.8 * np.sin(0.15 * times), 9.0 + 4.0 * np.sin(0.25 * times)
    turn_rate, acceleration = 0.12 * np.cos(0.15 * times), np.cos(0.25 * times)
    x, y = np.cumsum(speed * np.cos(heading) * steps), np.cumsum(speed * np.sin(heading) * steps)
    velocity, turning = np.zeros((2, POSES, 1, 3))
    velocity[:, 0, 0], turning[:, 0, 2] = speed, turn_rate
    poses = planar_pose(x - x[0], y - y[0], heading)[:, None]
    motion = BodyMotion(poses, velocity, turning, acceleration[:, None])
    noisy = motion.poses @ exponential(SIGMAS * random.standard_normal((POSES, 1, 6)))
    measured = MeasuredPoses(np.array([POSES]), np.diff(times)[:, None], noisy, SIGMAS[None])
    return linear_system(measured, motion, np.zeros((POSES, 1), dtype=np.bool_), CAR, convex=False)


def batch_problem(system: LinearSystem) -> tuple[csc_matrix, Array]:
    """Whitened equations A x = b whose least-squares solution (n * states,) is the most probable sequence of states.

    One block of rows for the start, one for every measurement, one for every step.
    """
    n, (_, states, _) = len(system.measurements), system.initial_state.shape
    measured = system.measurements.shape[2]
    A = lil_matrix((n * (states + measured), n * states))
    b = np.zeros(n * (states + measured))
    whiten = np.linalg.inv(np.linalg.cholesky(system.initial_covariance[0]))
    A[:states, :states] = whiten
    b[:states] = whiten @ system.initial_state[0, :, 0]
    row = states
    for k in range(n):
        here = slice(k * states, (k + 1) * states)
        deviation = np.sqrt(system.measurement_noise[k, 0])
        A[row : row + measured, here] = np.eye(measured, states) / deviation[:, None]
        b[row : row + measured] = system.measurements[k, 0, :, 0] / deviation
        row += measured
        if k + 1 < n:
            whiten = np.linalg.inv(np.linalg.cholesky(system.process_noise[k, 0]))
            A[row : row + states, here] = -whiten @ system.transitions[k, 0]
            A[row : row + states, (k + 1) * states : (k + 2) * states] = whiten
            b[row : row + states] = whiten @ system.offsets[k, 0, :, 0]
            row += states
    return csc_matrix(A), b


@lru_cache(maxsize=1)
def exact_states() -> Array:
    """States (n, 13) by orthogonal decomposition of the dense batch problem."""
    A, b = batch_problem(make_system())
    Q, R = np.linalg.qr(np.asarray(A.toarray(), dtype=np.float64))
    return np.asarray(np.linalg.solve(R, Q.T @ b), dtype=np.float64).reshape(POSES, -1)


def filter_only() -> Floats:
    """What is known of each state (n, states) from the past alone."""
    return filter_forward(make_system()).filtered[:, 0, :, 0]


def fixed_lag(lag: int) -> Floats:
    """States (n, states) that use the past and the next `lag` measurements."""
    system = make_system()
    forward = filter_forward(system)
    gains = smoothing_gains(system, forward)
    states = forward.filtered.copy()
    for k in range(POSES):
        last = min(k + lag, POSES - 1)
        state = forward.filtered[last]
        for j in range(last - 1, k - 1, -1):
            state = forward.filtered[j] + gains[j] @ (state - forward.predicted[j + 1])
        states[k] = state
    return states[:, 0, :, 0]


def full(kind: type[np.floating]) -> Floats:
    """States (n, states) that use all measurements, computed in the given floating-point type."""
    system = make_system()
    arrays = {name: value.astype(kind) for name, value in vars(system).items() if name != "lengths"}
    system = LinearSystem(lengths=system.lengths, **arrays)
    forward = filter_forward(system)
    return smooth_states(system, forward, smoothing_gains(system, forward))[:, 0, :, 0]


def batch_sparse() -> Array:
    """States (n, states) of the batch problem by sparse normal equations."""
    A, b = batch_problem(make_system())
    return np.asarray(spsolve((A.T @ A).tocsc(), A.T @ b), dtype=np.float64).reshape(POSES, -1)


def measure_error(states: Floats) -> float:
    """Root mean square distance in metres of the positions of states (n, states) from the exact solution."""
    return float(np.sqrt(np.mean(np.sum((states[:, :3] - exact_states()[:, :3]) ** 2, axis=1))))


BENCHMARK = Benchmark(
    title=f"Smoothing {POSES} noisy poses at irregular times, one linearisation",
    error_name="rms position difference",
    error_unit="m",
    reference="the dense batch least-squares solution of the same model and measurements",
    settings=lambda: list_settings(
        make_system,
        {
            "forward filter only": filter_only,
            **{f"fixed-lag RTS, {lag} poses": partial(fixed_lag, lag) for lag in LAGS},
            "full RTS": partial(full, np.float64),
            "full RTS, float32": partial(full, np.float32),
            "batch, sparse normal equations": batch_sparse,
        },
        default="full RTS",
    ),
    measure_error=measure_error,
)
