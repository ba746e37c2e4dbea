"""Kalman filter and Rauch-Tung-Striebel smoother of linear systems, for many sequences at once.

The loop over time is vectorised over the sequences, which are sorted by falling length: at each time the first of
them, those that still run, take part. Each sequence's numbers depend on nothing but itself, to the last bit.

    x[k + 1] = F[k] x[k] + c[k] + w,  w ~ N(0, Q[k]);    z[k] = first entries of x[k] + e,  e ~ N(0, R[k])
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import factorial

from olt_generator.poses import Array


@dataclass(frozen=True)
class LinearSystem:
    """Sequences of n times at most; s states, of which the first m are measured, and c columns that share one noise.

    Attributes:
        lengths: (b,) times of each sequence, falling; what lies behind the end of a sequence is ignored.
        transitions: (n - 1, b, s, s).
        offsets: (n - 1, b, s, c).
        process_noise: (n - 1, b, s, s) positive definite covariances.
        initial_state: (b, s, c) expected at the first time, before its measurement.
        initial_covariance: (b, s, s).
        measurements: (n, b, m, c).
        measurement_noise: (n, b, m) variances.
    """

    lengths: NDArray[np.int64]
    transitions: Array
    offsets: Array
    process_noise: Array
    initial_state: Array
    initial_covariance: Array
    measurements: Array
    measurement_noise: Array

    def running(self) -> NDArray[np.int64]:
        """How many sequences (n,) have a measurement at each time."""
        return np.count_nonzero(self.lengths > np.arange(len(self.measurements))[:, None], axis=1)


@dataclass(frozen=True)
class FilterPass:
    """States (n, b, s, c) and covariances (n, b, s, s) before (`predicted`) and after each time's measurement."""

    predicted: Array
    predicted_covariance: Array
    filtered: Array
    filtered_covariance: Array


def filter_forward(system: LinearSystem) -> FilterPass:
    """Kalman filter: what is known of each state from the measurements up to its time."""
    n, (b, s, c), kind = len(system.measurements), system.initial_state.shape, system.measurements.dtype
    m = system.measurements.shape[2]
    predicted, filtered = np.zeros((2, n, b, s, c), dtype=kind)
    predicted_covariance, filtered_covariance = np.tile(np.eye(s, dtype=kind), (2, n, b, 1, 1))
    measurement_noise = system.measurement_noise[..., None] * np.eye(m, dtype=kind)
    state, covariance = system.initial_state, system.initial_covariance
    for k, running in enumerate(system.running().tolist()):
        if k > 0:
            F = system.transitions[k - 1, :running]
            state = F @ state[:running] + system.offsets[k - 1, :running]
            covariance = F @ covariance[:running] @ np.swapaxes(F, -1, -2) + system.process_noise[k - 1, :running]
        predicted[k, :running], predicted_covariance[k, :running] = state, covariance
        rows = covariance[:, :m]
        weighted = np.linalg.solve(rows[..., :m] + measurement_noise[k, :running], rows)
        gain = np.swapaxes(weighted, -1, -2)
        state = state + gain @ (system.measurements[k, :running] - state[:, :m])
        covariance = covariance - gain @ rows
        covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
        filtered[k, :running], filtered_covariance[k, :running] = state, covariance
    return FilterPass(predicted, predicted_covariance, filtered, filtered_covariance)


def smoothing_gains(system: LinearSystem, forward: FilterPass) -> Array:
    """Gains (n - 1, b, s, s) by which what is learnt of the next state changes each one."""
    ahead = system.transitions @ forward.filtered_covariance[:-1]
    solved = np.linalg.solve(forward.predicted_covariance[1:], ahead)
    return np.asarray(np.swapaxes(solved, -1, -2), dtype=ahead.dtype)


def smooth_states(system: LinearSystem, forward: FilterPass, gains: Array) -> Array:
    """Rauch-Tung-Striebel pass: states (n, b, s, c) given all measurements."""
    states, running = forward.filtered.copy(), system.running().tolist()
    for k in range(len(states) - 2, -1, -1):
        now = slice(0, running[k + 1])
        states[k, now] += gains[k, now] @ (states[k + 1, now] - forward.predicted[k + 1, now])
    return states


def smooth_covariances(system: LinearSystem, forward: FilterPass, gains: Array) -> Array:
    """Rauch-Tung-Striebel pass: covariances (n, b, s, s) of the states given all measurements."""
    covariances, running = forward.filtered_covariance.copy(), system.running().tolist()
    for k in range(len(covariances) - 2, -1, -1):
        now = slice(0, running[k + 1])
        learnt = covariances[k + 1, now] - forward.predicted_covariance[k + 1, now]
        covariances[k, now] += gains[k, now] @ learnt @ np.swapaxes(gains[k, now], -1, -2)
    return covariances


def integrator_transitions(seconds: Array, states: int) -> Array:
    """Transitions (..., s, s) of a coordinate and its derivatives over time steps (...): Taylor's series."""
    power = np.arange(states) - np.arange(states)[:, None]
    taylor = seconds[..., None, None] ** np.maximum(power, 0) / factorial(np.maximum(power, 0))
    return np.where(power >= 0, taylor, 0.0)


def integrator_noise(seconds: Array, states: int) -> Array:
    """Covariances (..., s, s) that white noise of unit density in the last derivative's rate adds over steps (...)."""
    power = np.arange(states - 1, -1, -1)
    total = power[:, None] + power[None, :] + 1
    return seconds[..., None, None] ** total / (total * np.outer(factorial(power), factorial(power)))
