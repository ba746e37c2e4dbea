"""Radial curves of lenses: how far they rise, and how they are inverted.

A polynomial is a tuple of coefficients in ascending powers.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from olt_generator.poses import Array

Polynomial = tuple[float, ...]
# Value and slope of a curve at the same places.
Curve = Callable[[Array], tuple[Array, Array]]

_MAX_STEPS = 60
# Steps and errors below this share of their range are rounding.
_CONVERGED = 4.0 * np.finfo(np.float64).eps


def evaluate(polynomial: Polynomial, x: Array) -> Array:
    """Values (...) of a polynomial at (...), by Horner's rule."""
    leading, *others = _highest_first(polynomial)
    value = np.full_like(x, leading)
    for coefficient in others:
        value *= x
        if coefficient:
            value += coefficient
    return value


@lru_cache(maxsize=256)
def _highest_first(polynomial: Polynomial) -> Polynomial:
    """Coefficients in descending powers, from the first that is not 0."""
    degree = max((power for power, coefficient in enumerate(polynomial) if coefficient), default=0)
    return polynomial[degree::-1]


def derivative(polynomial: Polynomial) -> Polynomial:
    """Coefficients of the derivative."""
    return tuple(power * coefficient for power, coefficient in enumerate(polynomial))[1:]


def curve_of(polynomial: Polynomial) -> Curve:
    """A polynomial with its slope, as `invert_rising` takes it."""
    slope = derivative(polynomial)
    return lambda x: (evaluate(polynomial, x), evaluate(slope, x))


@lru_cache(maxsize=256)
def smallest_positive_root(polynomial: Polynomial) -> float:
    """The first place above 0 where the polynomial is 0, inf where there is none."""
    roots = np.polynomial.polynomial.polyroots(np.trim_zeros(np.asarray(polynomial, np.float64), "b"))
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
    return float(real.min(initial=np.inf))


def invert_rising(curve: Curve, values: Array, start: Array, upper: float) -> Array:
    """Solve curve(x) = value for x in 0 ... upper, where the curve rises from 0.

    Newton's method inside a bracket that every step narrows; a step that would leave it is replaced by bisection, so
    that any start converges. Stops where steps are rounding.

    Args:
        curve: value and slope at (...); must rise over the whole range.
        values: (...) wanted values. NaN gives NaN; values beyond the ends of the range give the ends.
        start: (...) first guess.
        upper: end of the range, finite.
    """
    low, high = np.zeros_like(values), np.full_like(values, upper)
    x = np.clip(np.nan_to_num(start), 0.0, upper)
    small_step, small_error = _CONVERGED * upper, _CONVERGED * float(curve(np.array(upper))[0])
    for _ in range(_MAX_STEPS):
        value, slope = curve(x)
        excess = value - values
        low, high = np.where(excess <= 0.0, x, low), np.where(excess >= 0.0, x, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = x - excess / slope
        moved = np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
        settled = (np.abs(moved - x) <= small_step) | ~(np.abs(excess) > small_error)
        x = moved
        if settled.all():
            break
    return np.where(np.isnan(values), np.nan, x)


def fit_through_origin(x: Array, y: Array, degree: int, weights: Array | None = None) -> Polynomial:
    """Least-squares polynomial of the given degree through the origin that maps x (n,) to y (n,).

    Args:
        x, y: (n,) samples, x not all 0.
        degree: highest power.
        weights: (n,) by which the errors count; None for all the same.
    """
    scale = np.abs(x).max()
    weight = np.ones_like(x) if weights is None else weights
    design = np.stack([(x / scale) ** power for power in range(1, degree + 1)], axis=-1)
    coefficients = np.linalg.lstsq(design * weight[:, None], y * weight, rcond=None)[0]
    return (0.0, *(float(value / scale**power) for power, value in enumerate(coefficients, start=1)))
