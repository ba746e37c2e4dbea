"""Errors and smoothness of a trajectory: the pose table of the paper, in both of its protocols.

Metric protocol: the estimate is moved so that its first pose equals the reference's; its scale is kept.
Sim(3) protocol: the estimate's positions are laid on the reference's by the similarity of least squares (Umeyama,
PAMI 1991), which takes out position, rotation and scale.

Relative errors are taken from frame to frame, as the size of the paper's figures (0.13 degrees, 23 percent) says. The
translation error of a step is in percent of the step's true length; steps below 1 cm are left out.
"""

from dataclasses import asdict, dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from olt_generator.errors import InputError
from olt_generator.poses import Array, invert
from olt_generator.trajectory import Trajectory

MIN_STEP_METRES = 0.01


@dataclass(frozen=True)
class Smoothness:
    """Smoothness of positions over time, from differences between successive frames; None where not defined.

    Attributes:
        jerk_rms_m_s3: root mean square of the third time derivative (4 poses or more). The paper prints no unit; the
            ratio of its jerk to its acceleration variance is that of a mean square, so its factors compare with the
            square of a factor here.
        acceleration_variance_m2_s4: variance of the acceleration, summed over the axes (3 poses or more).
        log_dimensionless_jerk: -ln(integral of |jerk|^2 dt * duration^3 / peak speed^2); higher is smoother
            (Balasubramanian et al., IEEE TBME 2012). None without motion or without jerk.
    """

    jerk_rms_m_s3: float | None
    acceleration_variance_m2_s4: float | None
    log_dimensionless_jerk: float | None

    @property
    def squared_jerk(self) -> float | None:
        """Mean square of the jerk, m2/s6, as the paper tabulates it."""
        return None if self.jerk_rms_m_s3 is None else self.jerk_rms_m_s3**2


@dataclass(frozen=True)
class MetricErrors:
    """Errors with the first poses aligned and the scale kept; names of the paper's columns in brackets.

    Attributes:
        ate_m: root mean square position error (ATE).
        rotation_to_first_deg: mean error of the rotation relative to the first pose (RotErr).
        step_rotation_deg: mean rotation error from frame to frame (RPE-r).
        step_translation_percent: mean translation error from frame to frame over true step length (RPE-t); None
            where the reference never moves.
        drift_percent: error of the last position over the length of the reference path; None likewise.
        smoothness: of the estimate (Jerk, Acc.Var, LDJ).
    """

    ate_m: float
    rotation_to_first_deg: float
    step_rotation_deg: float
    step_translation_percent: float | None
    drift_percent: float | None
    smoothness: Smoothness


@dataclass(frozen=True)
class AlignedErrors:
    """Errors after Sim(3) alignment; names of the paper's columns in brackets.

    Attributes:
        scale: factor that the alignment applies to the estimate.
        ate_m: root mean square position error (ATE).
        rotation_to_first_deg: as in `MetricErrors` (RotAnc).
        step_rotation_deg: as in `MetricErrors` (RotErr).
        step_translation_percent: as in `MetricErrors`, after scaling (TrErr).
        smoothness: of the scaled estimate (Jerk, Acc.Var).
    """

    scale: float
    ate_m: float
    rotation_to_first_deg: float
    step_rotation_deg: float
    step_translation_percent: float | None
    smoothness: Smoothness


@dataclass(frozen=True)
class PoseErrors:
    """Errors of an estimate at so many `poses` in both protocols; `sim3` is None where either does not move."""

    poses: int
    metric: MetricErrors
    sim3: AlignedErrors | None

    def to_dict(self) -> dict[str, object]:
        """Nested plain values; keys carry the units."""
        return asdict(self)


def compare_trajectories(estimate: Trajectory, reference: Trajectory) -> PoseErrors:
    """Errors of `estimate` at its own times as far as `reference`, which is interpolated, covers them.

    Raises:
        InputError: fewer than two common times.
    """
    times = estimate.timestamps_us
    common = (times >= reference.timestamps_us[0]) & (times <= reference.timestamps_us[-1])
    if np.count_nonzero(common) < 2:
        raise InputError(
            f"pose errors: only {np.count_nonzero(common)} estimated poses lie in the time of the reference, 2 are "
            "needed; check that both use one clock"
        )
    found = Trajectory(times[common], estimate.T_world_rig[common]).in_first_frame()
    true = Trajectory(times[common], reference.interpolate(times[common])).in_first_frame()
    last_error = float(np.linalg.norm(found.positions[-1] - true.positions[-1]))
    metric = MetricErrors(
        _root_mean_square(found.positions - true.positions),
        *_relative_errors(found, true),
        100.0 * last_error / true.path_length if true.path_length > MIN_STEP_METRES else None,
        measure_smoothness(found),
    )
    return PoseErrors(len(found), metric, _aligned_errors(found, true))


def measure_smoothness(trajectory: Trajectory) -> Smoothness:
    """Smoothness of a trajectory's positions at its own, possibly irregular, times."""
    times, velocity = _differentiate(trajectory.times, trajectory.positions)
    peak_speed = float(np.linalg.norm(velocity, axis=1).max(initial=0.0))
    times, acceleration = _differentiate(times, velocity)
    times, jerk = _differentiate(times, acceleration)
    squared_jerk = float(np.mean(np.sum(jerk**2, axis=1))) if len(jerk) else None
    duration = float(trajectory.times[-1])
    defined = squared_jerk is not None and squared_jerk > 0.0 and peak_speed > 0.0
    return Smoothness(
        None if squared_jerk is None else float(np.sqrt(squared_jerk)),
        float(acceleration.var(axis=0).sum()) if len(acceleration) else None,
        -float(np.log(squared_jerk * duration**4 / peak_speed**2)) if squared_jerk and defined else None,
    )


def align_similarity(points: Array, reference: Array) -> tuple[float, Array, Array] | None:
    """Scale, rotation (3, 3) and translation (3,) that lay points (n, 3) on the reference with least squares.

    Returns None where either set is a single place, so that no scale exists. Umeyama (1991), equations 40 to 43.
    """
    centre, centre_reference = points.mean(axis=0), reference.mean(axis=0)
    spread, spread_reference = points - centre, reference - centre_reference
    variance = float(np.sum(spread**2))
    U, singular, Vt = np.linalg.svd(spread_reference.T @ spread)
    if variance == 0.0 or singular[0] == 0.0:
        return None
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    rotation = (U * signs) @ Vt
    scale = float(singular @ signs) / variance
    return scale, rotation, centre_reference - scale * rotation @ centre


def _aligned_errors(found: Trajectory, true: Trajectory) -> AlignedErrors | None:
    alignment = align_similarity(found.positions, true.positions)
    if alignment is None:
        return None
    scale, rotation, translation = alignment
    scaled_poses = found.T_world_rig.copy()
    scaled_poses[:, :3, 3] *= scale
    scaled = Trajectory(found.timestamps_us, scaled_poses)
    missed = scaled.positions @ rotation.T + translation - true.positions
    return AlignedErrors(scale, _root_mean_square(missed), *_relative_errors(scaled, true), measure_smoothness(scaled))


def _relative_errors(found: Trajectory, true: Trajectory) -> tuple[float, float, float | None]:
    """Mean errors: of the rotation to the first pose and of each step (degrees), and of its translation (percent)."""
    steps, true_steps = (invert(each.T_world_rig[:-1]) @ each.T_world_rig[1:] for each in (found, true))
    length = np.linalg.norm(true_steps[:, :3, 3], axis=1)
    moves = length >= MIN_STEP_METRES
    error = np.linalg.norm(steps[:, :3, 3] - true_steps[:, :3, 3], axis=1)
    return (
        _mean_angle(found.T_world_rig[1:], true.T_world_rig[1:]),
        _mean_angle(steps, true_steps),
        100.0 * float(np.mean(error[moves] / length[moves])) if moves.any() else None,
    )


def _mean_angle(found: Array, true: Array) -> float:
    difference = Rotation.from_matrix(true[:, :3, :3]).inv() * Rotation.from_matrix(found[:, :3, :3])
    return float(np.degrees(difference.magnitude()).mean())


def _root_mean_square(difference: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


def _differentiate(times: Array, values: Array) -> tuple[Array, Array]:
    """Differences (n - 1, 3) of values (n, 3) over time, and the middle times they belong to."""
    return 0.5 * (times[1:] + times[:-1]), np.diff(values, axis=0) / np.diff(times)[:, None]
