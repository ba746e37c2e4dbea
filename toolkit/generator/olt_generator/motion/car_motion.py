"""How a car moves: the prior of the smoother, linearised about a motion that is already near.

The rig sits on the rear axle, which neither slips sideways nor lifts off. In the axes of the body

    forward    v' = a, a' = white jerk;
    sideways and up    velocities that return to 0 (Ornstein-Uhlenbeck), small but not nil: tyres slip, springs move,
                       and the rig may be mounted slightly askew;
    turning    w' = white angular acceleration, about each axis;
    pose       T' = T [v, w], on SE(3).

A deviation from the given motion has 13 entries: twist of the pose in body axes (translation, rotation), velocity,
turn rate, forward acceleration.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from olt_generator.motion.kalman import integrator_noise
from olt_generator.poses import Array, invert
from olt_generator.twists import adjoint, exponential, logarithm, right_jacobian

STATES = 13
POSITION, ROTATION, VELOCITY, TURN_RATE, ACCELERATION = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), 12
POSE = slice(0, 6)
FORWARD_SPEED, YAW_RATE = 6, 11
_FORWARD = [POSITION.start, VELOCITY.start, ACCELERATION]


@dataclass(frozen=True)
class CarMotion:
    """Noise densities of the prior, and how wide it is at the first pose.

    Attributes:
        jerk_density: (b,) root spectral density of the forward jerk, m/s3 per root Hz.
        angular_acceleration_density: (b,) the same of the angular acceleration, rad/s2 per root Hz.
        slip_sigma: standard deviation of the velocities sideways and up, m/s.
        slip_seconds: time in which they return to 0.
        initial_sigmas: (13,) standard deviations of the state at the first pose.
    """

    jerk_density: Array
    angular_acceleration_density: Array
    slip_sigma: float
    slip_seconds: float
    initial_sigmas: Array

    def select(self, sequences: NDArray[np.intp]) -> "CarMotion":
        """The prior of these sequences only."""
        return replace(
            self,
            jerk_density=self.jerk_density[sequences],
            angular_acceleration_density=self.angular_acceleration_density[sequences],
        )

    def process_noise(self, seconds: Array) -> Array:
        """Covariances (n, b, 13, 13) of what the noise adds over steps (n, b) in body axes."""
        noise = np.zeros((*seconds.shape, STATES, STATES))
        jerk, turning = self.jerk_density[:, None, None] ** 2, self.angular_acceleration_density[:, None, None] ** 2
        _set_block(noise, _FORWARD, jerk * integrator_noise(seconds, 3))
        for axis in range(3):
            angle_and_rate = [ROTATION.start + axis, TURN_RATE.start + axis]
            _set_block(noise, angle_and_rate, turning * integrator_noise(seconds, 2))
        slip = self.slip_sigma**2 * _ornstein_uhlenbeck_noise(seconds, self.slip_seconds)
        for axis in (1, 2):
            _set_block(noise, [POSITION.start + axis, VELOCITY.start + axis], slip)
        return noise


class BodyMotion(NamedTuple):
    """Poses (n, b, 4, 4), and in body axes velocity (n, b, 3), turn rate (n, b, 3), forward acceleration (n, b)."""

    poses: Array
    velocity: Array
    turn_rate: Array
    acceleration: Array

    def select(self, sequences: NDArray[np.intp]) -> "BodyMotion":
        """The motion of these sequences only."""
        return BodyMotion(*(np.take(values, sequences, axis=1) for values in self))

    def replaced(self, sequences: NDArray[np.intp], other: "BodyMotion") -> "BodyMotion":
        """The motion with these sequences taken from another one, which holds only them."""
        arrays = [values.copy() for values in self]
        for values, new in zip(arrays, other, strict=True):
            values[:, sequences] = new
        return BodyMotion(*arrays)

    def rates(self) -> Array:
        """Velocity, turn rate and acceleration as one array (n, b, 7)."""
        return np.concatenate([self.velocity, self.turn_rate, self.acceleration[..., None]], axis=-1)

    def moved(self, deviation: Array) -> "BodyMotion":
        """The motion with a deviation (n, b, 13) added."""
        return BodyMotion(
            self.poses @ exponential(deviation[..., POSE]),
            self.velocity + deviation[..., VELOCITY],
            self.turn_rate + deviation[..., TURN_RATE],
            self.acceleration + deviation[..., ACCELERATION],
        )


def linearise(motion: BodyMotion, seconds: Array, car: CarMotion) -> tuple[Array, Array]:
    """Transitions (n - 1, b, 13, 13) and offsets (n - 1, b, 13) of the deviations from a motion over steps (n - 1, b).

    With X the given poses and x the twist of a step, a deviation d of the pose becomes
    log(X[k + 1]^-1 X[k] exp(x)) + Ad(exp(-x)) d + J(x) dx, where J is the right Jacobian of SE(3).
    """
    decay = np.exp(-seconds / car.slip_seconds)
    # Ways (n - 1, b, 3) that a unit velocity along each axis goes.
    slipped = car.slip_seconds * (1.0 - decay)
    way = np.stack([seconds, slipped, slipped], axis=-1)
    twist = np.zeros((*seconds.shape, 6))
    twist[..., :3] = motion.velocity[:-1] * way
    twist[..., 0] += 0.5 * motion.acceleration[:-1] * seconds**2
    twist[..., 3:] = motion.turn_rate[:-1] * seconds[..., None]
    step, jacobian = exponential(twist), right_jacobian(twist)

    transitions = np.zeros((*seconds.shape, STATES, STATES))
    transitions[..., POSE, POSE] = adjoint(invert(step))
    transitions[..., POSE, VELOCITY] = jacobian[..., :3] * way[..., None, :]
    transitions[..., POSE, TURN_RATE] = jacobian[..., 3:] * seconds[..., None, None]
    transitions[..., POSE, ACCELERATION] = jacobian[..., 0] * (0.5 * seconds**2)[..., None]
    diagonal = np.arange(POSE.stop, STATES)
    transitions[..., diagonal, diagonal] = 1.0
    transitions[..., VELOCITY.start, ACCELERATION] = seconds
    slip = [VELOCITY.start + 1, VELOCITY.start + 2]
    transitions[..., slip, slip] = decay[..., None]

    offsets = np.zeros((*seconds.shape, STATES))
    offsets[..., POSE] = logarithm(invert(motion.poses[1:]) @ motion.poses[:-1] @ step)
    expected = motion.velocity[:-1].copy()
    expected[..., 0] += motion.acceleration[:-1] * seconds
    expected[..., 1:] *= decay[..., None]
    offsets[..., VELOCITY] = expected - motion.velocity[1:]
    offsets[..., TURN_RATE] = motion.turn_rate[:-1] - motion.turn_rate[1:]
    offsets[..., ACCELERATION] = motion.acceleration[:-1] - motion.acceleration[1:]
    return transitions, offsets


def _set_block(matrices: Array, states: list[int], block: Array) -> None:
    """Set the rows and columns of these states."""
    matrices[..., np.array(states)[:, None], states] = block


def _ornstein_uhlenbeck_noise(seconds: Array, slip_seconds: float) -> Array:
    """Covariances (n, b, 2, 2) of way and velocity after time steps (n, b), of a velocity of unit variance."""
    h = seconds / slip_seconds
    gone = -np.expm1(-h)
    # The closed form loses all digits where h is small: 2 (h - gone) - gone^2 = 2/3 h^3 - 1/2 h^4 + ...
    way = np.where(h < 1e-2, h**3 * (2.0 / 3.0 - 0.5 * h + 7.0 / 30.0 * h**2), 2.0 * (h - gone) - gone**2)
    way, both, velocity = slip_seconds**2 * way, slip_seconds * gone**2, gone * (2.0 - gone)
    return np.stack([way, both, both, velocity], axis=-1).reshape(*seconds.shape, 2, 2)
