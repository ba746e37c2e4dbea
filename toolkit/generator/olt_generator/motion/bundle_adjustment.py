"""Poses of a moving camera that agree best with all tracks of a clip at once.

Every track is a point at an unknown distance along the ray of its first observation. Poses and distances are found
together by Gauss-Newton steps with robust weights; the distances are eliminated first (Schur complement), so that a
step costs the solution of a banded system in the poses alone. What the tracks do not fix, the scale above all, is
fixed by the steps from keyframe to keyframe that the poses start from.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from olt_generator.motion.track_equations import (
    FeatureTracks,
    PoseEquations,
    form_equations,
    linearise,
    see_from,
    sort_tracks,
)
from olt_generator.poses import Array, invert, make_pose
from olt_generator.twists import cross_matrix, rotation_from_vector, vector_from_rotation

CONVERGED = 1e-5
# Distances from the first camera in which tracks are believed: nearer than 1 m is the ego vehicle, farther than
# 10 km is as good as infinitely far.
INVERSE_DISTANCE_RANGE = (1e-4, 1.0)


@dataclass(frozen=True)
class StepPriors:
    """What is known beforehand of the camera's motion from each keyframe to the next.

    Attributes:
        T_key_next: (n - 1, 4, 4) expected motion.
        rotation_sigma: (n - 1,) radians, per axis.
        along_sigma: (n - 1,) metres along the expected displacement.
        across_sigma: (n - 1,) metres across it.
    """

    T_key_next: Array
    rotation_sigma: Array
    along_sigma: Array
    across_sigma: Array


@dataclass(frozen=True)
class AdjustedPoses:
    """What agrees best with the tracks.

    Attributes:
        poses: (n, 4, 4) T_world_camera.
        inverse_distance: (points,) from the camera that each point is anchored in, 1/m.
        rotation_covariance: (3 n, 3 n) of the errors of all rotations together, rotation vectors in world axes, for
            tracks whose errors were independent.
    """

    poses: Array
    inverse_distance: Array
    rotation_covariance: Array


def adjust_poses(
    poses: Array, tracks: FeatureTracks, ray_sigma: float, priors: StepPriors, rounds: int
) -> AdjustedPoses:
    """Refine keyframe poses.

    Args:
        poses: (n, 4, 4) camera poses T_world_camera to start from; the first one is kept.
        tracks: what the keyframes have seen.
        ray_sigma: angular noise of a ray, radians.
        priors: expected motion between neighbouring keyframes; it decides what the tracks leave open.
        rounds: Gauss-Newton rounds at most.
    """
    tracks, number = sort_tracks(tracks)
    inverse_distance = _triangulate(poses, tracks)
    for _ in range(rounds):
        equations, distances = form_equations(poses, inverse_distance, tracks, ray_sigma)
        _add_priors(equations, poses, priors)
        # The first pose is the frame in which the others are told.
        step = np.zeros((len(poses), 6))
        step[1:] = -cho_solve_banded((_factorise(equations), True), equations.gradient[1:].ravel()).reshape(-1, 6)
        turned = rotation_from_vector(step[:, :3]) @ poses[:, :3, :3]
        poses = make_pose(turned, poses[:, :3, 3] + step[:, 3:])
        change = distances.solve(step, tracks.anchor)
        inverse_distance = np.clip(inverse_distance + change, *INVERSE_DISTANCE_RANGE)
        if np.abs(step).max() < CONVERGED:
            break
    equations, _ = form_equations(poses, inverse_distance, tracks, ray_sigma)
    _add_priors(equations, poses, priors)
    as_given = np.empty_like(inverse_distance)
    as_given[number] = inverse_distance
    return AdjustedPoses(poses, as_given, _rotation_covariance(equations))


def track_residuals(adjusted: AdjustedPoses, tracks: FeatureTracks, ray_sigma: float) -> Array:
    """How far each observation is from where the motion puts it, (m, 2) in sigmas."""
    return linearise(adjusted.poses, adjusted.inverse_distance, tracks, ray_sigma)[0].T


def _triangulate(poses: Array, tracks: FeatureTracks) -> Array:
    """The inverse distance (points,) at which each anchor ray passes closest to the other rays, 1/m."""
    anchor_ray, baseline, ray = see_from(poses, tracks)
    parallax, shift = np.cross(ray, anchor_ray, axis=0), np.cross(ray, baseline, axis=0)
    points = len(tracks.anchor)
    against = np.bincount(tracks.point, (parallax * shift).sum(axis=0), points)
    shifts = np.bincount(tracks.point, (shift**2).sum(axis=0), points)
    return np.clip(-against / np.maximum(shifts, 1e-12), *INVERSE_DISTANCE_RANGE)


def _add_priors(equations: PoseEquations, poses: Array, priors: StepPriors) -> None:
    """Add what is known of the steps beforehand: residuals in sigmas, and how they change with both poses."""
    expected, found = priors.T_key_next, invert(poses[:-1]) @ poses[1:]
    turn = vector_from_rotation(np.swapaxes(expected[:, :3, :3], -1, -2) @ found[:, :3, :3])
    # Matrices (n - 1, 3, 3) that turn a displacement's error into sigmas, along and across.
    length = np.linalg.norm(expected[:, :3, 3], axis=1, keepdims=True)
    along = expected[:, :3, 3] / np.maximum(length, 1e-12)
    outer = along[:, :, None] * along[:, None, :]
    weigh = outer / priors.along_sigma[:, None, None] + (np.eye(3) - outer) / priors.across_sigma[:, None, None]
    missed = np.einsum("nij,nj->ni", weigh, found[:, :3, 3] - expected[:, :3, 3])
    residual = np.concatenate([turn / priors.rotation_sigma[:, None], missed], axis=1)

    to_camera = np.swapaxes(poses[:, :3, :3], -1, -2)
    earlier, later = np.zeros((2, len(expected), 6, 6))
    later[:, :3, :3] = to_camera[1:] / priors.rotation_sigma[:, None, None]
    earlier[:, :3, :3] = -later[:, :3, :3]
    earlier[:, 3:, :3] = weigh @ cross_matrix(found[:, :3, 3]) @ to_camera[:-1]
    later[:, 3:, 3:] = weigh @ to_camera[:-1]
    earlier[:, 3:, 3:] = -later[:, 3:, 3:]
    for first, derivative in ((0, earlier), (1, later)):
        poses_of = slice(first, first + len(expected))
        equations.blocks[poses_of, 0] += np.swapaxes(derivative, -1, -2) @ derivative
        equations.gradient[poses_of] += np.einsum("nij,ni->nj", derivative, residual)
    equations.blocks[:-1, 1] += np.swapaxes(later, -1, -2) @ earlier


def _factorise(equations: PoseEquations) -> Array:
    """Cholesky factor of the equations of all poses but the first, as a lower band (6 span, 6 (n - 1))."""
    blocks = equations.blocks[1:]
    n, span = blocks.shape[:2]
    band = np.zeros((6 * span, 6 * n))
    for later in range(span):
        for column in range(6):
            row = column if later == 0 else 0
            first = 6 * later + row - column
            band[first : first + 6 - row, column::6] = blocks[:, later, row:, column].T
    return cholesky_banded(band, lower=True)


def _rotation_covariance(equations: PoseEquations) -> Array:
    n = len(equations.blocks)
    turns = (6 * np.arange(n - 1)[:, None] + np.arange(3)).ravel()
    each = np.zeros((6 * n - 6, len(turns)))
    each[turns, np.arange(len(turns))] = 1.0
    covariance = np.zeros((3 * n, 3 * n))
    covariance[3:, 3:] = cho_solve_banded((_factorise(equations), True), each)[turns]
    return covariance
