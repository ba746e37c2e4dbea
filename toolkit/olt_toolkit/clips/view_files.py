"""Single views of a recording or of a stored clip, written as video files for people and other tools."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from olt_generator.errors import InputError
from olt_generator.files import make_folder, write_whole
from olt_generator.motion.pose_sources import KnownPoses
from olt_generator.omissions import Omission
from olt_generator.trajectory import Trajectory
from olt_generator.video import write_video
from olt_generator.views.pixel_origin import PixelOrigin
from olt_generator.views.view_plan import plan_views
from olt_toolkit.clips.builder import BuiltClip
from olt_toolkit.clips.images import largest_rectangle
from olt_toolkit.clips.origin_files import encode_origin
from olt_toolkit.clips.pai_layout import PIXEL_ORIGIN
from olt_toolkit.clips.pictures import write_clip_pictures
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.summary import summarize_view
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import CAMERA_INDEX, FRONT_WIDE, short_name


def parse_cameras(text: str) -> tuple[str, ...]:
    """The rig's cameras out of a list with commas, short names (`cross_left`) for whole ones, or an `InputError`."""
    whole_names = {short_name(name): name for name in CAMERA_INDEX} | {name: name for name in CAMERA_INDEX}
    names = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in names if name not in whole_names]
    if unknown or not names:
        choices = ", ".join(short_name(name) for name in CAMERA_INDEX)
        raise InputError(f"--cameras {text!r}: {', '.join(unknown) or 'no camera'} named; choose from {choices}")
    return tuple(dict.fromkeys(whole_names[name] for name in names))


def reopen_clip(store: ClipStore, clip_id: str) -> Recording:
    """A stored clip, which needs a front view, as a recording of known motion, so that more views can be made of it.

    Black borders of the front view are cut off.
    """
    info = store.info(clip_id)
    if FRONT_WIDE not in info.views:
        raise InputError(f"{store.root}: clip {clip_id} has no {FRONT_WIDE} view, from which all others are made")
    front, times_us = store.read_camera(clip_id, FRONT_WIDE), store.read_timestamps(clip_id, FRONT_WIDE)
    frames, _ = store.read_frames(clip_id, FRONT_WIDE, times_us)
    camera = front.camera
    if not info.views[FRONT_WIDE].is_seen_whole:
        seen = (store.read_origin(clip_id, FRONT_WIDE, times_us) != PixelOrigin.UNSEEN).all(axis=0)
        rows, columns = largest_rectangle(seen)
        frames = np.ascontiguousarray(frames[:, rows, columns])
        camera = camera.cropped(columns.start, rows.start, frames.shape[2], frames.shape[1])
    timestamps_us = times_us - times_us[0]
    return Recording(
        name=info.name,
        source=info.source,
        frames=frames,
        timestamps_us=timestamps_us,
        camera=camera,
        T_rig_camera=front.T_rig_camera,
        vehicle=store.read_vehicle(clip_id),
        assumptions=("The images and the motion are those stored in the clip.",),
        reference=Trajectory(timestamps_us, store.read_ego_motion(clip_id).interpolate(times_us)),
    )


def leave_out_motion(recording: Recording, options: BuildOptions) -> BuildOptions:
    """The options without measuring the motion, where the wanted views are all cut out of the front view."""
    if plan_views(options.cameras).synthesizes:
        return options
    standing = Trajectory(recording.timestamps_us[[0, -1]], np.stack([np.eye(4), np.eye(4)]))
    return replace(options, use_reference_motion=False, poses=KnownPoses(standing))


def write_view_files(folder: Path, built: BuiltClip) -> dict[str, Any]:
    """Write one mp4 per view, a mask of those that were not seen whole, pictures, and the plan of what was made.

    Each file appears whole; the plan, which is returned, is written last.

    Raises:
        InputError: the folder cannot be written to.
    """
    make_folder(folder)
    streams = built.clip.streams
    for name, stream in streams.items():
        write_video(folder / f"{name}.mp4", stream.frames, stream.frame_rate)
        if stream.origin is not None:
            with write_whole(folder / f"{name}.{PIXEL_ORIGIN}.parquet") as temporary:
                temporary.write_bytes(encode_origin(stream.timestamps_us, stream.origin))
    times_us = next(iter(streams.values())).timestamps_us
    pictures = write_clip_pictures(folder, "views", built.clip.images, built.clip.origins, times_us)
    left_out = built.left_out
    if not built.plan.synthesizes:
        left_out += (Omission("motion of the vehicle", "no wanted view needs it"),)
    plan = {
        "recording": built.clip.name,
        "views": {
            name: summarize_view(view) | {"method": built.plan.methods[name], "file": str(folder / f"{name}.mp4")}
            for name, view in built.clip.provenance.items()
        },
        "order": list(built.plan.methods),
        "left_out": [omission.to_dict() for omission in left_out],
        "assumptions": list(built.assumptions),
        "seconds": dict(built.seconds),
        "pictures": pictures,
    }
    with write_whole(folder / "plan.json") as temporary:
        temporary.write_text(json.dumps(plan, indent=2, allow_nan=False) + "\n")
    return plan
