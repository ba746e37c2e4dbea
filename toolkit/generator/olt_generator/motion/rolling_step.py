"""The step of a vehicle that rolls: its wheels do not slip sideways, so its turn tells in which direction it moved.

Where most of what is seen moves by itself, or is too far or too blurred to tell the direction of a step, the motion
that agrees with most points may be one that no vehicle can make. Held to what a vehicle can do, the points that stand
still win.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_generator.motion.steps import Step
from olt_generator.motion.two_view import INLIER_SIGMAS, TwoViewMotion, epipolar_sines
from olt_generator.poses import Array

ROUNDS = 12
CONVERGED = 1e-6
DIFFERENCE = 1e-6


def rolling_direction(R_b_a: Array, driven: float, T_rig_camera: Array) -> Array:
    """Unit displacement (3,) of the camera in its first axes when the vehicle turns by R_b_a and its axle rolls so far.

    Over an arc with the turn w about rig z the rear axle moves along the chord, half the turn aside; the camera,
    mounted at q, moves by (R - I) q more.
    """
    R_rig_camera = T_rig_camera[:3, :3]
    turn = R_rig_camera @ R_b_a.T @ R_rig_camera.T
    half = 0.5 * float(np.arctan2(turn[1, 0], turn[0, 0]))
    moved = driven * np.array([np.cos(half), np.sin(half), 0.0]) + (turn - np.eye(3)) @ T_rig_camera[:3, 3]
    return R_rig_camera.T @ moved / np.linalg.norm(moved)


def slip_angle(step: Step, driven: float, T_rig_camera: Array) -> float:
    """Angle in radians from the direction of a step, which holds up to its sign, to that of a vehicle which rolls."""
    direction = rolling_direction(step.motion.R_b_a, driven, T_rig_camera)
    return float(np.arccos(min(abs(step.motion.direction_a @ direction), 1.0)))


def straighten(step: Step, driven: float, T_rig_camera: Array) -> Step:
    """The step with the direction that it would have had if the vehicle, which drove so far, had not turned."""
    forward = np.sign(driven) * T_rig_camera[0, :3]
    turned = rolling_direction(step.motion.R_b_a, driven, T_rig_camera)
    back = Rotation.align_vectors(forward[None], turned[None])[0]
    return replace(step, motion=replace(step.motion, direction_a=back.apply(step.motion.direction_a)))


def roll_step(
    rays_a: Array, rays_b: Array, R_b_a: Array, driven: float, T_rig_camera: Array, sigma: float
) -> TwoViewMotion:
    """The step of a vehicle that turns by R_b_a, with the rays that agree; arguments as of `fit_rolling_step`."""
    direction = rolling_direction(R_b_a, driven, T_rig_camera)
    inliers: NDArray[np.bool_] = np.abs(epipolar_sines(rays_a, rays_b, R_b_a, -R_b_a @ direction)) < (
        INLIER_SIGMAS * sigma
    )
    return TwoViewMotion(R_b_a, direction, inliers)


def fit_rolling_step(
    rays_a: Array, rays_b: Array, driven: float, T_rig_camera: Array, guesses: list[Array], sigma: float
) -> TwoViewMotion:
    """The step of a vehicle that agrees best with most of the rays.

    Args:
        rays_a, rays_b: (n, 3) unit rays of the same points at both ends.
        driven: metres, negative backward.
        T_rig_camera: (4, 4) mounting.
        guesses: rotations R_b_a (3, 3) to start from.
        sigma: angular noise of a ray in radians.
    """

    def sines(R: Array) -> Array:
        return epipolar_sines(rays_a, rays_b, R, -R @ rolling_direction(R, driven, T_rig_camera))

    def cost(R: Array) -> float:
        squares = (sines(R) / sigma) ** 2
        return float(np.sum(squares / (1.0 + squares)))

    R = min((_refine(guess, sines, sigma) for guess in guesses), key=cost)
    return roll_step(rays_a, rays_b, R, driven, T_rig_camera, sigma)


def _refine(R: Array, sines: Callable[[Array], Array], sigma: float) -> Array:
    """Gauss-Newton with Geman-McClure weights; the turn also turns the direction, so differences give the slopes."""
    turns = [Rotation.from_rotvec(turn).as_matrix() for turn in DIFFERENCE * np.eye(3)]
    for _ in range(ROUNDS):
        residual = sines(R)
        jacobian = np.stack([(sines(turn @ R) - residual) / DIFFERENCE for turn in turns], axis=-1)
        weighted = jacobian * (1.0 / (1.0 + (residual / sigma) ** 2) ** 2)[:, None]
        step = -np.linalg.pinv(weighted.T @ jacobian) @ (weighted.T @ residual)
        R = Rotation.from_rotvec(step).as_matrix() @ R
        if np.abs(step).max() < CONVERGED:
            break
    return R
