"""What building a clip gave, as plain numbers. What was not measured is None."""

from dataclasses import asdict
from typing import Any

import numpy as np

from olt_generator.motion.pose_metrics import PoseErrors, measure_smoothness
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.builder import BuiltClip
from olt_toolkit.clips.clip import ClipInfo, EgoMotion
from olt_toolkit.clips.store import ClipStore


def summarize_build(built: BuiltClip, info: ClipInfo) -> dict[str, Any]:
    """Numbers of a built clip: trajectory and its errors, views and theirs, what was left out, assumed and timed.

    Args:
        built: the clip and what it was made from.
        info: its row in the clip table.
    """
    return {
        "clip": summarize_info(info),
        "trajectory": summarize_motion(built.clip.ego_motion),
        "scale_sigma": built.measured.scale_sigma if built.measured else None,
        "pose_errors": _errors(built.pose_errors),
        "pose_errors_before_smoothing": _errors(built.raw_pose_errors),
        "smoothness": _smoothness(built.motion.trajectory if built.motion else None),
        "smoothness_before_smoothing": _smoothness(built.measured.trajectory if built.measured else None),
        "label_noise": None if built.label_noise is None else asdict(built.label_noise),
        "distance_median_relative_error": built.distance_error,
        "view_errors": {name: asdict(error) for name, error in built.view_errors.items()},
        "left_out": dict(built.left_out),
        "assumptions": list(built.assumptions),
        "seconds": dict(built.seconds),
    }


def summarize_info(info: ClipInfo) -> dict[str, Any]:
    """A row of the clip table."""
    return asdict(info) | {"factors": list(info.factors), "sample_t0_us": list(info.sample_t0_us)}


def summarize_motion(motion: EgoMotion) -> dict[str, float]:
    """Length in metres, duration in seconds, and speeds in m/s of an ego motion."""
    speed = np.linalg.norm(motion.velocity, axis=1)
    return {
        "length": motion.trajectory.path_length,
        "duration": float(motion.trajectory.times[-1]),
        "mean_speed": float(speed.mean()),
        "lowest_speed": float(speed.min()),
        "highest_speed": float(speed.max()),
    }


def summarize_stored(store: ClipStore, clip_id: str) -> dict[str, Any]:
    """A clip as it is stored: its row in the clip table, motion, vehicle and cameras.

    Raises:
        InputError: the store has no such clip, or its files are damaged.
    """
    info = store.info(clip_id)
    return {
        "store": str(store.root),
        "clip": summarize_info(info),
        "trajectory": summarize_motion(store.read_ego_motion(clip_id)),
        "vehicle": asdict(store.read_vehicle(clip_id)),
        "cameras": {name: _summarize_camera(store, clip_id, name) for name in info.views},
    }


def _summarize_camera(store: ClipStore, clip_id: str, name: str) -> dict[str, Any]:
    mounted, times_us = store.read_camera(clip_id, name), store.read_timestamps(clip_id, name)
    return {
        "size": [mounted.camera.width, mounted.camera.height],
        "position_rig": mounted.T_rig_camera[:3, 3].tolist(),
        "frames": len(times_us),
        "first_us": int(times_us[0]),
        "last_us": int(times_us[-1]),
    }


def _errors(errors: PoseErrors | None) -> dict[str, Any] | None:
    return None if errors is None else errors.to_dict()


def _smoothness(trajectory: Trajectory | None) -> dict[str, Any] | None:
    return None if trajectory is None else asdict(measure_smoothness(trajectory))
