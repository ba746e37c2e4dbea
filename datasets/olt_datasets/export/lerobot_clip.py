"""One clip of a LeRobot export: its frames on the policy's time grid, and their videos.

A frame of the data set is a moment of the 0.1 s grid with one image of each policy camera, the past 16 poses as state
and the next 64 as action, all in the rig frame of that moment. A policy that looks back takes images of earlier
frames, so three frames stand before each sample time, where the ego motion reaches back far enough to give their state.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_datasets.export.contents import ExportItem
from olt_datasets.export.writing import finished_part, naming, note_finished
from olt_generator import InputError, write_video
from olt_generator.poses import Array, invert, yaw_of
from olt_toolkit import ClipStore, EgoMotion
from olt_toolkit.clips.images import resize_images
from olt_toolkit.policy.contract import STEP_US
from olt_toolkit.policy.window import FUTURE_OFFSETS_US, HISTORY_OFFSETS_US, IMAGE_OFFSETS_US
from olt_toolkit.rigs.rig import POLICY_CAMERAS

FRAME_RATE = 10
FILES_PER_CHUNK = 1000
POSE_FIELDS = ("x", "y", "z", "yaw")

Levels = NDArray[np.int64]
"""How often each of the 256 levels occurs in each colour: (3, 256)."""


@dataclass(frozen=True)
class ClipFrames:
    """The frames of one clip.

    Attributes:
        number: number of the clip among all clips of the export; its videos are called by it.
        times_us: (n,) clip times, in runs at the distance of the grid.
        is_sample: (n,) whether the frame is one of the sample times, and not one that stands before them.
        state: (n, 64) float32: x, y, z in metres and yaw of the 16 past poses.
        action: (n, 256) float32: the same of the 64 future poses.
        levels: levels of the images by camera.
    """

    item: ExportItem
    number: int
    times_us: NDArray[np.int64]
    is_sample: NDArray[np.bool_]
    state: NDArray[np.float32]
    action: NDArray[np.float32]
    levels: dict[str, Levels]

    @property
    def runs(self) -> list[tuple[int, int]]:
        """Ranges (first, end) of frames that follow each other on the grid: the episodes."""
        breaks = np.flatnonzero(np.diff(self.times_us) != STEP_US) + 1
        edges = [0, *breaks.tolist(), len(self.times_us)]
        return list(pairwise(edges))


def video_key(camera: str) -> str:
    """Name of a camera's feature."""
    return f"observation.images.{camera}"


def numbered_file(folder: Path, number: int, suffix: str) -> Path:
    """Where a file of LeRobot's numbered chunks lies; the video of a clip has the clip's number."""
    chunk, file = divmod(number, FILES_PER_CHUNK)
    return folder / f"chunk-{chunk:03d}" / f"file-{file:03d}.{suffix}"


def write_clip(
    root: Path, image_size: tuple[int, int], keep_going: bool, job: tuple[int, ExportItem]
) -> ClipFrames | str:
    """Write the videos of one clip, unless an earlier run has, and work out its frames.

    What is wrong with it is returned, or an InputError where `keep_going` is off or a file cannot be written.
    """
    number, item = job
    videos = {camera: numbered_file(root / "videos" / video_key(camera), number, "mp4") for camera in POLICY_CAMERAS}
    try:
        store = ClipStore(item.store)
        store.check(item.clip_id, item.t0s_us)
        motion = store.read_ego_motion(item.clip_id)
        times_us = frame_times(item.t0s_us, motion.span_us[0])
        return ClipFrames(
            item,
            number,
            times_us,
            is_sample=np.isin(times_us, item.t0s_us),
            state=_pose_fields(motion, times_us, HISTORY_OFFSETS_US),
            action=_pose_fields(motion, times_us, FUTURE_OFFSETS_US),
            levels=_write_videos(root, videos, store, item.clip_id, number, times_us, image_size),
        )
    except InputError as error:
        for video in videos.values():
            video.unlink(missing_ok=True)
        if not keep_going:
            raise
        return str(error)


def frame_times(t0s_us: Sequence[int], ego_start_us: int) -> NDArray[np.int64]:
    """Clip times of the frames (n,): the sample times and the images that they look back to.

    Times at which no state can be told are left out. Times on grids of different phase follow each other.
    """
    times = np.unique(np.array(t0s_us, np.int64)[:, None] + IMAGE_OFFSETS_US)
    times = times[times + HISTORY_OFFSETS_US[0] >= ego_start_us]
    return times[np.lexsort((times, times % STEP_US))]


def _pose_fields(motion: EgoMotion, times_us: NDArray[np.int64], offsets_us: NDArray[np.int64]) -> NDArray[np.float32]:
    """Position and yaw (n, 4 m) of the poses at m offsets from each time, in the rig frame at that time."""
    here = motion.interpolate(times_us)
    there = motion.interpolate((times_us[:, None] + offsets_us).ravel()).reshape(len(times_us), -1, 4, 4)
    relative: Array = invert(here)[:, None] @ there
    fields = np.concatenate([relative[..., :3, 3], yaw_of(relative)[..., None]], axis=-1)
    return fields.reshape(len(times_us), -1).astype(np.float32)


def _write_videos(
    root: Path,
    videos: Mapping[str, Path],
    store: ClipStore,
    clip_id: str,
    number: int,
    times_us: NDArray[np.int64],
    size: tuple[int, int],
) -> dict[str, Levels]:
    name = f"clip_{number:06d}"
    finished = finished_part(root, name)
    if finished is not None:
        return {camera: np.array(levels, np.int64) for camera, levels in finished.items()}
    order = np.argsort(times_us)
    levels = {}
    for camera, path in videos.items():
        frames, _ = store.read_frames(clip_id, camera, times_us[order])
        frames = resize_images(frames, size[1], size[0])[np.argsort(order)]
        with naming(path):
            write_video(path, frames, FRAME_RATE)
        levels[camera] = np.stack([np.bincount(frames[..., colour].ravel(), minlength=256) for colour in range(3)])
    note_finished(root, name, {camera: counts.tolist() for camera, counts in levels.items()})
    return levels
