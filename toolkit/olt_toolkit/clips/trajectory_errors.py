"""How well the motion of a recording is recovered, over clips of equal length that are each estimated on their own."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.motion.odometry import estimate_odometry
from olt_generator.motion.smoother import smooth_trajectory
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
class ClipMotion:
    """Motion of one clip of a recording: index of its first frame, number of its frames, and what was recovered."""

    first: int
    frames: int
    motion: RecoveredMotion

    def to_dict(self) -> dict[str, Any]:
        """Plain values; keys carry the units."""
        found = self.motion.to_dict()
        before, after = found["smoothness_before_smoothing"], found["smoothness"]
        jerk_ratio = _ratio(before["jerk_rms_m_s3"], after["jerk_rms_m_s3"])
        return {
            "first_frame": self.first,
            "frames": self.frames,
            "path_length_m": self.motion.smoothed.trajectory.path_length,
            **found,
            # How many times lower the mean squared jerk is: the paper's jerk has the size of a square (`pose_metrics`).
            "jerk_factor": None if jerk_ratio is None else jerk_ratio**2,
            "acceleration_variance_factor": _ratio(
                before["acceleration_variance_m2_s4"], after["acceleration_variance_m2_s4"]
            ),
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
    part = slice(first, first + frames)
    times, reference = recording.timestamps_us[part], recording.reference
    if jitter is not None and reference is not None:
        measured = jitter.disturb(Trajectory(times, reference.interpolate(times)))
        return ClipMotion(first, frames, RecoveredMotion(measured, smooth_trajectory(measured), None, reference))
    found = estimate_odometry(recording.frames[part], times, recording.camera, recording.T_rig_camera)
    smoothed = smooth_trajectory(found.trajectory, found.noise)
    return ClipMotion(first, frames, RecoveredMotion(found.trajectory, smoothed, found.scale_sigma, reference))


def summarize_clips(motions: list[ClipMotion]) -> dict[str, Any]:
    """Mean and worst of the errors over the clips; None where there is no reference."""
    errors = [clip.motion.errors.metric for clip in motions if clip.motion.errors is not None]
    steps = [error.step_translation_percent for error in errors if error.step_translation_percent is not None]
    ate = [error.ate_m for error in errors]
    return {
        "clips": len(motions),
        "mean_ate_m": float(np.mean(ate)) if ate else None,
        "worst_ate_m": max(ate, default=None),
        "mean_step_translation_percent": float(np.mean(steps)) if steps else None,
        "mean_step_rotation_deg": float(np.mean([error.step_rotation_deg for error in errors])) if errors else None,
    }


def plot_clips(recording: Recording, motions: list[ClipMotion], path: Path) -> None:
    """Draw the path from above, with the reference where it is known, and the forward acceleration over time."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (plan, over_time) = pyplot.subplots(1, 2, figsize=(13, 5), layout="constrained")
    reference = recording.reference
    for index, clip in enumerate(motions):
        smoothed = clip.motion.smoothed
        found = smoothed.trajectory
        start = np.eye(4)
        if reference is not None:
            start = reference.interpolate(found.timestamps_us[:1])[0]
            true = reference.interpolate(found.timestamps_us)
            plan.plot(true[:, 0, 3], true[:, 1, 3], color="black", lw=1, label="reference" if index == 0 else None)
        x, y = (start @ invert(found.T_world_rig[0]) @ found.T_world_rig)[:, :2, 3].T
        plan.plot(x, y, lw=1.5, label=f"clip from frame {clip.first}")
        seconds = (found.timestamps_us - recording.timestamps_us[0]) * 1e-6
        forward_acceleration = np.einsum("ni,ni->n", smoothed.acceleration, found.T_world_rig[:, :3, 0])
        over_time.plot(seconds, forward_acceleration, lw=1.2)
    plan.set(xlabel="x (m)", ylabel="y (m)", title="Path from above", aspect="equal", adjustable="datalim")
    plan.legend(fontsize=8)
    over_time.set(xlabel="time (s)", ylabel="acceleration (m/s²)", title="Forward acceleration after smoothing")
    for axes in (plan, over_time):
        axes.grid(True, alpha=0.3)
    with write_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
    pyplot.close(figure)


def _ratio(before: float | None, after: float | None) -> float | None:
    return None if before is None or not after else before / after
