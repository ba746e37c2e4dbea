"""A recovered motion as a file of poses: TUM, KITTI or Parquet (docs/formats/trajectory.md)."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

from olt_generator.files import write_whole
from olt_generator.poses import Array, invert
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.motion_uncertainty import camera_covariance
from olt_toolkit.clips.pose_choices import PoseFormat, PoseOf
from olt_toolkit.clips.recovered_motion import RecoveredMotion
from olt_toolkit.runtime.version import code_version

FILE_VERSION = 1
METADATA_KEY = b"olt_trajectory"
POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
_AXES = {
    "rig": "x forward, y left, z up, origin on the ground under the rear axle",
    "camera": "x right, y down, z forward, origin at the camera's centre",
}


@dataclass(frozen=True)
class PoseFile:
    """What is written of a motion.

    Attributes:
        trajectory: poses of `of` in the axes of its first pose, at the times of the frames.
        covariance: (n, 6, 6) of position (m) and rotation vector (rad) in those axes; None where it is not known.
        metadata: conventions, and what is known of the motion.
    """

    trajectory: Trajectory
    covariance: Array | None
    metadata: dict[str, Any]


def describe_poses(motion: RecoveredMotion, of: PoseOf, recording: str) -> PoseFile:
    """The smoothed poses of the rig or the camera, in the axes of the first."""
    smoothed, covariance = motion.smoothed.trajectory.in_first_frame(), motion.covariance
    trajectory = smoothed
    if of is PoseOf.CAMERA:
        T_rig_camera = motion.estimate.T_rig_camera
        poses = invert(T_rig_camera) @ smoothed.T_world_rig @ T_rig_camera
        trajectory = Trajectory(smoothed.timestamps_us, poses)
        if covariance is not None:
            covariance = camera_covariance(covariance, smoothed, T_rig_camera)
    metadata = {
        "version": FILE_VERSION,
        "recording": recording,
        "poses_of": of.value,
        "axes": _AXES[of],
        "frame": f"T_start_{of.value}: a pose maps points seen from the {of.value} to points seen from its first pose",
        "units": "metres; times in microseconds since the start of the recording; quaternions x, y, z, w",
        "covariance": (
            "not known"
            if covariance is None
            else "6 x 6, row by row: of x, y, z (m) and the rotation vector (rad), in the axes of the first pose, "
            "the true rotation being exp(error) times the one given; with that of the scale"
        ),
        "T_rig_camera": motion.estimate.T_rig_camera.tolist(),
        "scale_sigma": motion.scale.to_dict(),
        "doubts": [asdict(doubt) for doubt in motion.doubts],
        "created_with": code_version(),
    }
    return PoseFile(trajectory, covariance, metadata)


def write_poses(path: Path, format_: PoseFormat, poses: PoseFile) -> None:
    """Write a file of poses; it appears whole."""
    with write_whole(path) as temporary:
        _WRITERS[format_](temporary, poses)


def _write_tum(path: Path, poses: PoseFile) -> None:
    trajectory = poses.trajectory
    told = json.dumps(poses.metadata | {"covariance": "not written: TUM files have no place for it"})
    lines = [f"# {told}", "# timestamp tx ty tz qx qy qz qw"]
    for time_us, row in zip(trajectory.timestamps_us.tolist(), _position_and_turn(trajectory), strict=True):
        seconds, rest = divmod(time_us, 1_000_000)
        lines.append(f"{seconds}.{rest:06d} " + " ".join(f"{value:.9f}" for value in row))
    path.write_text("\n".join(lines) + "\n")


def _write_kitti(path: Path, poses: PoseFile) -> None:
    rows = poses.trajectory.T_world_rig[:, :3].reshape(-1, 12)
    np.savetxt(path, rows, fmt="%.9e")


def _write_parquet(path: Path, poses: PoseFile) -> None:
    trajectory, covariance = poses.trajectory, poses.covariance
    columns: dict[str, Any] = {"timestamp_us": trajectory.timestamps_us}
    columns |= dict(zip(POSE_COLUMNS, _position_and_turn(trajectory).T, strict=True))
    if covariance is not None:
        columns["covariance"] = pa.FixedSizeListArray.from_arrays(covariance.ravel(), 36)
    table = pa.table(columns).replace_schema_metadata({METADATA_KEY: json.dumps(poses.metadata).encode()})
    pq.write_table(table, path)


def _position_and_turn(trajectory: Trajectory) -> Array:
    """Positions and unit quaternions (n, 7) in the order of `POSE_COLUMNS`."""
    turns = Rotation.from_matrix(trajectory.T_world_rig[:, :3, :3]).as_quat(canonical=True)
    return np.concatenate([trajectory.positions, turns], axis=1)


_WRITERS: dict[PoseFormat, Callable[[Path, PoseFile], None]] = {
    PoseFormat.TUM: _write_tum,
    PoseFormat.KITTI: _write_kitti,
    PoseFormat.PARQUET: _write_parquet,
}
