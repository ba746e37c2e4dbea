"""A motion that was measured and smoothed, held against the reference where one is known."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from olt_generator.motion.pose_metrics import PoseErrors, compare_trajectories, measure_smoothness
from olt_generator.motion.smoother import SmoothedMotion
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.label_noise import LabelNoiseBudget, measure_label_noise


@dataclass(frozen=True)
class RecoveredMotion:
    """A motion before and after smoothing. Its errors are measured when first asked for; those that cannot be are None.

    `scale_sigma` is the relative standard deviation of the metric scale, where it is known; `reference` the true
    trajectory on the same clock.
    """

    measured: Trajectory
    smoothed: SmoothedMotion
    scale_sigma: float | None
    reference: Trajectory | None

    @cached_property
    def measured_errors(self) -> PoseErrors | None:
        """Errors before smoothing."""
        return None if self.reference is None else compare_trajectories(self.measured, self.reference)

    @cached_property
    def errors(self) -> PoseErrors | None:
        """Errors after smoothing."""
        return None if self.reference is None else compare_trajectories(self.smoothed.trajectory, self.reference)

    @cached_property
    def label_noise(self) -> LabelNoiseBudget | None:
        """What errors of the motion do to the policy's labels; None for motions below 7.9 s."""
        return measure_label_noise(self.measured, self.smoothed, self.reference)

    def to_dict(self) -> dict[str, Any]:
        """Plain values; keys carry the units."""
        return {
            "scale_sigma": self.scale_sigma,
            "errors_before_smoothing": self.measured_errors.to_dict() if self.measured_errors else None,
            "errors": self.errors.to_dict() if self.errors else None,
            "smoothness_before_smoothing": asdict(measure_smoothness(self.measured)),
            "smoothness": asdict(measure_smoothness(self.smoothed.trajectory)),
            "label_noise": asdict(self.label_noise) if self.label_noise else None,
        }
