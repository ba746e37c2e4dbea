"""Polylines (n, d), d >= 2, in metres: all lengths and headings are those in the plane."""

import numpy as np

from olt_generator.poses import Array


def arc_lengths(line: Array) -> Array:
    """Distance (n,) of each point of a polyline (n, d) along it, in the plane, metres."""
    steps = np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def length_of(line: Array) -> float:
    """Length of a polyline (n, d) in the plane, metres."""
    return float(arc_lengths(line)[-1])


def points_along(line: Array, distances: Array) -> Array:
    """Points (m, d) of a polyline (n, d) at distances (m,) along it."""
    arc = arc_lengths(line)
    return np.stack([np.interp(distances, arc, column) for column in line.T], axis=-1)


def resample(line: Array, count: int) -> Array:
    """`count` points (count, d) evenly along a polyline (n, d); a line of one point is repeated."""
    return points_along(line, np.linspace(0.0, length_of(line), count))


def without_repeats(line: Array) -> Array:
    """A polyline (n, d) without points that repeat the one before them in the plane."""
    moved = np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1) > 1e-6
    return line[np.concatenate([[True], moved])]


def beside(line: Array, offset: float) -> Array:
    """A polyline (n, d), n >= 2, moved so many metres to its left, without its repeated points."""
    line = without_repeats(line)
    direction = np.gradient(line[:, :2], axis=0)
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
    moved = line.copy()
    moved[:, :2] += offset * np.column_stack([-direction[:, 1], direction[:, 0]])
    return moved


def heading_at(line: Array, distance: float) -> float:
    """Heading of a polyline (n, d), n >= 2, at a distance along it."""
    line = without_repeats(line)
    index = int(np.clip(np.searchsorted(arc_lengths(line), distance, side="right") - 1, 0, len(line) - 2))
    step = line[index + 1, :2] - line[index, :2]
    return float(np.arctan2(step[1], step[0]))


def wrap(angle: Array) -> Array:
    """Angles (...) in -pi to pi, radians."""
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi
