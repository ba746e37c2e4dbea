"""The front video to a metric trajectory, four views, and a clip."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from olt_closed_loop.scenes.scene_file import read_scene
from olt_closed_loop.sensors.recorder import record_drive
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_sft_recipes.demo.settings import DemoSettings
from olt_toolkit.clips.builder import BuiltClip, build_clip
from olt_toolkit.clips.pictures import contact_sheet, write_picture
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.summary import summarize_build
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.recordings import OpenOptions, Recording, open_recording
from olt_toolkit.report.drawings import draw_trajectory
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_WIDE

CONTACT_SHEET, TRUE_SHEET, TRAJECTORY = "four_views.png", "true_cross_views.png", "trajectory.svg"


@dataclass(frozen=True)
class InputOrder:
    """The input clip to build.

    Attributes:
        input: what the user gave, or the stage to drive in its place.
        store: the clip store that it goes into.
        pictures: folder of what the report shows.
        settings: sizes and seed.
    """

    input: Recording | Path
    store: Path
    pictures: Path
    settings: DemoSettings


def build_input_clip(order: InputOrder) -> dict[str, Any]:
    """Turn the input into a clip of the store, and draw what was made; returns the numbers."""
    recording, options = _take_input(order)
    built = build_clip(recording, options)
    store = ClipStore(order.store)
    info = store.prepare(built.clip)
    store.commit([built.clip.clip_id])
    _check_read_back(store, built)
    _draw(order.pictures, recording, built)
    return summarize_build(built, info)


def open_video(video: Path, settings: DemoSettings) -> Recording:
    """Decode as much of a front video as the job uses.

    Raises:
        InputError: the video cannot be used.
    """
    return open_recording(video, OpenOptions(duration=settings.video_seconds))


def _take_input(order: InputOrder) -> tuple[Recording, BuildOptions]:
    """The recording and how its clip is built; a user's video has no category and no scene factors that are known."""
    height, width = order.settings.input_size
    options = BuildOptions(width=width, height=height, seed=order.settings.seed, name="input")
    if isinstance(order.input, Recording):
        return order.input, options
    scene = read_scene(order.input)
    cameras = (CROSS_LEFT, FRONT_WIDE, CROSS_RIGHT)
    recording = record_drive(scene, width, height, order.settings.frame_rate, cameras, with_distance=True)
    return recording, replace(options, category=scene.category, factors=scene.factors, image_kind="rendered")


def _check_read_back(store: ClipStore, built: BuiltClip) -> None:
    """The clip on disk is the clip that was built."""
    clip = built.clip
    ego = store.read_ego_motion(clip.clip_id).trajectory
    same_motion = np.allclose(ego.T_world_rig, clip.ego_motion.trajectory.T_world_rig, atol=1e-6)
    times = clip.streams[FRONT_WIDE].timestamps_us
    if not same_motion or not np.array_equal(store.read_timestamps(clip.clip_id, FRONT_WIDE), times):
        raise InputError(f"{store.root}: clip {clip.clip_id} reads back as something else; check the disk")


def _draw(pictures: Path, recording: Recording, built: BuiltClip) -> None:
    images = {camera: stream.frames for camera, stream in built.clip.streams.items()}
    # Fewer than the recording's: frames that no sample shows are not made.
    times_us = built.clip.streams[FRONT_WIDE].timestamps_us
    write_picture(pictures / CONTACT_SHEET, contact_sheet(images, built.observed, times_us))
    if recording.views:
        write_picture(pictures / TRUE_SHEET, contact_sheet(recording.views, {}, recording.timestamps_us))
    if built.motion is not None:
        drawing = draw_trajectory(built.motion.measured, built.motion.smoothed.trajectory, recording.reference)
        with write_whole(pictures / TRAJECTORY) as path:
            path.write_text(drawing)
