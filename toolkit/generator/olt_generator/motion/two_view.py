"""Relative motion of a camera between two frames, up to the length of the translation."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_generator.poses import Array
from olt_generator.twists import cross_matrix, cross_rows, dot_rows

# Perspective coordinates stretch towards the edge of a wide lens: the first guess is made inside this cone.
MAX_GUESS_ANGLE = np.radians(60.0)
GUESS_CONFIDENCE = 0.999
MAX_REFINEMENTS = 10
CONVERGED_RADIANS = 1e-5
# A ray agrees with a motion within so many times its noise.
INLIER_SIGMAS = 4.0


@dataclass(frozen=True)
class TwoViewMotion:
    """Motion of a camera from frame a to frame b.

    Attributes:
        R_b_a: (3, 3) rotation that maps directions in a to directions in b.
        direction_a: (3,) unit displacement of the camera in the axes of a, or its opposite: rays alone do not tell
            where what they show moves by itself; `parallax_forward` looks at each.
        inliers: (n,) which rays agree with the motion.
    """

    R_b_a: Array
    direction_a: Array
    inliers: NDArray[np.bool_]


def estimate_motion(rays_a: Array, rays_b: Array, sigma: float) -> TwoViewMotion | None:
    """Robust epipolar motion between matched unit rays (n, 3).

    RANSAC over five-point essential matrices gives the first guess; robust Gauss-Newton steps then minimise the angle
    between each ray in b and its epipolar plane, which treats all parts of a wide lens alike.

    Args:
        rays_a, rays_b: rays of the same points in the two frames.
        sigma: angular noise of a ray in radians.

    Returns:
        The motion, or None where no essential matrix explains the rays.
    """
    guess = _guess_essential(rays_a, rays_b, 2.0 * sigma)
    if guess is None:
        return None
    linearise = partial(_linearise, np.ascontiguousarray(rays_a.T), np.ascontiguousarray(rays_b.T))
    R, t = refine_motion(*guess, linearise, sigma, MAX_REFINEMENTS, CONVERGED_RADIANS)
    inliers = np.abs(epipolar_sines(rays_a, rays_b, R, t)) < INLIER_SIGMAS * sigma
    return TwoViewMotion(R, -R.T @ t, inliers)


def parallax_forward(motion: TwoViewMotion, rays_a: Array, rays_b: Array) -> Array:
    """Sine (n,) of the angle by which each ray turned as that of a standing point does; negative if none turns so.

    From depth_b b = depth_a R a + t, with t = -R direction, follows depth_a = -(b x R a) . (b x t) / |b x R a|^2, whose
    sign is told apart only where the rays turn.
    """
    R, t = motion.R_b_a, -motion.R_b_a @ motion.direction_a
    turned, shift = np.cross(rays_b, rays_a @ R.T), np.cross(rays_b, t)
    return -np.sum(turned * shift, axis=1) / np.maximum(np.linalg.norm(shift, axis=1), 1e-9)


def refine_motion(
    R: Array,
    t: Array,
    linearise: Callable[[Array, Array, Array], tuple[Array, Array]],
    sigma: float,
    rounds: int,
    converged: float,
) -> tuple[Array, Array]:
    """Gauss-Newton on three rotation and two direction parameters with Geman-McClure weights.

    `linearise` gives residuals (n,) and how they change (n, 5) with a turn after R (3, 3) and a step of the unit vector
    t (3,) along the two directions (2, 3) across it.
    """
    for _ in range(rounds):
        across = _across(t)
        residual, jacobian = linearise(R, t, across)
        weighted = jacobian * (1.0 / (1.0 + (residual / sigma) ** 2) ** 2)[:, None]
        step = -np.linalg.pinv(weighted.T @ jacobian, hermitian=True) @ (weighted.T @ residual)
        R, t = Rotation.from_rotvec(step[:3]).as_matrix() @ R, t + step[3:] @ across
        t /= np.linalg.norm(t)
        if np.abs(step).max() < converged:
            break
    return R, t


def epipolar_sines(rays_a: Array, rays_b: Array, R_b_a: Array, t: Array) -> Array:
    """Sine (n,) of the angle of each ray in b to its epipolar plane: b . (t x R a) / |t x R a|."""
    normals = cross_matrix(t) @ R_b_a @ rays_a.T
    return dot_rows(rays_b.T, normals) / np.maximum(np.sqrt(dot_rows(normals, normals)), 1e-9)


def _guess_essential(rays_a: Array, rays_b: Array, threshold: float) -> tuple[Array, Array] | None:
    central = np.minimum(rays_a[:, 2], rays_b[:, 2]) > np.cos(MAX_GUESS_ANGLE)
    if np.count_nonzero(central) < 5:
        return None
    a, b = rays_a[central], rays_b[central]
    essential, _ = cv2.findEssentialMat(
        a[:, :2] / a[:, 2:], b[:, :2] / b[:, 2:], np.eye(3), cv2.RANSAC, GUESS_CONFIDENCE, threshold
    )
    if essential is None:
        return None
    R_first, R_second, t = cv2.decomposeEssentialMat(np.asarray(essential[:3], dtype=np.float64))
    # The two rotations differ by half a turn about the translation; a video never turns that much in a step.
    R = R_first if np.trace(R_first) > np.trace(R_second) else R_second
    return np.asarray(R, dtype=np.float64), np.asarray(t[:, 0], dtype=np.float64)


def _across(t: Array) -> Array:
    """Two directions (2, 3) at right angles to the unit vector t (3,) and to each other."""
    first = cross_matrix(t)[np.argmin(np.abs(t))]
    first /= np.linalg.norm(first)
    return np.stack([first, cross_matrix(t) @ first])


def _linearise(rays_a: Array, rays_b: Array, R: Array, t: Array, across: Array) -> tuple[Array, Array]:
    """Epipolar sines (n,) of rays (3, n), and how they change (n, 5) with a turn after R and a step of t `across` it.

    With p = R a, n = t x p and s = b . n / |n|, ds = g . dn for g = (b - s n / |n|) / |n|. A turn moves n by
    t x (turn x p), so that ds = turn . (p x (g x t)); a step of t moves it by step x p, so that ds = step . (p x g).
    """
    turned, cross_t = R @ rays_a, cross_matrix(t)
    normals = cross_t @ turned
    length = np.maximum(np.sqrt(dot_rows(normals, normals)), 1e-9)
    normals /= length
    sines = dot_rows(rays_b, normals)
    slope = (rays_b - sines * normals) / length
    by_turn, by_step = cross_rows(turned, cross_t.T @ slope), across @ cross_rows(turned, slope)
    return sines, np.concatenate([by_turn, by_step]).T
