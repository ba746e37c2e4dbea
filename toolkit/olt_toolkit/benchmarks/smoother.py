"""Trajectory smoother against the exact solution of the same linear-Gaussian problem."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import numpy as np
from scipy.sparse import csc_matrix, lil_matrix
from scipy.sparse.linalg import spsolve

from olt_generator.poses import Array
from olt_generator.seeds import make_generator
from olt_generator.smoother import Floats, MotionModel, SmootherSettings, filter_forward, smooth, smooth_backward
from olt_toolkit.benchmark import Benchmark, Setting

POSES = 400
NOISE_METRES = 0.05
LAGS = (2, 5, 10, 20)
MODEL = SmootherSettings(position_sigma=NOISE_METRES).position_model


def make_drive() -> tuple[Array, Array]:
    """Times (n,) about 10 Hz with jitter and gaps, and noisy positions (n, 3) of a drive that brakes and turns."""
    random = make_generator("smoother benchmark")
    steps = random.uniform(0.07, 0.13, POSES)
    steps[:: POSES // 8] += 0.4
    times = np.cumsum(steps)
    heading, speed = 0.8 * np.sin(0.15 * times), 9.0 + 4.0 * np.sin(0.25 * times)
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading), np.full(POSES, 0.01)], axis=-1)
    positions = np.cumsum(velocity * steps[:, None], axis=0)
    return times - times[0], positions - positions[0] + NOISE_METRES * random.standard_normal((POSES, 3))


def batch_problem(times: Array, measurements: Array, model: MotionModel) -> tuple[csc_matrix, Array]:
    """Whitened equations A x = b whose least-squares solution (n * states, axes) is the most probable motion.

    One block of rows for the start, one row for every later measurement, one block for every step of the motion.
    """
    n, states = len(times), model.states
    equations = states + (states + 1) * (n - 1)
    A = lil_matrix((equations, n * states))
    b = np.zeros((equations, measurements.shape[1]))
    A[:states, :states] = np.diag(1.0 / np.sqrt(np.diag(model.initial_covariance())))
    b[0] = measurements[0] / model.measurement_sigma
    seconds = np.diff(times, prepend=times[0])
    transitions, noise = model.transition(seconds), model.process_noise(seconds)
    row = states
    for k in range(1, n):
        before, here = slice((k - 1) * states, k * states), slice(k * states, (k + 1) * states)
        whiten = np.linalg.inv(np.linalg.cholesky(noise[k]))
        A[row : row + states, before] = -whiten @ transitions[k]
        A[row : row + states, here] = whiten
        A[row + states, k * states] = 1.0 / model.measurement_sigma
        b[row + states] = measurements[k] / model.measurement_sigma
        row += states + 1
    return csc_matrix(A), b


@lru_cache(maxsize=1)
def exact_positions() -> Array:
    """Positions (n, 3) by orthogonal decomposition of the dense batch problem."""
    A, b = batch_problem(*make_drive(), MODEL)
    Q, R = np.linalg.qr(np.asarray(A.toarray(), dtype=np.float64))
    solution = np.asarray(np.linalg.solve(R, Q.T @ b), dtype=np.float64)
    return solution[:: MODEL.states]


def filter_only() -> Floats:
    """What is known of each position from the past alone."""
    return filter_forward(*make_drive(), MODEL).filtered[:, 0]


def fixed_lag(lag: int) -> Floats:
    """Positions that use the past and the next `lag` measurements."""
    forward = filter_forward(*make_drive(), MODEL)
    return np.array([smooth_backward(forward.part(k, k + lag + 1))[0, 0] for k in range(POSES)])


def full(kind: type[np.floating]) -> Floats:
    """Positions that use all measurements, computed in the given floating-point type."""
    times, measurements = make_drive()
    return smooth(times, measurements.astype(kind), MODEL)[:, 0]


def batch_sparse() -> Array:
    """The batch problem by sparse normal equations."""
    A, b = batch_problem(*make_drive(), MODEL)
    return np.asarray(spsolve((A.T @ A).tocsc(), A.T @ b), dtype=np.float64)[:: MODEL.states]


def measure_error(positions: Floats) -> float:
    """Root mean square distance in metres from the exact solution."""
    return float(np.sqrt(np.mean(np.sum((positions - exact_positions()) ** 2, axis=1))))


def _settings() -> Sequence[Setting]:
    calls: dict[str, Callable[[], Floats]] = {
        "forward filter only": filter_only,
        **{f"fixed-lag RTS, {lag} poses": partial(fixed_lag, lag) for lag in LAGS},
        "full RTS": partial(full, np.float64),
        "full RTS, float32": partial(full, np.float32),
        "batch, sparse normal equations": batch_sparse,
    }
    return [Setting(name, partial(_prepared, call), name == "full RTS") for name, call in calls.items()]


def _prepared(call: Callable[[], Floats]) -> Callable[[], Floats]:
    return call


BENCHMARK = Benchmark(
    name="smoother",
    title=f"Smoothing {POSES} noisy positions at irregular times",
    error_name="rms position difference",
    error_unit="m",
    reference="the dense batch least-squares solution of the same model and measurements",
    settings=_settings,
    measure_error=measure_error,
)
