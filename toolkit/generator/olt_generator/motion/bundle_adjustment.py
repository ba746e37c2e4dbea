"""Poses of a moving camera that agree best with all tracks of a clip at once.

Every track is a point at an unknown distance along the ray of its first observation. Poses and distances are found
together by Gauss-Newton steps with robust weights; the distances are eliminated first (Schur complement), so that a
step costs the solution of a banded system in the poses alone. What the tracks do not fix, the scale above all, is
fixed by the steps from keyframe to keyframe that the poses start from.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array
from scipy.sparse.linalg import splu

from olt_generator.poses import Array, invert, make_pose
from olt_generator.twists import cross_matrix, rotation_from_vector, vector_from_rotation

CONVERGED = 1e-5
# Distances from the first camera in which tracks are believed: nearer than 1 m is the ego vehicle, farther than
# 10 km is as good as infinitely far.
INVERSE_DISTANCE_RANGE = (1e-4, 1.0)
# A prior of 1/m keeps points without parallax solvable and says nothing about all others.
INVERSE_DISTANCE_SIGMA = 1.0


@dataclass(frozen=True)
class FeatureTracks:
    """Observations of points from several keyframes.

    Attributes:
        anchor: (points,) keyframe in which each point was found.
        anchor_ray: (points, 3) unit ray to the point there.
        point: (m,) point of each further observation.
        frame: (m,) keyframe of each further observation.
        ray: (m, 3) unit ray of each further observation.
    """

    anchor: NDArray[np.int64]
    anchor_ray: Array
    point: NDArray[np.int64]
    frame: NDArray[np.int64]
    ray: Array


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
    # Triangulation: the inverse distance (points,) at which each anchor ray passes closest to the other rays, 1/m.
    turned, baseline = _seen_from(poses, tracks)
    parallax, shift = np.cross(tracks.ray, turned), np.cross(tracks.ray, baseline)
    points = len(tracks.anchor)
    against = np.bincount(tracks.point, (parallax * shift).sum(axis=1), points)
    shifts = np.bincount(tracks.point, (shift**2).sum(axis=1), points)
    inverse_distance = np.clip(-against / np.maximum(shifts, 1e-12), *INVERSE_DISTANCE_RANGE)
    for _ in range(rounds):
        step, change = _gauss_newton_step(poses, inverse_distance, tracks, ray_sigma, priors)
        turned = poses[:, :3, :3] @ rotation_from_vector(step[:, :3])
        poses = make_pose(turned, poses[:, :3, 3] + step[:, 3:])
        inverse_distance = np.clip(inverse_distance + change, *INVERSE_DISTANCE_RANGE)
        if np.abs(step).max() < CONVERGED:
            break
    return AdjustedPoses(
        poses, inverse_distance, _rotation_covariance(poses, inverse_distance, tracks, ray_sigma, priors)
    )


def track_residuals(adjusted: AdjustedPoses, tracks: FeatureTracks, ray_sigma: float) -> Array:
    """How far each observation is from where the motion puts it, (m, 2) in sigmas."""
    return _linearise(adjusted.poses, adjusted.inverse_distance, tracks, ray_sigma)[0]


def _rotation_covariance(
    poses: Array, inverse_distance: Array, tracks: FeatureTracks, ray_sigma: float, priors: StepPriors
) -> Array:
    reduced = _normal_equations(poses, inverse_distance, tracks, ray_sigma, priors)[0]
    turns = (6 * np.arange(1, len(poses))[:, None] + np.arange(3)).ravel() - 6
    each = np.zeros((6 * len(poses) - 6, len(turns)))
    each[turns, np.arange(len(turns))] = 1.0
    covariance = np.zeros((len(poses), 3, len(poses), 3))
    found = splu(csc_array(reduced)[6:, 6:]).solve(each)[turns]
    covariance[1:, :, 1:] = found.reshape(len(poses) - 1, 3, len(poses) - 1, 3)
    R = poses[:, :3, :3]
    return np.einsum("aij,ajbk,blk->aibl", R, covariance, R).reshape(3 * len(poses), 3 * len(poses))


def _seen_from(poses: Array, tracks: FeatureTracks) -> tuple[Array, Array]:
    """Anchor ray (m, 3) and displacement to the anchor camera (m, 3), both in the axes of the observing camera."""
    anchor = tracks.anchor[tracks.point]
    to_camera = np.swapaxes(poses[tracks.frame, :3, :3], -1, -2)
    ray_world = _apply(poses[anchor, :3, :3], tracks.anchor_ray[tracks.point])
    baseline_world = poses[anchor, :3, 3] - poses[tracks.frame, :3, 3]
    return _apply(to_camera, ray_world), _apply(to_camera, baseline_world)


def _gauss_newton_step(
    poses: Array, inverse_distance: Array, tracks: FeatureTracks, ray_sigma: float, priors: StepPriors
) -> tuple[Array, Array]:
    """Changes (n, 6) of the poses, rotation in camera and position in world axes, and (points,) of inverse distance."""
    reduced, gradient, mixed, distance_gradient, information = _normal_equations(
        poses, inverse_distance, tracks, ray_sigma, priors
    )
    # The first pose is the frame in which the others are told.
    step = np.zeros(6 * len(poses))
    step[6:] = -splu(csc_array(reduced)[6:, 6:]).solve(gradient[6:])
    return step.reshape(-1, 6), -(distance_gradient + mixed.T @ step) / information


def _normal_equations(
    poses: Array, inverse_distance: Array, tracks: FeatureTracks, ray_sigma: float, priors: StepPriors
) -> tuple[csr_array, Array, csr_array, Array, Array]:
    """Those of the poses once the distances are eliminated, (6 n, 6 n) and (6 n,), and what the distances follow from.

    That is how poses and distances mix (6 n, points), the gradient (points,), and the information (points,).
    """
    residual, by_frame, by_anchor, by_distance = _linearise(poses, inverse_distance, tracks, ray_sigma)
    # Geman-McClure: what moves by itself, and what was lost by its track, has no say.
    weight = 1.0 / (1.0 + (residual**2).sum(axis=1))
    scaled = weight[:, None]
    residual, by_distance = residual * scaled, by_distance * scaled
    points, rows = len(tracks.anchor), np.arange(residual.size)
    blocks = np.stack([by_frame, by_anchor]) * scaled[..., None]
    starts = 6 * np.stack([tracks.frame, tracks.anchor[tracks.point]])
    J = _sparse(blocks, rows.reshape(-1, 2, 1), starts[:, :, None, None] + np.arange(6), 6 * len(poses))
    N = csr_array((by_distance.ravel(), (rows, np.repeat(tracks.point, 2))), (residual.size, points))
    prior_residual, P = _prior_equations(poses, priors)

    information = np.bincount(tracks.point, (by_distance**2).sum(axis=1), points) + INVERSE_DISTANCE_SIGMA**-2
    mixed = csr_array(J.T @ N)
    reduced = J.T @ J + P.T @ P - (mixed / information) @ mixed.T
    distance_gradient = N.T @ residual.ravel()
    gradient = J.T @ residual.ravel() + P.T @ prior_residual - mixed @ (distance_gradient / information)
    return (
        csr_array(reduced),
        np.asarray(gradient),
        mixed,
        np.asarray(distance_gradient),
        np.asarray(information, np.float64),
    )


def _linearise(
    poses: Array, inverse_distance: Array, tracks: FeatureTracks, ray_sigma: float
) -> tuple[Array, Array, Array, Array]:
    """Residuals (m, 2) in sigmas and their derivatives by both poses (m, 2, 6) and the inverse distance (m, 2).

    A point at inverse distance s along the ray r of camera a lies, seen from camera k, along
    p = R_k' (R_a r + s (c_a - c_k)). The residual is p / |p| in the plane that touches the unit sphere at the
    observed ray.
    """
    turned, baseline = _seen_from(poses, tracks)
    s = inverse_distance[tracks.point][:, None]
    p = turned + s * baseline
    length = np.linalg.norm(p, axis=1, keepdims=True)
    u = p / length
    # Two unit vectors (m, 2, 3) at right angles to each observed ray and to each other.
    away = np.where(np.abs(tracks.ray[:, :1]) < 0.7, np.eye(3)[:1], np.eye(3)[1:2])
    first = np.cross(tracks.ray, away).astype(np.float64)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    plane = np.stack([first, _apply(cross_matrix(tracks.ray), first)], axis=1)
    residual = np.einsum("mij,mj->mi", plane, u) / ray_sigma
    across = (plane - np.einsum("mij,mj->mi", plane, u)[..., None] * u[:, None, :]) / (length * ray_sigma)[..., None]
    to_camera = np.swapaxes(poses[tracks.frame, :3, :3], -1, -2)
    anchor_to_camera = to_camera @ poses[tracks.anchor[tracks.point], :3, :3]
    by_position = s[..., None] * (across @ to_camera)
    by_frame = np.concatenate([across @ cross_matrix(p), -by_position], axis=-1)
    turn_of_anchor = anchor_to_camera @ cross_matrix(tracks.anchor_ray[tracks.point])
    by_anchor = np.concatenate([-across @ turn_of_anchor, by_position], axis=-1)
    return residual, by_frame, by_anchor, np.einsum("mij,mj->mi", across, baseline)


def _prior_equations(poses: Array, priors: StepPriors) -> tuple[Array, csr_array]:
    """Residuals (6 (n - 1),) of the steps in sigmas, and their derivatives by the poses."""
    expected, found = priors.T_key_next, invert(poses[:-1]) @ poses[1:]
    turn = vector_from_rotation(np.swapaxes(expected[:, :3, :3], -1, -2) @ found[:, :3, :3])
    # Matrices (n - 1, 3, 3) that turn a displacement's error into sigmas, along and across.
    length = np.linalg.norm(expected[:, :3, 3], axis=1, keepdims=True)
    along = expected[:, :3, 3] / np.maximum(length, 1e-12)
    outer = along[:, :, None] * along[:, None, :]
    weigh = outer / priors.along_sigma[:, None, None] + (np.eye(3) - outer) / priors.across_sigma[:, None, None]
    missed = _apply(weigh, found[:, :3, 3] - expected[:, :3, 3])
    residual = np.concatenate([turn / priors.rotation_sigma[:, None], missed], axis=1)

    steps = len(expected)
    blocks = np.zeros((steps, 6, 12))
    blocks[:, :3, :3] = -np.swapaxes(found[:, :3, :3], -1, -2) / priors.rotation_sigma[:, None, None]
    blocks[:, :3, 6:9] = np.eye(3) / priors.rotation_sigma[:, None, None]
    blocks[:, 3:, :3] = weigh @ cross_matrix(found[:, :3, 3])
    blocks[:, 3:, 9:] = weigh @ np.swapaxes(poses[:-1, :3, :3], -1, -2)
    blocks[:, 3:, 3:6] = -blocks[:, 3:, 9:]
    rows = np.arange(6 * steps).reshape(steps, 6, 1)
    columns = (6 * np.arange(steps))[:, None, None] + np.arange(12)
    return residual.ravel(), _sparse(blocks, rows, columns, 6 * len(poses))


def _sparse(blocks: Array, rows: NDArray[np.int64], columns: NDArray[np.int64], width: int) -> csr_array:
    """The matrix (residuals, width) with these blocks; rows and columns are broadcast to them."""
    at = tuple(np.broadcast_to(index, blocks.shape).ravel() for index in (rows, columns))
    return coo_array((blocks.ravel(), at), (int(rows.max(initial=-1)) + 1, width)).tocsr()


def _apply(matrices: Array, vectors: Array) -> Array:
    return (matrices @ vectors[..., None])[..., 0]
