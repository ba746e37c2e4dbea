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
# Distances from the first camera in which tracks are believed: nearer than 1 m is the own vehicle, farther than
# 10 km is as good as infinitely far.
NEARNESS_RANGE = (1e-4, 1.0)
# A prior of 1/m keeps points without parallax solvable and says nothing about all others.
NEARNESS_SIGMA = 1.0


@dataclass(frozen=True)
class Tracks:
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


def adjust_poses(poses: Array, tracks: Tracks, ray_sigma: float, priors: StepPriors, rounds: int) -> Array:
    """Refine keyframe poses.

    Args:
        poses: (n, 4, 4) camera poses T_world_camera to start from; the first one is kept.
        tracks: what the keyframes have seen.
        ray_sigma: angular noise of a ray, radians.
        priors: expected motion between neighbouring keyframes; it decides what the tracks leave open.
        rounds: Gauss-Newton rounds at most.

    Returns:
        Refined poses (n, 4, 4).
    """
    nearness = _triangulate(poses, tracks)
    for _ in range(rounds):
        step, nearness_step = _gauss_newton_step(poses, nearness, tracks, ray_sigma, priors)
        poses = _moved(poses, step)
        nearness = np.clip(nearness + nearness_step, *NEARNESS_RANGE)
        if np.abs(step).max() < CONVERGED:
            break
    return poses


def _triangulate(poses: Array, tracks: Tracks) -> Array:
    """One over the distance (points,) at which each anchor ray passes closest to the other rays, 1/m."""
    turned, baseline = _seen_from(poses, tracks)
    parallax, shift = np.cross(tracks.ray, turned), np.cross(tracks.ray, baseline)
    points = len(tracks.anchor)
    against = np.bincount(tracks.point, (parallax * shift).sum(axis=1), points)
    shifts = np.bincount(tracks.point, (shift**2).sum(axis=1), points)
    return np.clip(-against / np.maximum(shifts, 1e-12), *NEARNESS_RANGE)


def _seen_from(poses: Array, tracks: Tracks) -> tuple[Array, Array]:
    """Anchor ray (m, 3) and displacement to the anchor camera (m, 3), both in the axes of the observing camera."""
    anchor = tracks.anchor[tracks.point]
    to_camera = np.swapaxes(poses[tracks.frame, :3, :3], -1, -2)
    ray_world = _apply(poses[anchor, :3, :3], tracks.anchor_ray[tracks.point])
    baseline_world = poses[anchor, :3, 3] - poses[tracks.frame, :3, 3]
    return _apply(to_camera, ray_world), _apply(to_camera, baseline_world)


def _gauss_newton_step(
    poses: Array, nearness: Array, tracks: Tracks, ray_sigma: float, priors: StepPriors
) -> tuple[Array, Array]:
    """Changes of the poses (n, 6), rotation in the camera's axes and position in the world's, and of nearness."""
    residual, by_frame, by_anchor, by_nearness = _linearise(poses, nearness, tracks, ray_sigma)
    # Geman-McClure: what moves by itself, and what was lost by its track, has no say.
    weight = 1.0 / (1.0 + (residual**2).sum(axis=1))
    scaled = weight[:, None]
    residual, by_nearness = residual * scaled, by_nearness * scaled
    J = _pose_jacobian(by_frame * scaled[..., None], by_anchor * scaled[..., None], tracks, len(poses))
    points = len(tracks.anchor)
    N = csr_array(
        (by_nearness.ravel(), (np.arange(residual.size), np.repeat(tracks.point, 2))), (residual.size, points)
    )
    prior_residual, P = _prior_equations(poses, priors)

    information = np.bincount(tracks.point, (by_nearness**2).sum(axis=1), points) + NEARNESS_SIGMA**-2
    mixed = csr_array(J.T @ N)
    reduced = J.T @ J + P.T @ P - (mixed / information) @ mixed.T
    nearness_gradient = N.T @ residual.ravel()
    gradient = J.T @ residual.ravel() + P.T @ prior_residual - mixed @ (nearness_gradient / information)
    # The first pose is the frame in which the others are told.
    step = np.zeros(6 * len(poses))
    step[6:] = -splu(csc_array(reduced)[6:, 6:]).solve(gradient[6:])
    return step.reshape(-1, 6), -(nearness_gradient + mixed.T @ step) / information


def _linearise(poses: Array, nearness: Array, tracks: Tracks, ray_sigma: float) -> tuple[Array, Array, Array, Array]:
    """Residuals (m, 2) in sigmas and their derivatives by both poses (m, 2, 6) and the nearness (m, 2).

    A point at nearness s along the ray r of camera a lies, seen from camera k, along p = R_k' (R_a r + s (c_a - c_k)).
    The residual is p / |p| in the plane that touches the unit sphere at the observed ray.
    """
    turned, baseline = _seen_from(poses, tracks)
    s = nearness[tracks.point][:, None]
    p = turned + s * baseline
    length = np.linalg.norm(p, axis=1, keepdims=True)
    u = p / length
    plane = _tangents(tracks.ray)
    residual = np.einsum("mij,mj->mi", plane, u) / ray_sigma
    across = (plane - np.einsum("mij,mj->mi", plane, u)[..., None] * u[:, None, :]) / (length * ray_sigma)[..., None]
    to_camera = np.swapaxes(poses[tracks.frame, :3, :3], -1, -2)
    anchor_to_camera = to_camera @ poses[tracks.anchor[tracks.point], :3, :3]
    by_position = s[..., None] * (across @ to_camera)
    by_frame = np.concatenate([across @ cross_matrix(p), -by_position], axis=-1)
    turn_of_anchor = anchor_to_camera @ cross_matrix(tracks.anchor_ray[tracks.point])
    by_anchor = np.concatenate([-across @ turn_of_anchor, by_position], axis=-1)
    return residual, by_frame, by_anchor, np.einsum("mij,mj->mi", across, baseline)


def _pose_jacobian(by_frame: Array, by_anchor: Array, tracks: Tracks, frames: int) -> csr_array:
    rows = np.broadcast_to(np.arange(2 * len(by_frame)).reshape(-1, 2, 1), by_frame.shape)
    first = np.stack([tracks.frame, tracks.anchor[tracks.point]])[:, :, None, None] * 6
    columns = np.broadcast_to(first + np.arange(6), (2, *by_frame.shape))
    values = np.stack([by_frame, by_anchor])
    rows = np.broadcast_to(rows, values.shape)
    shape = (2 * len(by_frame), 6 * frames)
    return coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape).tocsr()


def _prior_equations(poses: Array, priors: StepPriors) -> tuple[Array, csr_array]:
    """Residuals (6 (n - 1),) of the steps in sigmas, and their derivatives by the poses."""
    steps = len(priors.T_key_next)
    R_key = poses[:-1, :3, :3]
    found = invert(poses[:-1]) @ poses[1:]
    expected = priors.T_key_next
    turn = vector_from_rotation(np.swapaxes(expected[:, :3, :3], -1, -2) @ found[:, :3, :3])
    weigh = _displacement_weights(expected[:, :3, 3], priors)
    missed = _apply(weigh, found[:, :3, 3] - expected[:, :3, 3])
    residual = np.concatenate([turn / priors.rotation_sigma[:, None], missed], axis=1)

    blocks = np.zeros((steps, 6, 12))
    blocks[:, :3, :3] = -np.swapaxes(found[:, :3, :3], -1, -2) / priors.rotation_sigma[:, None, None]
    blocks[:, :3, 6:9] = np.eye(3) / priors.rotation_sigma[:, None, None]
    blocks[:, 3:, :3] = weigh @ cross_matrix(found[:, :3, 3])
    blocks[:, 3:, 9:] = weigh @ np.swapaxes(R_key, -1, -2)
    blocks[:, 3:, 3:6] = -blocks[:, 3:, 9:]
    rows = np.broadcast_to(np.arange(6 * steps).reshape(steps, 6, 1), blocks.shape)
    columns = np.broadcast_to((6 * np.arange(steps))[:, None, None] + np.arange(12), blocks.shape)
    shape = (6 * steps, 6 * len(poses))
    return residual.ravel(), coo_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape).tocsr()


def _displacement_weights(displacement: Array, priors: StepPriors) -> Array:
    """Matrices (k, 3, 3) that turn a displacement's error into sigmas, along and across."""
    length = np.linalg.norm(displacement, axis=1, keepdims=True)
    along = displacement / np.maximum(length, 1e-12)
    outer = along[:, :, None] * along[:, None, :]
    return outer / priors.along_sigma[:, None, None] + (np.eye(3) - outer) / priors.across_sigma[:, None, None]


def _moved(poses: Array, step: Array) -> Array:
    turned = poses[:, :3, :3] @ rotation_from_vector(step[:, :3])
    return make_pose(turned, poses[:, :3, 3] + step[:, 3:])


def _tangents(rays: Array) -> Array:
    """Two unit vectors (m, 2, 3) at right angles to each ray (m, 3) and to each other."""
    away = np.where(np.abs(rays[:, :1]) < 0.7, np.eye(3)[:1], np.eye(3)[1:2])
    first = np.cross(rays, away).astype(np.float64)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, _apply(cross_matrix(rays), first)], axis=1)


def _apply(matrices: Array, vectors: Array) -> Array:
    return (matrices @ vectors[..., None])[..., 0]
