"""Open-loop metrics of predicted trajectories (docs/formats/alpamayo.md)."""

import numpy as np

from olt_generator.poses import Array
from olt_toolkit.policy.contract import STEP_SECONDS

HORIZONS_SECONDS = (0.5, 1.0, 3.0, 5.0)
# Length, width and height in metres of the box whose corners are compared; it is centred on the trajectory.
_BOX = np.array([4.0, 3.0, 2.0])
_CORNERS = 0.5 * _BOX * np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), axis=-1).reshape(8, 3)


def displacement_errors(predicted_xyz: Array, true_xyz: Array) -> dict[str, float]:
    """Errors of K predictions of one future, in metres, in the plane.

    `min_ade` is the mean over the horizon of the prediction whose mean is smallest, and `min_ade/by_t=h` the mean over
    its first h seconds; `ade` and `ade/by_t=3.0` are those of the first prediction.

    Args:
        predicted_xyz: (K, T, 3).
        true_xyz: (T, 3).
    """
    displacement = np.linalg.norm(predicted_xyz[..., :2] - true_xyz[..., :2], axis=-1)
    best = displacement[np.argmin(displacement.mean(axis=-1))]
    errors = {"min_ade": best.mean(), "ade": displacement[0].mean(), "ade/by_t=3.0": _first(displacement[0], 3.0)}
    errors |= {f"min_ade/by_t={horizon}": _first(best, horizon) for horizon in HORIZONS_SECONDS}
    return {name: float(value) for name, value in errors.items()}


def corner_distance(predicted_xyz: Array, predicted_rotation: Array, true_xyz: Array, true_rotation: Array) -> float:
    """Mean distance in metres between the corners of a box that follows the prediction and one that follows the truth.

    The smallest of the K predictions is taken for every step and corner by itself.

    Args:
        predicted_xyz: (K, T, 3).
        predicted_rotation: (K, T, 3, 3).
        true_xyz: (T, 3).
        true_rotation: (T, 3, 3).
    """
    predicted = _place_box(predicted_xyz, predicted_rotation)
    true = _place_box(true_xyz, true_rotation)
    return float(np.linalg.norm(predicted - true, axis=-1).min(axis=0).mean())


def _first(displacement: Array, seconds: float) -> float:
    return float(displacement[: round(seconds / STEP_SECONDS)].mean())


def _place_box(xyz: Array, rotation: Array) -> Array:
    """Corners (..., T, 8, 3) of the box at every pose."""
    return xyz[..., None, :] + _CORNERS @ np.swapaxes(rotation, -1, -2)
