"""The robust estimate against an independent minimization of the cost that its weights stand for."""

import numpy as np
import pytest
from scipy.optimize import minimize

from olt_generator.motion.car_motion import CarMotion
from olt_generator.motion.iterated_smoother import GATE, MeasuredPoses, smooth_poses
from olt_generator.poses import make_pose

COUNT, STEP, SIGMA, JERK = 14, 0.1, 0.05, 2.0
SPEED_SIGMA, ACCELERATION_SIGMA = 20.0, 5.0
INITIAL_SIGMAS = np.array([10.0] * 3 + [0.3] * 3 + [SPEED_SIGMA, 0.1, 0.1] + [1.0] * 3 + [ACCELERATION_SIGMA])


def smoothed_positions(measured: np.ndarray) -> np.ndarray:
    """Positions (n,) along a straight road by the smoother under test."""
    poses = make_pose(np.tile(np.eye(3), (COUNT, 1, 1)), np.stack([measured, 0 * measured, 0 * measured], -1))[:, None]
    sequence = MeasuredPoses(
        np.array([COUNT]), np.full((COUNT - 1, 1), STEP), poses, np.array([[SIGMA] * 3 + [0.01] * 3])
    )
    car = CarMotion(np.array([JERK]), np.array([0.1]), 0.1, 1.0, INITIAL_SIGMAS)
    return smooth_poses(sequence, poses, car)[0].poses[:, 0, 0, 3]


def most_probable_positions(measured: np.ndarray, speed: float) -> np.ndarray:
    """The same by minimizing the cost over the initial state and the jerk of every step.

    A residual of r standard deviations costs r^2 / 2 up to the gate g, and g^2 - g^4 / (2 r^2) beyond it, so that it
    pulls with the force r (g / r)^4.
    """
    F = np.array([[1.0, STEP, STEP**2 / 2.0], [0.0, 1.0, STEP], [0.0, 0.0, 1.0]])
    noise = JERK**2 * np.array(
        [
            [STEP**5 / 20.0, STEP**4 / 8.0, STEP**3 / 6.0],
            [STEP**4 / 8.0, STEP**3 / 3.0, STEP**2 / 2.0],
            [STEP**3 / 6.0, STEP**2 / 2.0, STEP],
        ]
    )
    root = np.linalg.cholesky(noise)

    def positions(variables: np.ndarray) -> np.ndarray:
        state = variables[:3] + np.array([measured[0], speed, 0.0])
        states = [state]
        for innovation in variables[3:].reshape(-1, 3):
            states.append(F @ states[-1] + root @ innovation)
        return np.stack(states)[:, 0]

    def cost(variables: np.ndarray) -> float:
        r = np.abs(positions(variables) - measured) / SIGMA
        outside = np.maximum(r, GATE)
        robust = np.where(r <= GATE, r**2 / 2.0, GATE**2 - GATE**4 / (2.0 * outside**2))
        speed_here, acceleration = variables[1] + speed, variables[2]
        prior = (speed_here / SPEED_SIGMA) ** 2 + (acceleration / ACCELERATION_SIGMA) ** 2
        return float(robust.sum() + 0.5 * prior + 0.5 * np.sum(variables[3:] ** 2))

    found = minimize(cost, np.zeros(3 * COUNT), method="BFGS", options={"gtol": 1e-7, "maxiter": 2000})
    return positions(found.x)


@pytest.mark.parametrize("off", [6.0, 8.0, 12.0])
def test_outliers_pull_with_the_fourth_power_of_the_gate_over_their_residual(off):
    """The tolerance is what the iterations, which stop at steps of 1e-3 sigma, may leave."""
    times = STEP * np.arange(COUNT)
    measured = 5.0 * times + 0.3 * SIGMA * np.sin(7.0 * np.arange(COUNT))
    measured[6] += off * SIGMA
    expected = most_probable_positions(measured, 5.0)
    np.testing.assert_allclose(smoothed_positions(measured), expected, rtol=0.0, atol=4e-3 * SIGMA)


def test_residuals_within_the_gate_weigh_alike():
    """Below the gate the estimate is linear: errors that are halved move it half as far."""
    times = STEP * np.arange(COUNT)
    errors = 0.9 * SIGMA * np.cos(3.0 * np.arange(COUNT))
    exact, half, whole = (smoothed_positions(5.0 * times + share * errors) for share in (0.0, 0.5, 1.0))
    np.testing.assert_allclose(whole - exact, 2.0 * (half - exact), atol=1e-9)
