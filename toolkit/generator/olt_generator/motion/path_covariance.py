"""How uncertain the poses of a path are: drift of rotation, and drift of scale, added up along the way.

With displacements d_i of the steps, errors of rotation w_i (rotation vectors in the axes of the first pose) and of the
logarithm of scale e_i, the position after step j errs by the sum over i <= j of w_i x d_i + e_i d_i.
"""

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_generator.twists import cross_matrix

# Errors of following last over several keyframes, so that rotations err by more than independent ones would.
CORRELATED_TRACKS = 3.0
# What turns a step as no vehicle turns turns all steps alike: a share of how far its directions are beyond what noise
# makes of them, radians.
USUAL_SLIP = np.radians(0.25)
TURN_SHARE = 0.4


# Slower than this no road seems to move, m/s: half of the grid's spacing over the longest pair of pictures.
UNSEEN_SPEED = 0.03


def roll_on(times: Array, forward: Array) -> Array:
    """Covariance (n, 6, 6) of a vehicle that rolls along `forward` (3,) unseen, at times (n,) in seconds."""
    covariance = np.zeros((len(times), 6, 6))
    covariance[:, :3, :3] = (UNSEEN_SPEED * (times - times[0]))[:, None, None] ** 2 * np.outer(forward, forward)
    return covariance


def turning_drift(slip: float, moved: NDArray[np.bool_], up: Array) -> Array:
    """Covariance (3 n, 3 n) of rotations that all err alike from step to step, for steps that slip by `slip` radians.

    Args:
        slip: usual angle between the direction of a step and that of a vehicle which rolls.
        moved: (n - 1,) steps in which the vehicle moves.
        up: (3,) axis about which vehicles turn.
    """
    turned = TURN_SHARE * max(0.0, slip - USUAL_SLIP) * np.concatenate([[0.0], np.cumsum(moved)])
    each = (turned[:, None] * up).ravel()
    return np.outer(each, each)


def add_up_drift(positions: Array, rotation_covariance: Array, log_scale_covariance: Array) -> Array:
    """Covariance (n, 6, 6) of position and rotation vector at every pose, in the axes of the first one.

    Args:
        positions: (n, 3) metres.
        rotation_covariance: (3 n, 3 n) of all rotations together.
        log_scale_covariance: (n - 1, n - 1) of the logarithm of the length of every step.
    """
    poses = len(positions)
    turns = rotation_covariance.reshape(poses, 3, poses, 3)
    moved = np.diff(positions, axis=0)
    lever = -cross_matrix(moved)
    by_turn = np.einsum("iab,ibjc,jdc->iajd", lever, turns[:-1, :, :-1], lever)
    by_scale = np.einsum("ia,ij,jd->iajd", moved, log_scale_covariance, moved)
    position = np.cumsum(np.cumsum(by_turn + by_scale, axis=0), axis=2)
    mixed = np.cumsum(np.einsum("iab,ibjc->iajc", lever, turns[:-1, :, 1:]), axis=0)
    covariance = np.zeros((poses, 6, 6))
    each, later = np.arange(poses), np.arange(poses - 1)
    covariance[1:, :3, :3] = position[later, :, later, :]
    covariance[1:, :3, 3:] = mixed[later, :, later, :]
    covariance[1:, 3:, :3] = np.swapaxes(covariance[1:, :3, 3:], -1, -2)
    covariance[:, 3:, 3:] = turns[each, :, each, :]
    return covariance
