"""The label noise budget: what errors of the recovered trajectory do to the actions that a policy learns.

The policy's labels are accelerations and curvatures at 10 Hz, fitted to poses (`action_space`). Differencing twice over
0.1 s magnifies jitter: positions that err independently by 1 m make the accelerations err by 41 m/s2 rms.

What is expected has three parts, which err independently:

- the smoother's, by its own covariance: true changes that it takes for jitter, and jitter that it takes for changes;
- the estimator's, by the covariance of the poses that it found: what hangs together in time passes the smoother. It is
  the difference that it makes to the labels to have measured something else that is as likely;
- that of the scale, which all poses share: accelerations err by its share, and so do curvatures.

What is actual is the difference between the labels of two trajectories, and so holds the jitter of the reference too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.motion.iterated_smoother import STANDSTILL_SPEED
from olt_generator.motion.smoother import SmoothedMotion
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.policy.action_space import physical_actions, trajectory_to_actions
from olt_toolkit.policy.contract import STEP_SECONDS, STEP_US
from olt_toolkit.policy.window import FUTURE_OFFSETS_US, HISTORY_OFFSETS_US

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
        expected: after smoothing: all of the three parts that are known.
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
    reference: Trajectory | None = None,
    scale_sigma: float | None = None,
    as_likely: Sequence[Trajectory] = (),
) -> LabelNoiseBudget | None:
    """What is wrong with the labels of a clip.

    Args:
        measured, motion: the trajectory before smoothing and after it.
        reference: the true one.
        scale_sigma: relative standard deviation of the metric scale; None where it is not known.
        as_likely: what smoothing makes of other measurements that are as likely as this one; none where it is not known
            how likely they are.

    Returns:
        None where the trajectories have no 7.9 s in common, which one sample needs.
    """
    trajectories = [measured, motion.trajectory, *as_likely, *([reference] if reference else [])]
    t0_us = _sample_times(trajectories)
    if len(t0_us) == 0:
        return None
    raw, smooth, *others = (_find_labels(trajectory, t0_us) for trajectory in trajectories)
    true = others.pop() if reference else None
    parts = [
        _expect_noise(motion, t0_us),
        _root_mean_square([_compare(other, smooth) for other in others]) if others else None,
        None if scale_sigma is None else _scaled(smooth, scale_sigma),
    ]
    return LabelNoiseBudget(
        samples=len(t0_us),
        expected=_root_of_sum([part for part in parts if part is not None]),
        smoother=_expect_noise(motion, t0_us),
        estimator=parts[1],
        scale=parts[2],
        taken_out=_compare(raw, smooth),
        actual=_compare(smooth, true) if true else None,
        raw=_compare(raw, true) if true else None,
    )


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


def _scaled(labels: tuple[Array, Array], sigma: float) -> LabelNoise:
    return LabelNoise(*(sigma * float(np.sqrt(np.mean(values**2))) for values in labels))


def _root_of_sum(parts: Sequence[LabelNoise]) -> LabelNoise:
    return LabelNoise(
        float(np.sqrt(sum(part.acceleration**2 for part in parts))),
        float(np.sqrt(sum(part.curvature**2 for part in parts))),
    )


def _root_mean_square(parts: Sequence[LabelNoise]) -> LabelNoise:
    total = _root_of_sum(parts)
    return LabelNoise(total.acceleration / len(parts) ** 0.5, total.curvature / len(parts) ** 0.5)


def _expect_noise(motion: SmoothedMotion, t0_us: NDArray[np.int64]) -> LabelNoise:
    """Linearised: the curvature k = w / v of turn rate w and speed v errs by (dw - k dv) / v; at standstill k is 0.

    Labels take the turn rate from headings a step apart. That is better known than the rate at one moment where
    headings are measured well, since the rate may change in between.
    """
    times = motion.trajectory.timestamps_us
    labelled = (times >= t0_us[0]) & (times <= t0_us[-1] + FUTURE_OFFSETS_US[-1])
    rates, poses = motion.rate_covariance[labelled], motion.covariance[labelled]
    curvature, forward = motion.curvature[labelled], motion.trajectory.T_world_rig[labelled, :3, 0]
    speed = np.abs(np.sum(motion.velocity[labelled] * forward, axis=1))
    by_speed = np.where(speed > STANDSTILL_SPEED, 1.0 / np.maximum(speed, STANDSTILL_SPEED), 0.0)
    turn_rate = np.minimum(rates[:, 5, 5], 2.0 * poses[:, 5, 5] / STEP_SECONDS**2)
    variance = (turn_rate + curvature**2 * rates[:, 0, 0]) * by_speed**2
    return LabelNoise(float(np.sqrt(np.mean(rates[:, 6, 6]))), float(np.sqrt(np.mean(variance))))


def _scaled(labels: tuple[Array, Array], sigma: float) -> LabelNoise:
    return LabelNoise(*(sigma * float(np.sqrt(np.mean(values**2))) for values in labels))


def _root_of_sum(parts: Sequence[LabelNoise]) -> LabelNoise:
    return LabelNoise(
        float(np.sqrt(sum(part.acceleration**2 for part in parts))),
        float(np.sqrt(sum(part.curvature**2 for part in parts))),
    )


def _root_mean_square(parts: Sequence[LabelNoise]) -> LabelNoise:
    total = _root_of_sum(parts)
    return LabelNoise(total.acceleration / len(parts) ** 0.5, total.curvature / len(parts) ** 0.5)


def _expect_noise(motion: SmoothedMotion, t0_us: NDArray[np.int64]) -> LabelNoise:
    """Linearised: the curvature k = w / v of turn rate w and speed v errs by (dw - k dv) / v; at standstill k is 0."""
    times = motion.trajectory.timestamps_us
    labelled = (times >= t0_us[0]) & (times <= t0_us[-1] + FUTURE_OFFSETS_US[-1])
    covariance, curvature = motion.rate_covariance[labelled], motion.curvature[labelled]
    forward = motion.trajectory.T_world_rig[labelled, :3, 0]
    speed = np.sum(motion.velocity[labelled] * forward, axis=1)
    by_speed = np.where(np.abs(speed) > STANDSTILL_SPEED, 1.0 / np.maximum(np.abs(speed), STANDSTILL_SPEED), 0.0)
    variance = covariance[:, 5, 5] - 2.0 * curvature * covariance[:, 0, 5] + curvature**2 * covariance[:, 0, 0]
    return LabelNoise(float(np.sqrt(np.mean(covariance[:, 6, 6]))), float(np.sqrt(np.mean(variance * by_speed**2))))
