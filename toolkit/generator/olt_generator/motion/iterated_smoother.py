"""The most probable motion of a car for sequences of measured poses: an iterated Kalman smoother on SE(3).

The system is linearised about the current motion, filtered forward, smoothed backward, and linearised anew at the
result (Bell, SIAM Journal on Optimization 1994: the Gauss-Newton method). Residuals beyond the gate lose weight from
one iteration to the next: at first such that a measurement pulls with the same force however far off it is, which has
no wrong minima, then such that it hardly pulls at all.

Arrays are time-major: n times at most, b sequences of falling length, filled up behind their ends with anything finite.
No sequence's result depends on the others.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.motion.car_motion import FORWARD_SPEED, POSE, YAW_RATE, BodyMotion, CarMotion, linearise
from olt_generator.motion.kalman import LinearSystem, filter_forward, smooth_covariances, smooth_states, smoothing_gains
from olt_generator.poses import Array
from olt_generator.twists import vector_from_rotation

Flags = NDArray[np.bool_]

# Residuals of so many standard deviations are still normal: among Gaussian ones of three axes, 1 in 16,000 is larger.
GATE = 4.7
# Below this weight a measurement is reported as an outlier, and this much weight every measurement keeps.
OUTLIER_WEIGHT, LEAST_WEIGHT = 0.1, 1e-8
CONVEX_ITERATIONS, MOST_ITERATIONS = 2, 12
# Converged when no pose moves by more than this share of its measurement's standard deviation.
TOLERANCE = 1e-3

# A standstill lasts at least so long; its ends, where the vehicle may still or already roll, are not held.
STANDSTILL_SECONDS, STANDSTILL_MARGIN_SECONDS = 1.0, 0.2
# Vehicles that are faster (m/s, rad/s) do not stand, however uncertain the speed.
STANDSTILL_SPEED, STANDSTILL_YAW_RATE = 0.3, 0.05
# Standard deviations within which speed, turn rate and place of a standing vehicle stay.
STANDSTILL_GATE = 3.0
# What still moves in a held standstill: standard deviation of the rates, and share of the process noise.
_HELD_RATE_SIGMA, _HELD_NOISE = 1e-6, 1e-12
_NOT_MEASURED_SIGMA = 1e6


@dataclass(frozen=True)
class MeasuredPoses:
    """Sequences of poses with independent noise.

    Attributes:
        lengths: (b,) poses of each sequence, falling.
        seconds: (n - 1, b) time steps.
        poses: (n, b, 4, 4), near the origin for the digits' sake.
        sigmas: (b, 6) standard deviations of position (m) and rotation (rad) in body axes.
    """

    lengths: NDArray[np.int64]
    seconds: Array
    poses: Array
    sigmas: Array

    def select(self, sequences: NDArray[np.intp]) -> "MeasuredPoses":
        """Only these sequences."""
        return MeasuredPoses(
            self.lengths[sequences],
            np.take(self.seconds, sequences, axis=1),
            np.take(self.poses, sequences, axis=1),
            self.sigmas[sequences],
        )


def smooth_poses(measured: MeasuredPoses, start: Array, car: CarMotion) -> tuple[BodyMotion, Array, Flags, Flags]:
    """Smooth all sequences, then once more those in which the vehicle stands, with the standstills held.

    Starts from poses (n, b, 4, 4) without gross outliers in rotation.

    Returns:
        The most probable motion; covariances (n, b, 13, 13) of the deviations from it (`car_motion`); the poses (n, b)
        whose measured position or rotation was not believed; and those (n, b) at which the vehicle stands: all of a
        standstill have the same pose and no rates.
    """
    moving = np.zeros(start.shape[:2], dtype=np.bool_)
    rest = np.zeros((*start.shape[:2], 3))
    motion = _iterate(measured, BodyMotion(start, rest, rest, rest[..., 0]), moving, car, convex=CONVEX_ITERATIONS)
    motion, covariances = _finish(measured, motion, moving, car)
    standing = find_standstills(measured, motion, covariances)
    stops = np.flatnonzero(standing.any(axis=0))
    if len(stops) > 0:
        part, held = measured.select(stops), standing[:, stops]
        stopped = _iterate(part, motion.select(stops), held, car.select(stops), convex=0)
        stopped, covariances[:, stops] = _finish(part, stopped, held, car.select(stops))
        # The last rounding errors are taken out of the standstills.
        poses, still = stopped.poses.copy(), ~held[..., None]
        for sequence in range(len(stops)):
            for first, last in _runs(held[:, sequence]):
                poses[first : last + 1, sequence] = poses[first, sequence]
        rates = stopped.velocity * still, stopped.turn_rate * still, stopped.acceleration * still[..., 0]
        motion = motion.replaced(stops, BodyMotion(poses, *rates))
    outliers = np.min(_weights(measured, motion, convex=False), axis=-1) < OUTLIER_WEIGHT
    return motion, covariances, outliers, standing


def find_standstills(measured: MeasuredPoses, motion: BodyMotion, covariances: Array) -> Flags:
    """Poses (n, b) at which the vehicle stands, as far as the noise lets one see."""
    sigmas = np.sqrt(np.diagonal(covariances, axis1=-2, axis2=-1))
    slow = np.abs(motion.velocity[..., 0]) < np.minimum(STANDSTILL_GATE * sigmas[..., FORWARD_SPEED], STANDSTILL_SPEED)
    turn_gate = np.minimum(STANDSTILL_GATE * sigmas[..., YAW_RATE], STANDSTILL_YAW_RATE)
    slow &= np.abs(motion.turn_rate[..., 2]) < turn_gate
    standing = np.zeros_like(slow)
    for sequence in np.flatnonzero(slow.any(axis=0)).tolist():
        length = int(measured.lengths[sequence])
        times = np.concatenate([[0.0], np.cumsum(measured.seconds[: length - 1, sequence])])
        for first, last in _runs(slow[:length, sequence]):
            span = slice(first, last + 1)
            places = motion.poses[span, sequence, :3, 3]
            spread = np.linalg.norm(places - places.mean(axis=0), axis=1)
            stays = np.all(spread < STANDSTILL_GATE * sigmas[span, sequence, :3].max(axis=1))
            if stays and times[last] - times[first] >= STANDSTILL_SECONDS:
                # Margins are where the run does not reach the end of the sequence.
                before = STANDSTILL_MARGIN_SECONDS if first > 0 else 0.0
                behind = STANDSTILL_MARGIN_SECONDS if last < length - 1 else 0.0
                standing[:length, sequence] |= (times >= times[first] + before) & (times <= times[last] - behind)
    return standing


def _iterate(measured: MeasuredPoses, motion: BodyMotion, standing: Flags, car: CarMotion, convex: int) -> BodyMotion:
    """Improve each sequence until it has converged, the first iterations with convex weights."""
    active = np.arange(len(measured.lengths))
    for iteration in range(MOST_ITERATIONS):
        part, current, prior = measured.select(active), motion.select(active), car.select(active)
        system = linear_system(part, current, standing[:, active], prior, iteration < convex)
        forward = filter_forward(system)
        change = smooth_states(system, forward, smoothing_gains(system, forward))[..., 0]
        motion = motion.replaced(active, current.moved(change))
        moves = np.max(np.abs(change[..., POSE]) / part.sigmas, axis=(0, 2))
        active = active[(moves > TOLERANCE) | (iteration < convex)]
        if len(active) == 0:
            break
    return motion


def _finish(measured: MeasuredPoses, motion: BodyMotion, standing: Flags, car: CarMotion) -> tuple[BodyMotion, Array]:
    """One more improvement, and the covariances (n, b, 13, 13)."""
    system = linear_system(measured, motion, standing, car, convex=False)
    forward = filter_forward(system)
    gains = smoothing_gains(system, forward)
    moved = motion.moved(smooth_states(system, forward, gains)[..., 0])
    return moved, smooth_covariances(system, forward, gains)


def linear_system(
    measured: MeasuredPoses, motion: BodyMotion, standing: Flags, car: CarMotion, convex: bool
) -> LinearSystem:
    """The system of the deviations (13 states, `car_motion`) from a motion, with rates of 0 where `standing` (n, b).

    With convex weights outliers still pull, as they must while the motion may be far off.
    """
    transitions, offsets = linearise(motion, measured.seconds, car)
    noise, rates = car.process_noise(measured.seconds), motion.rates()
    residuals = _residuals(measured, motion)
    variances = measured.sigmas**2 / _weights(measured, motion, convex)
    if standing.any():
        noise[standing[1:] & standing[:-1]] *= _HELD_NOISE
        sigma = np.where(standing, _HELD_RATE_SIGMA, _NOT_MEASURED_SIGMA)[..., None]
        residuals = np.concatenate([residuals, -rates], axis=-1)
        variances = np.concatenate([variances, np.broadcast_to(sigma**2, rates.shape)], axis=-1)
    return LinearSystem(
        lengths=measured.lengths,
        transitions=transitions,
        offsets=offsets[..., None],
        process_noise=noise,
        initial_state=np.concatenate([np.zeros((len(measured.lengths), 6)), -rates[0]], axis=-1)[..., None],
        initial_covariance=np.tile(np.diag(car.initial_sigmas**2), (len(measured.lengths), 1, 1)),
        measurements=residuals[..., None],
        measurement_noise=variances,
    )


def _residuals(measured: MeasuredPoses, motion: BodyMotion) -> Array:
    """What was measured, seen from the motion: translations and rotation vectors (n, b, 6) in body axes."""
    R_body_world = np.swapaxes(motion.poses[..., :3, :3], -1, -2)
    translation = R_body_world @ (measured.poses[..., :3, 3:] - motion.poses[..., :3, 3:])
    rotation = vector_from_rotation(R_body_world @ measured.poses[..., :3, :3])
    return np.concatenate([translation[..., 0], rotation], axis=-1)


def _weights(measured: MeasuredPoses, motion: BodyMotion, convex: bool) -> Array:
    """Weights (n, b, 6); position and rotation of a pose are judged apart."""
    scaled = (_residuals(measured, motion) / measured.sigmas).reshape(*motion.poses.shape[:2], 2, 3)
    weight = GATE / np.maximum(np.sqrt(np.sum(scaled**2, axis=-1)), GATE)
    return np.repeat(np.maximum(weight if convex else weight**4, LEAST_WEIGHT), 3, axis=-1)


def _runs(flags: Flags) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return [(first, last - 1) for first, last in edges.reshape(-1, 2).tolist()]
