"""How noisy a trajectory is: the levels of jitter and of true change for which what was measured is most likely.

Positions are taken for thrice integrated white noise (jerk) on every axis, summed rotation vectors for twice integrated
white noise (angular acceleration), both seen with white jitter. A Kalman filter runs for every pair of levels on a
grid; its innovations give the likelihood (Schweppe 1965). A measurement that a pair finds less likely than an
outlier anywhere about is left out, so that it spoils neither state nor level. The filter runs in both directions of
time, and the one that finds the measurements more likely counts.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from olt_generator.motion.kalman import integrator_noise, integrator_transitions
from olt_generator.poses import Array

# An outlier: one in ten, anywhere within 10 m or 1 rad on each axis.
OUTLIER_SHARE = 0.1


@dataclass(frozen=True)
class LevelGrid:
    """What is tried, and what is expected of a trajectory.

    Attributes:
        jitters: levels of the measurement noise that are tried, m or rad.
        densities: root spectral densities of the highest derivative that are tried.
        usual: median jitter and median density.
        spreads: standard deviations of the logarithms of the two. What jitter to expect is hardly known.
        initial_sigmas: standard deviations of the derivatives at the first time; their number is the model's order.
        outlier_range: width in m or rad over which outliers lie, on each axis.
    """

    jitters: Array
    densities: Array
    usual: tuple[float, float]
    spreads: tuple[float, float]
    initial_sigmas: tuple[float, ...]
    outlier_range: float

    def where_known(self, jitter: float | None, density: float | None) -> "LevelGrid":
        """The grid with what is known as its only value."""
        jitters = self.jitters if jitter is None else np.array([jitter])
        return replace(self, jitters=jitters, densities=self.densities if density is None else np.array([density]))

    def pairs(self) -> tuple[Array, Array, Array]:
        """All pairs of a jitter (g,) and a density (g,), and their -2 log probability (g,) up to a constant."""
        jitter, density = (values.ravel() for values in np.meshgrid(self.jitters, self.densities, indexing="ij"))
        unusual_jitter = np.log(jitter / self.usual[0]) / self.spreads[0]
        unusual_density = np.log(density / self.usual[1]) / self.spreads[1]
        return jitter, density, unusual_jitter**2 + unusual_density**2


_SPREADS = (float(np.log(10.0)), float(np.log(2.0)))
POSITION_GRID = LevelGrid(
    jitters=np.geomspace(1e-3, 1.0, 16),
    densities=np.geomspace(0.1, 1.6, 5),
    usual=(0.03, 0.5),
    spreads=_SPREADS,
    initial_sigmas=(100.0, 5.0),
    outlier_range=10.0,
)
ROTATION_GRID = LevelGrid(
    jitters=np.geomspace(2e-5, 0.1, 18),
    densities=np.geomspace(0.01, 0.32, 6),
    usual=(5e-4, 0.05),
    spreads=_SPREADS,
    initial_sigmas=(1.0,),
    outlier_range=1.0,
)


def estimate_levels(
    lengths: NDArray[np.int64], seconds: Array, measurements: Array, grid: LevelGrid
) -> tuple[Array, Array]:
    """The most likely jitters (b,) and densities (b,) of sequences of coordinates (n, b, 3) over steps (n - 1, b).

    `lengths` (b,) counts the measurements of each sequence, and falls.
    """
    jitter, density, prior = grid.pairs()
    forward = _deviance(lengths, seconds, measurements, grid) + prior
    # Time steps and measurements in the opposite order, still from the first row on.
    steps = np.maximum(lengths - 2 - np.arange(len(seconds))[:, None], 0)
    back = np.maximum(lengths - 1 - np.arange(len(measurements))[:, None], 0)[..., None]
    seconds, measurements = np.take_along_axis(seconds, steps, 0), np.take_along_axis(measurements, back, 0)
    backward = _deviance(lengths, seconds, measurements, grid) + prior
    # A filter that starts among outliers may lose its way; it has no reason to in the other direction.
    better = np.where((forward.min(axis=1) <= backward.min(axis=1))[:, None], forward, backward)
    best = np.argmin(better, axis=1)
    return jitter[best], density[best]


def _deviance(lengths: NDArray[np.int64], seconds: Array, measurements: Array, grid: LevelGrid) -> Array:
    """-2 log likelihood (b, g) of sequences (n, b, 3) for every pair of levels (g,), up to a constant."""
    jitter, density, _ = grid.pairs()
    states = 1 + len(grid.initial_sigmas)
    shape = (len(lengths), len(jitter))
    covariance = np.zeros((*shape, states, states))
    # The first measurement may itself be an outlier, and only says where about to start.
    covariance[:] = np.diag(np.square([grid.outlier_range, *grid.initial_sigmas]))
    state = np.zeros((*shape, states, 3))
    state[..., 0, :] = measurements[0, :, None]
    deviance = np.zeros(shape)
    transitions, unit_noise = integrator_transitions(seconds, states), integrator_noise(seconds, states)
    for k in range(1, len(measurements)):
        running = np.count_nonzero(lengths > k)
        F = transitions[k - 1, :running, None]
        state = F @ state[:running]
        noise = density[:, None, None] ** 2 * unit_noise[k - 1, :running, None]
        covariance = F @ covariance[:running] @ np.swapaxes(F, -1, -2) + noise
        variance = covariance[..., 0, 0] + jitter**2
        innovation = measurements[k, :running, None] - state[..., 0, :]
        found = np.sum(innovation**2, axis=-1) / variance + 3.0 * np.log(2.0 * np.pi * variance)
        outlier = 3.0 * np.log(np.maximum(grid.outlier_range**2, 36.0 * variance)) - 2.0 * np.log(OUTLIER_SHARE)
        deviance[:running] += np.minimum(found, outlier)
        gain = np.where(found < outlier, 1.0 / variance, 0.0)[..., None] * covariance[..., 0]
        state = state + gain[..., None] * innovation[..., None, :]
        covariance = covariance - gain[..., None] * covariance[..., None, :, 0]
    return deviance
