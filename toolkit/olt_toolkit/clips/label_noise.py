"""The label noise budget: what errors of the recovered trajectory do to the actions that a policy learns.

The policy's labels are accelerations and curvatures at 10 Hz, fitted to poses (`action_space`). Differencing twice over
0.1 s magnifies jitter: positions that err independently by 1 m make the accelerations err by 41 m/s2 rms.

What is expected has three parts:

- the smoother's: true changes that it takes for jitter, and errors that it takes for changes. Both show in what another
  smoothing would change: of white jerk, which `car_motion` takes true changes for, it changes 1/5.6 of what the first
  one lost, and of white errors of speed, as odometry has them, 1/2.8 of what the first one left (integrals of the
  smoother's response 1 / (1 + w^6)). `AGAIN`, their geometric mean, is right for either within 1.4. Where headings are
  hardly smoothed, another smoothing shows nothing, and the smoother's covariance tells their jitter.
- the estimator's, by the covariance of the poses that it found: the difference that it makes to the labels to have
  measured something else that is as likely. This sees the same errors as the smoother from another side, and some that
  smoothing again cannot show; the larger of the two counts.
- that of the scale, which all poses share: accelerations err by its share, and so do curvatures.

Of motion that a data set measured, and that is taken as it is, the noise is estimated by the difference that smoothing
makes to its labels: what no car does. True jerks count too, so that motion without errors shows up to 0.13 m/s2.

What is actual is the difference between the labels of two trajectories, and so holds the jitter of the reference too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.motion.iterated_smoother import STANDSTILL_SPEED
from olt_generator.motion.smoother import SmoothedMotion, smooth_trajectory
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.policy.action_space import physical_actions, trajectory_to_actions
from olt_toolkit.policy.contract import STEP_SECONDS, STEP_US
from olt_toolkit.policy.window import FUTURE_OFFSETS_US, HISTORY_OFFSETS_US

# How many times as much the labels err as smoothing once more changes them.
AGAIN = 4.0
# So many times t0 at most are looked at, spread evenly over the clip: their labels overlap for 6.4 s anyway.
MOST_SAMPLES = 16


@dataclass(frozen=True)
class LabelNoise:
    """Root mean square errors of the labels: acceleration in m/s2, curvature in 1/m."""

    acceleration: float
    curvature: float


@dataclass(frozen=True)
class LabelNoiseBudget:
    """Label noise of one clip, over so many times t0. What could not be measured is None.

    Attributes:
        expected: after smoothing: the larger of what smoother and estimator tell, and that of the scale with it.
        smoother, estimator, scale: the parts; that of the estimator or the scale is None where they do not know it.
        taken_out: difference that the smoothing makes.
        actual, raw: after and before smoothing, against the reference.
    """

    samples: int
    expected: LabelNoise
    smoother: LabelNoise
    estimator: LabelNoise | None
    scale: LabelNoise | None
    taken_out: LabelNoise
    actual: LabelNoise | None
    raw: LabelNoise | None


def measure_label_noise(
    measured: Trajectory,
    motion: SmoothedMotion,
    again: Trajectory,
    reference: Trajectory | None = None,
    scale_sigma: float | None = None,
    as_likely: Sequence[Trajectory] = (),
) -> LabelNoiseBudget | None:
    """What is wrong with the labels of a clip.

    Args:
        measured, motion, again: the trajectory before smoothing, after it, and after the same smoothing once more.
        reference: the true one.
        scale_sigma: relative standard deviation of the metric scale; None where it is not known.
        as_likely: what smoothing makes of other measurements that are as likely as this one; none where it is not known
            how likely they are.

    Returns:
        None where the trajectories have no 7.9 s in common, which one sample needs.
    """
    trajectories = [measured, motion.trajectory, again, *as_likely, *([reference] if reference else [])]
    t0_us = _sample_times(trajectories)
    if len(t0_us) == 0:
        return None
    raw, smooth, twice, *others = (_find_labels(trajectory, t0_us) for trajectory in trajectories)
    true = others.pop() if reference else None
    changed = _compare(twice, smooth)
    smoother = LabelNoise(AGAIN * changed.acceleration, max(AGAIN * changed.curvature, _heading_noise(motion, t0_us)))
    estimator = None if not others else _root_mean_square([_compare(other, smooth) for other in others])
    scale = None if scale_sigma is None else _share(smooth, scale_sigma)
    return LabelNoiseBudget(
        samples=len(t0_us),
        expected=_combine(smoother, estimator or smoother, scale or LabelNoise(0.0, 0.0)),
        smoother=smoother,
        estimator=estimator,
        scale=scale,
        taken_out=_compare(raw, smooth),
        actual=_compare(smooth, true) if true else None,
        raw=_compare(raw, true) if true else None,
    )


def estimate_given_noise(measured: Trajectory) -> LabelNoise | None:
    """The noise of labels that are taken from a motion as it was measured; None where it is too short for a sample."""
    t0_us = _sample_times([measured])
    if len(t0_us) == 0:
        return None
    return _compare(_find_labels(measured, t0_us), _find_labels(smooth_trajectory(measured).trajectory, t0_us))


def _sample_times(trajectories: list[Trajectory]) -> NDArray[np.int64]:
    """Times t0 (m,) at which all trajectories cover history and future, multiples of 0.1 s from the first such time."""
    first = max(int(trajectory.timestamps_us[0]) for trajectory in trajectories) - int(HISTORY_OFFSETS_US[0])
    last = min(int(trajectory.timestamps_us[-1]) for trajectory in trajectories) - int(FUTURE_OFFSETS_US[-1])
    possible = max(0, (last - first) // STEP_US + 1)
    steps = np.linspace(0, possible - 1, min(MOST_SAMPLES, possible)).round().astype(np.int64)
    return first + STEP_US * steps


def _find_labels(trajectory: Trajectory, t0_us: NDArray[np.int64]) -> tuple[Array, Array]:
    """Accelerations (m, 64) in m/s2 and curvatures (m, 64) in 1/m that the policy would be given at times t0 (m,)."""
    start = int(trajectory.timestamps_us[0])
    motion = EgoMotion.from_trajectory(Trajectory(trajectory.timestamps_us - start, trajectory.T_world_rig))
    history, future = motion.around(t0_us - start)
    return physical_actions(
        trajectory_to_actions(history[..., :3, 3], history[..., :3, :3], future[..., :3, 3], future[..., :3, :3])
    )


def _compare(labels: tuple[Array, Array], others: tuple[Array, Array]) -> LabelNoise:
    return LabelNoise(*(float(np.sqrt(np.mean((a - b) ** 2))) for a, b in zip(labels, others, strict=True)))


def _combine(smoother: LabelNoise, estimator: LabelNoise, scale: LabelNoise) -> LabelNoise:
    return LabelNoise(
        _root(max(smoother.acceleration, estimator.acceleration), scale.acceleration),
        _root(max(smoother.curvature, estimator.curvature), scale.curvature),
    )


def _share(labels: tuple[Array, Array], sigma: float) -> LabelNoise:
    return LabelNoise(*(sigma * float(np.sqrt(np.mean(values**2))) for values in labels))


def _root_mean_square(noises: Sequence[LabelNoise]) -> LabelNoise:
    every = np.array([(noise.acceleration, noise.curvature) for noise in noises])
    return LabelNoise(*np.sqrt(np.mean(every**2, axis=0)).tolist())


def _root(*parts: float) -> float:
    return float(np.sqrt(np.sum(np.square(parts))))


def _heading_noise(motion: SmoothedMotion, t0_us: NDArray[np.int64]) -> float:
    """What jitter of the headings does to curvatures k = w / v, in 1/m; at standstill k is 0.

    Labels take the turn rate w from headings a step apart. Where headings are measured well that is better known than
    the rate at one moment, since the rate may change in between; where they are smoothed much the rate is.
    """
    times = motion.trajectory.timestamps_us
    labelled = (times >= t0_us[0]) & (times <= t0_us[-1] + FUTURE_OFFSETS_US[-1])
    forward = motion.trajectory.T_world_rig[labelled, :3, 0]
    speed = np.abs(np.sum(motion.velocity[labelled] * forward, axis=1))
    by_speed = np.where(speed > STANDSTILL_SPEED, 1.0 / np.maximum(speed, STANDSTILL_SPEED), 0.0)
    headings_apart = 2.0 * motion.covariance[labelled, 5, 5] / STEP_SECONDS**2
    turn_rate = np.minimum(motion.rate_covariance[labelled, 5, 5], headings_apart)
    return float(np.sqrt(np.mean(turn_rate * by_speed**2)))
