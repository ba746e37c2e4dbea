"""How far the recovered motion of a clip is from the true one, in metres and in stated standard deviations."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.hard_clips.filming import make_clip
from olt_closed_loop.hard_clips.specification import ClipSpecification
from olt_generator.errors import InputError
from olt_generator.motion.odometry import estimate_odometry
from olt_generator.motion.pose_metrics import compare_trajectories
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.motion_uncertainty import ScaleUncertainty, total_covariance
from olt_toolkit.recordings.drives import open_recording
from olt_toolkit.recordings.recording import Recording

# Below so many metres from the start, a path has no scale.
SHORTEST_REACH = 0.3
Source: TypeAlias = ClipSpecification | Path
Estimator = Callable[[Recording], PoseEstimate]


@dataclass(frozen=True)
class ClipErrors:
    """Errors of one clip; None is what was not measured: no reference, nothing stated, or the motion refused.

    Attributes:
        name, kind: of the clip; a recording that is given is a kind of its own.
        frames: number of frames.
        seconds_per_frame: processor time of the estimate.
        refused: why there is no motion; None where there is.
        doubts: what the estimate and the recording say is in doubt; such a clip is "marked".
        reach_m: largest true distance from the start.
        log_scale_error: logarithm of found over true scale; None below a reach of 0.3 m, and where `backwards`.
        scale_sigma: relative standard deviation of the scale as stated in total.
        scale_z: error over sigma.
        backwards: whether the motion goes against the true one, or stays where that moves.
        ate_m: root mean square error of the positions.
        ate_sigma_m: its root mean square as the stated covariance has it.
        ate_z: one over the other.
    """

    name: str
    kind: str
    frames: int
    seconds_per_frame: float
    refused: str | None = None
    doubts: tuple[str, ...] = ()
    reach_m: float | None = None
    log_scale_error: float | None = None
    scale_sigma: float | None = None
    scale_z: float | None = None
    backwards: bool = False
    ate_m: float | None = None
    ate_sigma_m: float | None = None
    ate_z: float | None = None

    @property
    def marked(self) -> bool:
        """Whether a motion was given with doubts."""
        return self.refused is None and bool(self.doubts)

    @property
    def worst_z(self) -> float | None:
        """The larger of both |z|; infinite where the motion goes backwards."""
        if self.backwards:
            return float("inf")
        known = [abs(z) for z in (self.scale_z, self.ate_z) if z is not None]
        return max(known, default=None)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "marked": self.marked}


@dataclass(frozen=True)
class MeasuredClip:
    """Errors of a clip, and its first, middle and last frame (3, h, w, 3), small, for a contact sheet."""

    errors: ClipErrors
    thumbnails: NDArray[np.uint8]


def measure_clip(source: Source, cache: Path | None = None, thumbnail_width: int = 0) -> MeasuredClip:
    """Film a clip, or open a recording, and estimate its motion; no thumbnails for a width of 0."""
    if isinstance(source, Path):
        recording = open_recording(source, cache=cache)
        kind = recording.name  # a row of its own
    else:
        recording, kind = make_clip(source, cache), source.kind
    errors = measure_motion(recording, kind)
    shown = recording.frames[[0, len(recording.frames) // 2, -1]] if thumbnail_width else recording.frames[:0]
    return MeasuredClip(errors, np.array([_shrink(image, thumbnail_width) for image in shown], dtype=np.uint8))


def measure_motion(recording: Recording, kind: str, estimate: Estimator | None = None) -> ClipErrors:
    """Estimate the motion of a recording, by odometry unless told otherwise, and hold it against its reference."""
    start = time.process_time()
    try:
        found = (estimate or _estimate)(recording)
    except InputError as refusal:
        seconds = (time.process_time() - start) / len(recording.frames)
        return ClipErrors(recording.name, kind, len(recording.frames), seconds, refused=str(refusal))
    seconds = (time.process_time() - start) / len(recording.frames)
    doubts = tuple(f"{doubt.what}: {doubt.why}" for doubt in (*recording.doubts, *found.doubts))
    scale_uncertainty = ScaleUncertainty(found.scale_sigma, recording.spread)
    sigma = scale_uncertainty.total
    measured = partial(
        ClipErrors, recording.name, kind, len(recording.frames), seconds, doubts=doubts, scale_sigma=sigma
    )
    if recording.reference is None:
        return measured()
    true = Trajectory(recording.timestamps_us, recording.reference.interpolate(recording.timestamps_us))
    positions, exact = (each.in_first_frame().positions for each in (found.trajectory, true))
    reach = float(np.linalg.norm(exact, axis=1).max())
    # Scale of least squares about the first pose; what goes the wrong way has a negative one.
    scale = float(np.sum(positions * exact) / np.sum(exact**2)) if reach >= SHORTEST_REACH else None
    error = float(np.log(scale)) if scale is not None and scale > 0.0 else None
    ate = compare_trajectories(found.trajectory, true).metric.ate_m
    ate_sigma = _stated_position_error(found, scale_uncertainty)
    return measured(
        reach_m=reach,
        log_scale_error=error,
        scale_z=None if error is None or not sigma else error / sigma,
        backwards=scale is not None and scale <= 0.0,
        ate_m=ate,
        ate_sigma_m=ate_sigma,
        ate_z=ate / ate_sigma if ate_sigma else None,
    )


def _stated_position_error(found: PoseEstimate, scale: ScaleUncertainty) -> float | None:
    """Root mean square position error in metres that the total covariance promises; None where it is not known."""
    covariance = total_covariance(found, scale)
    return None if covariance is None else float(np.sqrt(np.mean(np.trace(covariance[:, :3, :3], axis1=1, axis2=2))))


def _estimate(recording: Recording) -> PoseEstimate:
    return estimate_odometry(recording.frames, recording.timestamps_us, recording.camera, recording.T_rig_camera)


def _shrink(image: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """An image of `width` x 9/16 `width` pixels, whatever its shape."""
    return np.asarray(cv2.resize(image, (width, width * 9 // 16), interpolation=cv2.INTER_AREA), dtype=np.uint8)
