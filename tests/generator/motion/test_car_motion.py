"""The linearised motion of a car against differences of the motion itself, roll and pitch included."""

import numpy as np

from olt_generator.motion.car_motion import STATES, BodyMotion, CarMotion, linearise
from olt_generator.poses import camera_pose_in_rig
from olt_generator.twists import exponential

SLIP_SECONDS = 0.8
CAR = CarMotion(np.array([1.0]), np.array([0.1]), 0.1, SLIP_SECONDS, np.ones(STATES))
SECONDS = np.array([[0.3]])


def test_transitions_are_the_derivatives_of_the_motion():
    """Two poses that follow exactly from the rates of the first, and each of its 13 states moved a little."""
    velocity, turn_rate, acceleration = np.array([9.0, 0.4, -0.3]), np.array([0.3, -0.2, 0.5]), 1.2
    h = SECONDS[0, 0]
    decay = np.exp(-h / SLIP_SECONDS)
    way = np.array([h, *2 * [SLIP_SECONDS * (1.0 - decay)]])
    twist = np.concatenate([velocity * way + [0.5 * acceleration * h**2, 0.0, 0.0], turn_rate * h])
    start = camera_pose_in_rig([3.0, -2.0, 1.0], 0.2, -0.3, 0.7)
    poses = np.stack([start, start @ exponential(twist)])[:, None]
    later = velocity * [1.0, decay, decay] + [acceleration * h, 0.0, 0.0]
    motion = BodyMotion(
        poses,
        np.stack([velocity, later])[:, None],
        np.stack([turn_rate, turn_rate])[:, None],
        np.full((2, 1), acceleration),
    )
    transitions, offsets = linearise(motion, SECONDS, CAR)
    np.testing.assert_allclose(offsets, 0.0, atol=1e-12)
    for state in range(STATES):
        deviation = np.zeros((2, 1, STATES))
        deviation[0, 0, state] = 1e-6
        ahead, behind = (linearise(motion.moved(sign * deviation), SECONDS, CAR)[1][0, 0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(transitions[0, 0, :, state], (ahead - behind) / 2e-6, rtol=0.0, atol=1e-7)
