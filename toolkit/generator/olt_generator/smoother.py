"""Forward Kalman filter and backward Rauch-Tung-Striebel smoother over a trajectory (paper, section 3.2).

Position and rotation follow separate linear models whose highest derivative is white noise, at the trajectory's own,
possibly irregular, times:

    position  p' = v, v' = a, a' = white jerk, for every axis of the world alike;
    rotation  r' = w, w' = white angular acceleration, for every axis of the body alike.

r sums the rotation vectors from pose to pose, so a full turn is as good as none; what the smoother changes in r, a
small rotation, is applied to the measured pose in its own axes. All axes share the model and the noise and so one
covariance: the state of the three axes is one matrix with a column each.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import factorial

from olt_generator.poses import Array, make_pose
from olt_generator.trajectory import Trajectory

Floats = NDArray[np.floating]

# Below this speed in m/s a vehicle counts as standing: its curvature is not defined and is given as 0.
STANDSTILL_SPEED = 0.3


@dataclass(frozen=True)
class MotionModel:
    """One coordinate that is the repeated integral of white noise, and how it is measured.

    Attributes:
        noise_density: square root of the spectral density of the highest derivative's noise.
        measurement_sigma: standard deviation of a measurement of the coordinate itself.
        initial_sigmas: standard deviations of the derivatives at the first time, about 0; their number is the
            order of the model.
    """

    noise_density: float
    measurement_sigma: float
    initial_sigmas: tuple[float, ...]

    @property
    def states(self) -> int:
        """The coordinate and its derivatives."""
        return 1 + len(self.initial_sigmas)

    def transition(self, seconds: Array) -> Array:
        """Taylor matrices (n, states, states) over time steps (n,)."""
        power = np.arange(self.states) - np.arange(self.states)[:, None]
        taylor = seconds[:, None, None] ** np.maximum(power, 0) / factorial(np.maximum(power, 0))
        return np.where(power >= 0, taylor, 0.0)

    def process_noise(self, seconds: Array) -> Array:
        """Covariances (n, states, states) of what the white noise adds over time steps (n,): integral of F g g' F'."""
        power = np.arange(self.states - 1, -1, -1)
        total = power[:, None] + power[None, :] + 1
        scale = 1.0 / (total * np.outer(factorial(power), factorial(power)))
        return self.noise_density**2 * scale * seconds[:, None, None] ** total

    def initial_covariance(self) -> Array:
        """Covariance (states, states) after the first measurement."""
        return np.diag(np.square([self.measurement_sigma, *self.initial_sigmas]))


@dataclass(frozen=True)
class SmootherSettings:
    """Noise of the measured poses and of the motion itself.

    The defaults suit a car seen by visual odometry at 10 to 30 Hz: measurements wander by a few centimetres, ride
    comfort keeps jerk near 1 m/s3 for about a second, and a body turns with few tenths of rad/s2.

    Attributes:
        position_sigma: standard deviation of a measured position, m, per axis.
        rotation_sigma: standard deviation of a measured rotation, rad, per axis.
        jerk_density: root spectral density of the jerk, m/s3 per root Hz.
        angular_acceleration_density: root spectral density of the angular acceleration, rad/s2 per root Hz.
        initial_speed_sigma, initial_acceleration_sigma: spread of the motion at the first pose about rest, m/s, m/s2.
        initial_turn_rate_sigma: the same for the turn rate, rad/s.
    """

    position_sigma: float = 0.05
    rotation_sigma: float = 0.0005
    jerk_density: float = 1.0
    angular_acceleration_density: float = 0.1
    initial_speed_sigma: float = 100.0
    initial_acceleration_sigma: float = 5.0
    initial_turn_rate_sigma: float = 1.0

    @property
    def position_model(self) -> MotionModel:
        """Constant acceleration disturbed by white jerk."""
        initial = (self.initial_speed_sigma, self.initial_acceleration_sigma)
        return MotionModel(self.jerk_density, self.position_sigma, initial)

    @property
    def rotation_model(self) -> MotionModel:
        """Constant turn rate disturbed by white angular acceleration."""
        return MotionModel(self.angular_acceleration_density, self.rotation_sigma, (self.initial_turn_rate_sigma,))


@dataclass(frozen=True)
class SmoothedMotion:
    """A smoothed trajectory and its derivatives.

    Attributes:
        trajectory: smoothed poses at the times of the measured ones.
        velocity: (n, 3) m/s in world axes.
        acceleration: (n, 3) m/s2 in world axes.
        curvature: (n,) 1/m, turn rate about the rig's z axis over forward speed; positive to the left, 0 at standstill.
    """

    trajectory: Trajectory
    velocity: Array
    acceleration: Array
    curvature: Array


@dataclass(frozen=True)
class FilterPass:
    """States (n, states, axes) and covariances (n, states, states) of the forward pass.

    `predicted` holds what was expected at each time before its measurement, `filtered` what was known after it;
    `transitions[k]` leads from time k - 1 to time k.
    """

    transitions: Floats
    predicted: Floats
    predicted_covariance: Floats
    filtered: Floats
    filtered_covariance: Floats

    def part(self, start: int, stop: int) -> "FilterPass":
        """The pass over the times start to stop - 1."""
        window = slice(start, stop)
        return FilterPass(
            self.transitions[window],
            self.predicted[window],
            self.predicted_covariance[window],
            self.filtered[window],
            self.filtered_covariance[window],
        )


def smooth_trajectory(trajectory: Trajectory, settings: SmootherSettings | None = None) -> SmoothedMotion:
    """Remove jitter from a trajectory, using all of it for every pose.

    Args:
        trajectory: measured poses.
        settings: noise levels; None for the defaults.
    """
    settings = settings or SmootherSettings()
    origin = trajectory.positions[0]
    position = smooth(trajectory.times, trajectory.positions - origin, settings.position_model).astype(np.float64)
    measured = Rotation.from_matrix(trajectory.T_world_rig[:, :3, :3])
    steps = (measured[:-1].inv() * measured[1:]).as_rotvec()
    summed = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    rotation = smooth(trajectory.times, summed, settings.rotation_model).astype(np.float64)
    smoothed = (measured * Rotation.from_rotvec(rotation[:, 0] - summed)).as_matrix()
    poses = make_pose(smoothed, position[:, 0] + origin)
    curvature = _curvature(rotation[:, 1, 2], np.einsum("ni,ni->n", position[:, 1], smoothed[:, :, 0]))
    return SmoothedMotion(Trajectory(trajectory.timestamps_us, poses), position[:, 1], position[:, 2], curvature)


def smooth(times: Array, measurements: Floats, model: MotionModel) -> Floats:
    """Smoothed states (n, states, axes): each coordinate and its derivatives at every time.

    Args:
        times: (n,) seconds, increasing.
        measurements: (n, axes) coordinates.
        model: the motion of every axis.
    """
    return smooth_backward(filter_forward(times, measurements, model))


def filter_forward(times: Array, measurements: Floats, model: MotionModel) -> FilterPass:
    """Kalman filter, in the floating-point type of the measurements; covariances are updated in Joseph's form."""
    n, states, kind = len(times), model.states, measurements.dtype
    seconds = np.diff(times, prepend=times[0])
    transitions, noise = model.transition(seconds).astype(kind), model.process_noise(seconds).astype(kind)
    predicted, filtered = np.zeros((2, n, states, measurements.shape[1]), dtype=kind)
    predicted_covariance, covariance = np.zeros((2, n, states, states), dtype=kind)
    filtered[0, 0] = predicted[0, 0] = measurements[0]
    covariance[0] = predicted_covariance[0] = model.initial_covariance()
    for k in range(1, n):
        F = transitions[k]
        predicted[k] = F @ filtered[k - 1]
        predicted_covariance[k] = F @ covariance[k - 1] @ F.T + noise[k]
        gain = predicted_covariance[k][:, :1] / (predicted_covariance[k][0, 0] + model.measurement_sigma**2)
        filtered[k] = predicted[k] + gain * (measurements[k] - predicted[k][0])
        keep = np.eye(states, dtype=kind)
        keep[:, :1] -= gain
        covariance[k] = keep @ predicted_covariance[k] @ keep.T + model.measurement_sigma**2 * gain @ gain.T
    return FilterPass(transitions, predicted, predicted_covariance, filtered, covariance)


def smooth_backward(forward: FilterPass) -> Floats:
    """Rauch-Tung-Striebel pass: states (n, states, axes) given all measurements of the forward pass."""
    smoothed = forward.filtered.copy()
    cross = forward.transitions[1:] @ forward.filtered_covariance[:-1]
    gains = np.swapaxes(np.linalg.solve(forward.predicted_covariance[1:], cross), -1, -2)
    for k in range(len(smoothed) - 2, -1, -1):
        smoothed[k] += gains[k] @ (smoothed[k + 1] - forward.predicted[k + 1])
    return smoothed


def _curvature(turn_rate: Array, forward_speed: Array) -> Array:
    moving = np.abs(forward_speed) > STANDSTILL_SPEED
    return np.where(moving, turn_rate / np.where(moving, forward_speed, 1.0), 0.0)
