"""Filter and smoother of linear systems."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.motion.car_motion import BodyMotion, CarMotion, linearise
from olt_generator.motion.kalman import (
    LinearSystem,
    filter_forward,
    integrator_noise,
    integrator_transitions,
    smooth_covariances,
    smooth_states,
    smoothing_gains,
)


def random_system(seed, lengths, states=3, measured=2, columns=2):
    random = np.random.default_rng(seed)
    n, b = max(lengths), len(lengths)
    roots = random.standard_normal((n - 1, b, states, states))
    noise = roots @ np.swapaxes(roots, -1, -2) + 0.1 * np.eye(states)
    return LinearSystem(
        lengths=np.array(lengths),
        transitions=0.6 * random.standard_normal((n - 1, b, states, states)),
        offsets=random.standard_normal((n - 1, b, states, columns)),
        process_noise=noise,
        initial_state=random.standard_normal((b, states, columns)),
        initial_covariance=np.tile(np.eye(states), (b, 1, 1)),
        measurements=random.standard_normal((n, b, measured, columns)),
        measurement_noise=random.uniform(0.1, 2.0, (n, b, measured)),
    )


def solve_batch(system, index):
    """All states (n, s, c) of one sequence and their covariances (n, s, s) from one dense least-squares problem."""
    n, s = system.lengths[index], system.initial_state.shape[1]
    m, c = system.measurements.shape[2:]
    rows, right = [], []

    def add(matrix, covariance, value):
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        rows.append(whiten @ matrix)
        right.append(whiten @ value)

    blocks = np.eye(n * s).reshape(n, s, n * s)
    add(blocks[0], system.initial_covariance[index], system.initial_state[index])
    for k in range(n):
        add(blocks[k][:m], np.diag(system.measurement_noise[k, index]), system.measurements[k, index])
        if k + 1 < n:
            step = blocks[k + 1] - system.transitions[k, index] @ blocks[k]
            add(step, system.process_noise[k, index], system.offsets[k, index])
    A, b = np.vstack(rows), np.vstack(right)
    covariance = np.linalg.inv(A.T @ A).reshape(n, s, n, s)
    return np.linalg.lstsq(A, b)[0].reshape(n, s, c), covariance[np.arange(n), :, np.arange(n)]


def smooth(system):
    forward = filter_forward(system)
    gains = smoothing_gains(system, forward)
    return smooth_states(system, forward, gains), smooth_covariances(system, forward, gains)


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.lists(st.integers(1, 9), min_size=1, max_size=4))
def test_equals_the_batch_solution(seed, lengths):
    system = random_system(seed, sorted(lengths, reverse=True))
    states, covariances = smooth(system)
    for index, length in enumerate(system.lengths):
        expected_states, expected_covariances = solve_batch(system, index)
        np.testing.assert_allclose(states[:length, index], expected_states, atol=1e-9)
        np.testing.assert_allclose(covariances[:length, index], expected_covariances, atol=1e-9)


def test_the_last_filtered_state_is_the_smoothed_one():
    system = random_system(0, [12])
    np.testing.assert_array_equal(filter_forward(system).filtered[-1], smooth(system)[0][-1])


def test_integrated_noise_adds_up_over_steps():
    short, long = np.array(0.1), np.array(0.2)
    F, Q = integrator_transitions(short, 3), integrator_noise(short, 3)
    np.testing.assert_allclose(integrator_transitions(long, 3), F @ F)
    np.testing.assert_allclose(integrator_noise(long, 3), F @ Q @ F.T + Q)


def test_the_noise_of_a_car_adds_up_over_steps():
    car = CarMotion(np.array([0.7]), np.array([0.1]), 0.3, 0.8, np.ones(13))
    still = np.zeros((3, 1, 3))
    motion = BodyMotion(np.tile(np.eye(4), (3, 1, 1, 1)), still, still, still[..., 0])
    F, _ = linearise(motion, np.full((2, 1), 0.1), car)
    Q, doubled = car.process_noise(np.full((1, 1), 0.1))[0, 0], car.process_noise(np.full((1, 1), 0.2))[0, 0]
    np.testing.assert_allclose(doubled, F[0, 0] @ Q @ F[0, 0].T + Q, atol=1e-12)
