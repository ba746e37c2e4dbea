"""Scale and shift that make the relative inverse depth of a network metric."""

from dataclasses import dataclass

import numpy as np

from olt_generator.errors import InputError
from olt_generator.poses import Array

FEWEST_ANCHORS = 200
# Anchors used, evenly spread over those there are.
MOST_ANCHORS = 50_000
ROUNDS = 20
# Relative error beyond which an anchor counts less and less (Geman and McClure).
TOLERANCE = 0.1


@dataclass(frozen=True)
class AffineAlignment:
    """Inverse depth in 1/m is `scale` times the network's value plus `shift`, for a whole clip.

    Attributes:
        scale, shift: the two numbers, 1/m.
        residual: median relative error of the aligned inverse depth at the anchors.
        agreement: share of the anchors that are met within a tenth.
    """

    scale: float
    shift: float
    residual: float
    agreement: float


def align_affine(relative: Array, inverse_depth: Array) -> AffineAlignment:
    """Fit values of a network (k,) to known inverse depths (k,) in 1/m, with few or no regard to outliers.

    Relative errors are what counts, so that far anchors weigh as much as near ones.

    Raises:
        InputError: there are too few anchors, or they do not grow with the network's values.
    """
    if len(relative) < FEWEST_ANCHORS:
        raise InputError(
            f"{len(relative)} pixels of known distance, and {FEWEST_ANCHORS} are needed to make depth metric; the clip "
            "must move along a textured road"
        )
    step = -(-len(relative) // MOST_ANCHORS)
    relative, inverse_depth = relative[::step], inverse_depth[::step]
    design = np.stack([relative, np.ones_like(relative)], axis=1) / inverse_depth[:, None]
    weight = np.ones(len(relative))
    solution = np.zeros(2)
    for _ in range(ROUNDS):
        root = np.sqrt(weight)
        solution = np.linalg.lstsq(design * root[:, None], root, rcond=None)[0]
        weight = 1.0 / (1.0 + ((design @ solution - 1.0) / TOLERANCE) ** 2) ** 2
    error = np.abs(design @ solution - 1.0)
    if not solution[0] > 0.0:
        raise InputError("the network's values do not grow towards the camera; they are no relative inverse depth")
    scale, shift = solution.tolist()
    return AffineAlignment(scale, shift, float(np.median(error)), float(np.mean(error < TOLERANCE)))
