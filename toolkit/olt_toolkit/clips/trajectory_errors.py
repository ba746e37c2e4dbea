"""How well the motion of a recording is recovered, over clips of equal length that are each estimated on their own."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.motion.pose_metrics import PoseErrors, Smoothness, compare_trajectories, measure_smoothness
from olt_generator.motion.pose_sources import VisualOdometry
from olt_generator.motion.smoother import SmoothedMotion, SmootherSettings, smooth_trajectory
from olt_generator.poses import Array, invert, make_pose
from olt_generator.progress import Progress, silent
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.label_noise import LabelNoiseBudget, measure_label_noise
from olt_toolkit.recordings.recording import Recording


@dataclass(frozen=True)
class Jitter:
    """Independent noise of poses: standard deviations per axis in metres and radians, and the seed that draws it."""

    position: float
    rotation: float
    seed: int = 0

    def disturb(self, trajectory: Trajectory) -> Trajectory:
        """The trajectory with noise on every pose."""
        random = make_generator("jitter", self.seed)
        offsets = self.position * random.standard_normal((len(trajectory), 3))
        turns = Rotation.from_rotvec(self.rotation * random.standard_normal((len(trajectory), 3))).as_matrix()
        poses = trajectory.T_world_rig
        return replace(trajectory, T_world_rig=make_pose(poses[:, :3, :3] @ turns, poses[:, :3, 3] + offsets))


@dataclass(frozen=True)
class ClipMotion:
    """Motion of one clip of a recording. What could not be measured is None.

    Attributes:
        first, frames: index of its first frame, and how many there are.
        scale_sigma: relative standard deviation of the scale; None for poses that were not measured by odometry.
        smoothed: the motion after smoothing.
        raw_smoothness, smoothness: before and after smoothing.
        raw_errors, errors: against the reference, before and after smoothing.
        label_noise: errors of the policy's labels; None for clips below 7.9 s.
    """

    first: int
    frames: int
    scale_sigma: float | None
    smoothed: SmoothedMotion
    raw_smoothness: Smoothness
    smoothness: Smoothness
    raw_errors: PoseErrors | None
    errors: PoseErrors | None
    label_noise: LabelNoiseBudget | None

    def to_dict(self) -> dict[str, Any]:
        """Plain values; keys carry the units."""
        return {
            "first_frame": self.first,
            "frames": self.frames,
            "path_length_m": self.smoothed.trajectory.path_length,
            "scale_sigma": self.scale_sigma,
            "errors_before_smoothing": self.raw_errors.to_dict() if self.raw_errors else None,
            "errors": self.errors.to_dict() if self.errors else None,
            "smoothness_before_smoothing": asdict(self.raw_smoothness),
            "smoothness": asdict(self.smoothness),
            "jerk_factor": _square_ratio(self.raw_smoothness, self.smoothness),
            "acceleration_variance_factor": _variance_ratio(self.raw_smoothness, self.smoothness),
            "label_noise": asdict(self.label_noise) if self.label_noise else None,
        }


def measure_clips(
    recording: Recording,
    frames: int | None,
    stride: int | None,
    jitter: Jitter | None = None,
    on_progress: Progress = silent,
) -> list[ClipMotion]:
    """Recover the motion of each clip of `frames` frames, `stride` frames apart; of the whole recording without them.

    With `jitter`, the reference disturbed by it is smoothed instead of the motion that odometry finds.

    Raises:
        InputError: the recording is shorter than one clip, its motion cannot be recovered, or there is no reference to
            disturb.
    """
    count = len(recording.frames)
    if jitter is not None and recording.reference is None:
        raise InputError(f"{recording.name}: has no reference to disturb; leave out the jitter")
    if frames is not None and count < frames:
        raise InputError(f"{recording.name}: has {count} frames, a clip needs {frames}; give a shorter --clip-frames")
    length = frames or count
    starts = range(0, count - length + 1, stride or length)
    motions = []
    for start in starts:
        motions.append(_measure(recording, start, length, jitter))
        on_progress(len(motions) / len(starts))
    return motions


def _measure(recording: Recording, first: int, frames: int, jitter: Jitter | None) -> ClipMotion:
    reference = recording.reference
    measured, scale_sigma, noise = _find_motion(recording, slice(first, first + frames), jitter)
    smoothed = smooth_trajectory(measured, noise)
    return ClipMotion(
        first,
        frames,
        scale_sigma,
        smoothed,
        measure_smoothness(measured),
        measure_smoothness(smoothed.trajectory),
        compare_trajectories(measured, reference) if reference else None,
        compare_trajectories(smoothed.trajectory, reference) if reference else None,
        measure_label_noise(measured, smoothed, reference),
    )


def _find_motion(
    recording: Recording, part: slice, jitter: Jitter | None
) -> tuple[Trajectory, float | None, SmootherSettings | None]:
    """Poses, their scale's deviation, and the noise that they are known to have."""
    times = recording.timestamps_us[part]
    if jitter is not None and recording.reference is not None:
        return jitter.disturb(Trajectory(times, recording.reference.interpolate(times))), None, None
    found = VisualOdometry().estimate(recording.frames[part], times, recording.camera, recording.T_rig_camera)
    return found.trajectory, found.scale_sigma, found.noise


def summarize_clips(motions: list[ClipMotion]) -> dict[str, Any]:
    """Mean and worst of the errors over the clips; None where there is no reference."""
    errors = [motion.errors for motion in motions if motion.errors is not None]
    steps = [e.metric.step_translation_percent for e in errors if e.metric.step_translation_percent is not None]
    ate = [e.metric.ate_m for e in errors]
    return {
        "clips": len(motions),
        "mean_ate_m": float(np.mean(ate)) if ate else None,
        "worst_ate_m": max(ate, default=None),
        "mean_step_translation_percent": float(np.mean(steps)) if steps else None,
        "mean_step_rotation_deg": float(np.mean([e.metric.step_rotation_deg for e in errors])) if errors else None,
    }


def plot_clips(recording: Recording, motions: list[ClipMotion], path: Path) -> None:
    """Draw the path from above, with the reference where it is known, and the forward acceleration over time."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (plan, over_time) = pyplot.subplots(1, 2, figsize=(13, 5), layout="constrained")
    reference = recording.reference
    for index, motion in enumerate(motions):
        found = motion.smoothed.trajectory
        start = np.eye(4)
        if reference is not None:
            start = reference.interpolate(found.timestamps_us[:1])[0]
            true = reference.interpolate(found.timestamps_us)
            plan.plot(true[:, 0, 3], true[:, 1, 3], color="black", lw=1, label="reference" if index == 0 else None)
        x, y = (start @ invert(found.T_world_rig[0]) @ found.T_world_rig)[:, :2, 3].T
        plan.plot(x, y, lw=1.5, label=f"clip from frame {motion.first}")
        seconds = (found.timestamps_us - recording.timestamps_us[0]) * 1e-6
        over_time.plot(seconds, _forward_acceleration(motion.smoothed), lw=1.2)
    plan.set(xlabel="x (m)", ylabel="y (m)", title="Path from above", aspect="equal", adjustable="datalim")
    plan.legend(fontsize=8)
    over_time.set(xlabel="time (s)", ylabel="acceleration (m/s²)", title="Forward acceleration after smoothing")
    for axes in (plan, over_time):
        axes.grid(True, alpha=0.3)
    with write_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
    pyplot.close(figure)


def _forward_acceleration(motion: SmoothedMotion) -> Array:
    return np.einsum("ni,ni->n", motion.acceleration, motion.trajectory.T_world_rig[:, :3, 0])


def _square_ratio(before: Smoothness, after: Smoothness) -> float | None:
    """How many times lower the mean squared jerk is: the paper's jerk has the size of a square (`pose_metrics`)."""
    if before.jerk_rms_m_s3 is None or not after.jerk_rms_m_s3:
        return None
    return (before.jerk_rms_m_s3 / after.jerk_rms_m_s3) ** 2


def _variance_ratio(before: Smoothness, after: Smoothness) -> float | None:
    if before.acceleration_variance_m2_s4 is None or not after.acceleration_variance_m2_s4:
        return None
    return before.acceleration_variance_m2_s4 / after.acceleration_variance_m2_s4
