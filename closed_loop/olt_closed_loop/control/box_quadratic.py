"""Small dense quadratic programs whose only constraints are limits of the variables."""

import numpy as np

from olt_generator.poses import Array

_MAX_ITERATIONS = 30
_TOLERANCE = 1e-9


class SolveFailed(Exception):
    """A solver of `control` found no solution; the message says why."""


def minimise_in_box(hessian: Array, gradient: Array, low: Array, high: Array) -> Array:
    """The x (n,) in [low, high] that minimises x H x / 2 + g x, for a positive definite H (n, n).

    Newton steps on the variables that no limit holds, cut at the limits, halved until the function falls (projected
    Newton: Bertsekas, SIAM J. Control Optim. 20, 1982). From x = 0, which must be within the limits; where no limit
    is met it takes one step.

    Raises:
        SolveFailed: not solved in 30 steps, or something is not finite.
    """
    x = np.zeros_like(gradient)
    tolerance = _TOLERANCE * (1.0 + np.abs(gradient).max())
    for _ in range(_MAX_ITERATIONS):
        slope = hessian @ x + gradient
        free = ~(((x <= low) & (slope > 0.0)) | ((x >= high) & (slope < 0.0)))
        if np.all(np.abs(slope[free]) <= tolerance):
            return x
        step = np.zeros_like(slope)
        if free.all():
            step[:] = np.linalg.solve(hessian, -slope)
        else:
            step[free] = np.linalg.solve(hessian[np.ix_(free, free)], -slope[free])
        x = _cut_step(hessian, slope, x, step, low, high)
    raise SolveFailed(f"the quadratic program was not solved in {_MAX_ITERATIONS} steps")


def _cut_step(hessian: Array, slope: Array, x: Array, step: Array, low: Array, high: Array) -> Array:
    """The point on the cut ray x + t step, t = 1, 1/2, 1/4 ..., at which the function has fallen enough."""
    for halvings in range(_MAX_ITERATIONS):
        moved = np.clip(x + 0.5**halvings * step, low, high) - x
        expected = slope @ moved
        if expected + 0.5 * moved @ hessian @ moved <= 0.1 * expected:
            return x + moved
    raise SolveFailed("the quadratic program has no descent; its numbers are not finite")
