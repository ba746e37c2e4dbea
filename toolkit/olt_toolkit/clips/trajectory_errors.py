"""How well the motion of a recording is recovered, over clips of equal length that are each estimated on their own."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.motion.odometry import estimate_odometry
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.motion.smoother import SmootherSettings, smooth_trajectory
from olt_generator.poses import invert, make_pose
from olt_generator.progress import Progress, silent
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.recovered_motion import RecoveredMotion
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
class ClipMotion(RecoveredMotion):
    """Motion of one clip of a recording: with the index of its first frame, and the number of its frames."""

    first: int = field(kw_only=True)
    frames: int = field(kw_only=True)

    def to_dict(self) -> dict[str, Any]:
        """Plain values; keys carry the units."""
        found = super().to_dict()
        parts = (
            "smoothness_before_smoothing",
            "smoothness",
            "smoothness_of_reference",
            "smoothness_of_reference_smoothed",
        )
        before, after, true, true_smoothed = (found[name] or {} for name in parts)
        jerk, variance = "jerk_rms_m_s3", "acceleration_variance_m2_s4"
        jerk_ratio = _ratio(before.get(jerk), after.get(jerk))
        return {
            "first_frame": self.first,
            "frames": self.frames,
            "path_length_m": self.smoothed.trajectory.path_length,
            **found,
            # How many times lower the mean squared jerk is: the paper's jerk has the size of a square (`pose_metrics`).
            "jerk_factor": None if jerk_ratio is None else jerk_ratio**2,
            "acceleration_variance_factor": _ratio(before.get(variance), after.get(variance)),
            # 1 where the motion accelerates as the reference does, seen through the same smoothing and as it is.
            "acceleration_variance_over_reference_smoothed": _ratio(after.get(variance), true_smoothed.get(variance)),
            "acceleration_variance_over_reference": _ratio(after.get(variance), true.get(variance)),
        }


def _ratio(value: float | None, other: float | None) -> float | None:
    return None if value is None or not other else value / other


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
    count, reference = len(recording.frames), recording.reference
    if jitter is not None and reference is None:
        raise InputError(f"{recording.name}: has no reference to disturb; leave out the jitter")
    if frames is not None and count < frames:
        raise InputError(f"{recording.name}: has {count} frames, a clip needs {frames}; give a shorter --clip-frames")
    length = frames or count
    starts = range(0, count - length + 1, stride or length)
    motions = []
    for start in starts:
        part = slice(start, start + length)
        times = recording.timestamps_us[part]
        if jitter is not None and reference is not None:
            disturbed = jitter.disturb(Trajectory(times, reference.interpolate(times)))
            found = PoseEstimate(disturbed, recording.T_rig_camera, None, SmootherSettings())
        else:
            found = estimate_odometry(recording.frames[part], times, recording.camera, recording.T_rig_camera)
        smoothed = smooth_trajectory(found.trajectory, found.noise)
        motions.append(
            ClipMotion(found, smoothed, recording.spread, reference, recording.doubts, first=start, frames=length)
        )
        on_progress(len(motions) / len(starts))
    return motions


def summarize_clips(motions: list[ClipMotion]) -> dict[str, Any]:
    """Mean and worst of the errors over the clips; None where there is no reference."""
    errors = [clip.errors.metric for clip in motions if clip.errors is not None]
    steps = [error.step_translation_percent for error in errors if error.step_translation_percent is not None]
    ate = [error.ate_m for error in errors]
    return {
        "clips": len(motions),
        "mean_ate_m": float(np.mean(ate)) if ate else None,
        "worst_ate_m": max(ate, default=None),
        "mean_step_translation_percent": float(np.mean(steps)) if steps else None,
        "mean_step_rotation_deg": float(np.mean([error.step_rotation_deg for error in errors])) if errors else None,
    }


def draw_motions(path: Path, motions: Mapping[str, RecoveredMotion]) -> None:
    """Draw motions by their label into a PNG file.

    On the left paths from above, before and after smoothing, with the reference where it is known; on the right the
    forward acceleration over time.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (plan, over_time) = pyplot.subplots(1, 2, figsize=(13, 5), layout="constrained")
    for index, (label, motion) in enumerate(motions.items()):
        smoothed, reference = motion.smoothed.trajectory, motion.reference
        start = np.eye(4)
        if reference is not None:
            true = reference.interpolate(smoothed.timestamps_us)
            start = true[0]
            plan.plot(true[:, 0, 3], true[:, 1, 3], color="black", lw=1, label=None if index else "reference")
        T_drawn_world = start @ invert(smoothed.T_world_rig[0])
        x, y = (T_drawn_world @ motion.measured.T_world_rig)[:, :2, 3].T
        plan.plot(x, y, color="0.6", lw=0.8, label=None if index else "before smoothing")
        x, y = (T_drawn_world @ smoothed.T_world_rig)[:, :2, 3].T
        plan.plot(x, y, color=f"C{index}", lw=1.5, label=label)
        forward_acceleration = np.einsum("ni,ni->n", motion.smoothed.acceleration, smoothed.T_world_rig[:, :3, 0])
        over_time.plot(smoothed.timestamps_us * 1e-6, forward_acceleration, lw=1.2)
    plan.set(xlabel="x (m)", ylabel="y (m)", title="Path from above", aspect="equal", adjustable="datalim")
    plan.legend(fontsize=8)
    over_time.set(xlabel="time (s)", ylabel="acceleration (m/s²)", title="Forward acceleration after smoothing")
    for axes in (plan, over_time):
        axes.grid(True, alpha=0.3)
    with write_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
    pyplot.close(figure)
