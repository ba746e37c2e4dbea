"""A motion that was measured and smoothed, how far it may be off, and how far it is from the reference where known."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from olt_generator.camera_spread import CameraSpread
from olt_generator.doubts import Doubt
from olt_generator.motion.pose_metrics import PoseErrors, Smoothness, compare_trajectories, measure_smoothness
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.motion.smoother import SmoothedMotion, smooth_trajectories, smooth_trajectory
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import EgoMotion, NoiseBasis
from olt_toolkit.clips.label_noise import LabelNoiseBudget, measure_label_noise
from olt_toolkit.clips.motion_uncertainty import ScaleUncertainty, draw_estimates, total_covariance

# Estimates as likely as the one that was found, by which the estimator's share of the label noise is told to a sixth.
DRAWS = 16


@dataclass(frozen=True)
class RecoveredMotion:
    """A motion before and after smoothing. What is derived is found when first asked for; what cannot be is None.

    Attributes:
        estimate: as it was measured.
        smoothed: the same after smoothing.
        spread: how well height and focal length of the camera are known.
        reference: the true trajectory on the same clock, where one is known.
        seen: what the reader of the recording had doubts about.
    """

    estimate: PoseEstimate
    smoothed: SmoothedMotion
    spread: CameraSpread
    reference: Trajectory | None
    seen: tuple[Doubt, ...] = ()

    @property
    def measured(self) -> Trajectory:
        """The trajectory before smoothing."""
        return self.estimate.trajectory

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """Why the motion may be another one: what the reader saw and what the estimator saw."""
        return tuple(dict.fromkeys((*self.seen, *self.estimate.doubts)))

    @property
    def scale(self) -> ScaleUncertainty:
        """How well the metric scale is known."""
        return ScaleUncertainty(self.estimate.scale_sigma, self.spread)

    @cached_property
    def covariance(self) -> Array | None:
        """Covariances (n, 6, 6) of position (m) and rotation vector (rad) of each pose in the axes of the first."""
        return total_covariance(self.estimate, self.scale)

    @property
    def ate_sigma(self) -> float | None:
        """The position error in metres, root mean square over the poses, that the covariance expects."""
        if self.covariance is None:
            return None
        return float(np.sqrt(np.mean(np.trace(self.covariance[:, :3, :3], axis1=1, axis2=2))))

    @cached_property
    def measured_errors(self) -> PoseErrors | None:
        """Errors before smoothing."""
        return None if self.reference is None else compare_trajectories(self.measured, self.reference)

    @cached_property
    def errors(self) -> PoseErrors | None:
        """Errors after smoothing."""
        return None if self.reference is None else compare_trajectories(self.smoothed.trajectory, self.reference)

    @property
    def scale_error(self) -> float | None:
        """The share by which the motion after smoothing is too long, by its Sim(3) alignment to the reference."""
        return None if self.errors is None or self.errors.sim3 is None else 1.0 / self.errors.sim3.scale - 1.0

    @cached_property
    def reference_smoothness(self) -> tuple[Smoothness, Smoothness] | None:
        """Smoothness of the reference at the times of the poses, as it is and smoothed as the motion was."""
        if self.reference is None:
            return None
        times, reference = self.measured.timestamps_us, self.reference
        common = times[(times >= reference.timestamps_us[0]) & (times <= reference.timestamps_us[-1])]
        true = Trajectory(common, reference.interpolate(common))
        return measure_smoothness(true), measure_smoothness(smooth_trajectory(true, self.estimate.noise).trajectory)

    @cached_property
    def label_noise(self) -> LabelNoiseBudget | None:
        """What errors of the motion do to the policy's labels; None for motions below 7.9 s."""
        drawn = [] if self.estimate.covariance is None else draw_estimates(self.estimate, DRAWS)
        again, *as_likely = smooth_trajectories([self.smoothed.trajectory, *drawn], self.estimate.noise)
        return measure_label_noise(
            self.measured,
            self.smoothed,
            again.trajectory,
            self.reference,
            self.scale.total,
            [motion.trajectory for motion in as_likely],
        )

    @property
    def ego_motion(self) -> EgoMotion:
        """What a clip takes."""
        found = self.smoothed
        return EgoMotion.anchored(found.trajectory, found.velocity, found.acceleration, found.curvature)

    @property
    def acceleration_noise(self) -> float | None:
        """Root mean square error of the acceleration labels that is expected, m/s2."""
        return None if self.label_noise is None else self.label_noise.expected.acceleration

    @property
    def noise_basis(self) -> NoiseBasis | None:
        """Where `acceleration_noise` is from."""
        return None if self.label_noise is None else "estimated"

    def to_dict(self) -> dict[str, Any]:
        """Plain values; keys carry the units."""
        errors, reference = self.errors, self.reference_smoothness
        return {
            "doubts": [asdict(doubt) for doubt in self.doubts],
            "scale_sigma": self.scale.total,
            "scale_sigma_parts": self.scale.to_dict(),
            "scale_error": self.scale_error,
            "scale_z": _ratio(self.scale_error, self.scale.total),
            "ate_sigma_m": self.ate_sigma,
            "ate_z": _ratio(None if errors is None else errors.metric.ate_m, self.ate_sigma),
            "errors_before_smoothing": self.measured_errors.to_dict() if self.measured_errors else None,
            "errors": errors.to_dict() if errors else None,
            "smoothness_before_smoothing": asdict(measure_smoothness(self.measured)),
            "smoothness": asdict(measure_smoothness(self.smoothed.trajectory)),
            "smoothness_of_reference": None if reference is None else asdict(reference[0]),
            "smoothness_of_reference_smoothed": None if reference is None else asdict(reference[1]),
            "label_noise": asdict(self.label_noise) if self.label_noise else None,
        }


def _ratio(error: float | None, sigma: float | None) -> float | None:
    return None if error is None or not sigma else error / sigma
