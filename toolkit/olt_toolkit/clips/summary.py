"""What building a clip gave, as plain numbers. What was not measured is None."""

from dataclasses import asdict
from typing import Any

import numpy as np

from olt_toolkit.clips.action_errors import measure_action_errors, summarize_action_errors
from olt_toolkit.clips.builder import BuiltClip
from olt_toolkit.clips.clip import ClipInfo, EgoMotion, ViewProvenance
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.rigs.contracts import contracts_met

_UNCERTAINTY = ("scale_sigma", "scale_sigma_parts", "scale_error", "scale_z", "ate_sigma_m", "ate_z")


def summarize_build(built: BuiltClip, info: ClipInfo) -> dict[str, Any]:
    """Numbers of a built clip: trajectory and its errors, views and theirs, what was left out, assumed and timed."""
    motion = {} if built.motion is None else built.motion.to_dict()
    return {
        "clip": summarize_info(info),
        "trajectory": summarize_motion(built.clip.ego_motion),
        "doubts": [asdict(doubt) for doubt in built.doubts],
        **{name: motion.get(name) for name in _UNCERTAINTY},
        "pose_errors_before_smoothing": motion.get("errors_before_smoothing"),
        "pose_errors": motion.get("errors"),
        "smoothness_before_smoothing": motion.get("smoothness_before_smoothing"),
        "smoothness": motion.get("smoothness"),
        "smoothness_of_reference": motion.get("smoothness_of_reference"),
        "smoothness_of_reference_smoothed": motion.get("smoothness_of_reference_smoothed"),
        "label_noise": motion.get("label_noise"),
        "given_motion": None if built.given is None else built.given.to_dict(),
        "action_errors_before_smoothing": summarize_action_errors(_errors_before_smoothing(built, info)),
        "action_errors": summarize_action_errors(info.action_errors),
        "distance_median_relative_error": built.distance_error,
        "view_errors": built.view_errors,
        "left_out": [omission.to_dict() for omission in built.left_out],
        "assumptions": list(built.assumptions),
        "seconds": dict(built.seconds),
    }


def _errors_before_smoothing(built: BuiltClip, info: ClipInfo) -> tuple[float, ...] | None:
    """What the action errors of the clip were before its motion was smoothed; None where it was not."""
    if built.motion is not None:
        measured = built.motion.measured
    elif built.given is not None and built.given.smoothed is not None:
        measured = built.given.measured
    else:
        return None
    return measure_action_errors(EgoMotion.from_trajectory(measured), info.sample_t0_us, info.views)


def summarize_info(info: ClipInfo) -> dict[str, Any]:
    """A row of the clip table."""
    return asdict(info) | {
        "fingerprint": None if info.fingerprint is None else info.fingerprint.hex(),
        "factors": list(info.factors),
        "doubts": None if info.doubts is None else list(info.doubts),
        "sample_t0_us": list(info.sample_t0_us),
        "action_errors": None if info.action_errors is None else list(info.action_errors),
        "views": {camera: summarize_view(view) for camera, view in info.views.items()},
        "contracts": [contract.name for contract in contracts_met(info.views)],
    }


def summarize_view(view: ViewProvenance) -> dict[str, Any]:
    """Where the pixels of a view came from."""
    return asdict(view) | {"unseen_share": view.unseen_share}


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
    """A clip as it is stored: row of the clip table, motion, vehicle, cameras; an `InputError` where damaged."""
    info, cameras = store.info(clip_id), {}
    for name in info.views:
        mounted, times_us = store.read_camera(clip_id, name), store.read_timestamps(clip_id, name)
        runs = store.read_origin_runs(clip_id, name)
        cameras[name] = {
            "size": [mounted.camera.width, mounted.camera.height],
            "position_rig": mounted.T_rig_camera[:3, 3].tolist(),
            "frames": len(times_us),
            "first_us": int(times_us[0]),
            "last_us": int(times_us[-1]),
            "frames_not_seen": 0 if runs is None else int((~runs.seen_frames).sum()),
        }
    return {
        "store": str(store.root),
        "clip": summarize_info(info),
        "trajectory": summarize_motion(store.read_ego_motion(clip_id)),
        "action_errors": summarize_action_errors(info.action_errors),
        "vehicle": asdict(store.read_vehicle(clip_id)),
        "cameras": cameras,
    }
