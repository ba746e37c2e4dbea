"""A motion that a data set measured: as the labels of a clip take it, and how noisy these are.

As measured, poses are taken as they are. Heading and path are then two measurements, and where they disagree the policy
cannot learn both: a unicycle moves along its heading. Smoothed, the motion is the most probable one of a car that does
not slip, which a unicycle can drive. Views are made with the measured motion in either case, as images were.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from olt_generator.motion.smoother import SmoothedMotion, SmootherSettings, smooth_trajectory
from olt_generator.poses import invert, yaw_of
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import EgoMotion, NoiseBasis
from olt_toolkit.clips.label_noise import LabelNoise, estimate_given_noise, measure_label_noise
from olt_toolkit.policy.contract import STEP_US
from olt_toolkit.policy.window import FUTURE_OFFSETS_US, HISTORY_OFFSETS_US, Span
from olt_toolkit.recordings.recording import StatedAccuracy
from olt_toolkit.rigs.names import MotionLabels

# Headings are believed to half a degree, by which GPS/IMUs disagree with the path; the path, to a centimetre, leads.
UNICYCLE_SMOOTHING = SmootherSettings(slip_sigma=0.005, least_position_sigma=0.01, least_rotation_sigma=0.01)


@dataclass(frozen=True)
class GivenMotion:
    """A measured motion, and the same smoothed where that was asked for.

    Attributes:
        shown_us: clip times of the first and the last image, about which labels are looked at.
        accuracy: what the source says of its errors.
    """

    measured: Trajectory
    smoothed: SmoothedMotion | None
    shown_us: Span
    accuracy: StatedAccuracy | None

    @classmethod
    def take(
        cls, measured: Trajectory, shown_us: Span, accuracy: StatedAccuracy | None, labels: MotionLabels
    ) -> "GivenMotion":
        """The motion, smoothed if `labels` say so."""
        smoothed = smooth_trajectory(measured, UNICYCLE_SMOOTHING) if labels is MotionLabels.SMOOTHED else None
        return cls(measured, smoothed, shown_us, accuracy)

    @cached_property
    def ego_motion(self) -> EgoMotion:
        """What the clip takes."""
        found = self.smoothed
        if found is None:
            return EgoMotion.from_trajectory(self.measured)
        return EgoMotion.anchored(found.trajectory, found.velocity, found.acceleration, found.curvature)

    @property
    def noise_basis(self) -> NoiseBasis | None:
        """Where `acceleration_noise` is from."""
        return None if self.acceleration_noise is None else "stated" if self._is_stated else "estimated"

    @property
    def acceleration_noise(self) -> float | None:
        """Root mean square error of the acceleration labels, m/s2; None for motions below 7.9 s."""
        if self.accuracy is not None and self._is_stated:
            return self.accuracy.acceleration
        return None if self.estimated_noise is None else self.estimated_noise.acceleration

    @cached_property
    def estimated_noise(self) -> LabelNoise | None:
        """The noise of the labels, as far as the motion itself tells it; None for motions below 7.9 s."""
        measured = _cut(self.measured, self.shown_us)
        if measured is None:
            return None
        if self.smoothed is None:
            return estimate_given_noise(measured)
        smoothed = smooth_trajectory(measured, UNICYCLE_SMOOTHING)
        again = smooth_trajectory(smoothed.trajectory, UNICYCLE_SMOOTHING)
        budget = measure_label_noise(measured, smoothed, again.trajectory)
        return None if budget is None else budget.expected

    @property
    def _is_stated(self) -> bool:
        # What is said holds for the motion as it was measured.
        return self.smoothed is None and self.accuracy is not None and self.accuracy.acceleration is not None

    def to_dict(self) -> dict[str, Any]:
        """Plain values; keys carry the units."""
        estimated = self.estimated_noise
        return {
            "labels": (MotionLabels.AS_MEASURED if self.smoothed is None else MotionLabels.SMOOTHED).value,
            "source_says": None if self.accuracy is None else self.accuracy.text,
            "acceleration_noise_m_s2": self.acceleration_noise,
            "acceleration_noise_basis": self.noise_basis,
            "estimated_acceleration_noise_m_s2": None if estimated is None else estimated.acceleration,
            "estimated_curvature_noise_1_m": None if estimated is None else estimated.curvature,
            "moved_by_smoothing": None if self.smoothed is None else self._moved(self.smoothed.trajectory),
        }

    def _moved(self, smoothed: Trajectory) -> dict[str, float]:
        distance = np.linalg.norm(smoothed.positions - self.measured.positions, axis=1)
        turned = yaw_of(invert(self.measured.T_world_rig) @ smoothed.T_world_rig)
        return {
            "rms_m": float(np.sqrt(np.mean(distance**2))),
            "worst_m": float(distance.max()),
            "worst_heading_deg": float(np.degrees(np.abs(turned).max())),
        }


def _cut(trajectory: Trajectory, shown_us: Span) -> Trajectory | None:
    """The part that labels of the shown times look at; None where nothing is left to smooth."""
    first = shown_us[0] + int(HISTORY_OFFSETS_US[0]) - STEP_US
    last = shown_us[1] + int(FUTURE_OFFSETS_US[-1]) + STEP_US
    times = trajectory.timestamps_us
    kept = (times >= first) & (times <= last)
    return Trajectory(times[kept], trajectory.T_world_rig[kept]) if np.count_nonzero(kept) > 1 else None
