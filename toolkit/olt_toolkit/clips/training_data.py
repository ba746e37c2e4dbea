"""Training clips of drives of which all six views are true: windows, their splits, and their videos."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from olt_generator.diffusion.splits import Split, Window, assign_splits
from olt_generator.diffusion.training_clips import ClipVideos, TrueView, make_videos
from olt_generator.diffusion.training_settings import TrainingSettings
from olt_generator.diffusion.view_graph import VIEWS
from olt_generator.distance.depth import estimate_distance
from olt_generator.errors import InputError
from olt_generator.trajectory import Trajectory
from olt_generator.views.front_view import FrontView
from olt_generator.views.moving_objects import check_distances
from olt_toolkit.recordings.drives import Dataset
from olt_toolkit.recordings.recording import OpenOptions, Recording
from olt_toolkit.rigs.rig_files import pav_rig

# Working width of the drives, in widths of the straight-lined images: the warp keeps detail, and little is decoded.
_OVERSAMPLING = 2


@dataclass(frozen=True)
class TrainingWindow:
    """A window of a drive, its split, and the numbers of its front images in the drive."""

    key: str
    window: Window
    split: Split
    indices: tuple[int, ...]


def plan_windows(dataset: Dataset, settings: TrainingSettings, seed: int) -> list[TrainingWindow]:
    """Windows of all drives, spread over each with gaps between them, and their splits; no image is decoded.

    Raises:
        InputError: a drive has not all views or no measured motion, all are too short, or see `assign_splits`.
    """
    found: list[tuple[str, Window, tuple[int, ...]]] = []
    keys = dataset.keys()
    for key in keys:
        drive = dataset.drive(key)
        missing = [name for name in VIEWS if name not in drive.true_views]
        if missing or drive.ego_span_us is None:
            raise InputError(
                f"{drive.scene_id}: has no true {', '.join(missing) or 'motion'}; training takes drives with six views "
                "and measured motion"
            )
        span = settings.frames + 1
        count = min(settings.windows, len(drive.front_us) // span)
        for first in np.linspace(0, len(drive.front_us) - span, count).astype(int).tolist():
            indices = tuple(range(first, first + settings.frames))
            first_us, last_us = int(drive.front_us[first]), int(drive.front_us[indices[-1]])
            found.append((key, Window(drive.source, drive.scene_id, first_us, last_us), indices))
    if not found:
        raise InputError(f"no drive has {settings.frames + 1} images; give longer drives")
    splits = assign_splits([window for _, window, _ in found], settings.seen, settings.unseen, seed)
    return [
        TrainingWindow(key, window, split, indices) for (key, window, indices), split in zip(found, splits, strict=True)
    ]


def frame_time(dataset: Dataset, windows: Sequence[TrainingWindow]) -> int:
    """Microseconds between images of the windows, which must be the same in all of them to 2 %.

    Raises:
        InputError: it differs.
    """
    steps = [(each.window.last_us - each.window.first_us) / (len(each.indices) - 1) for each in windows]
    middle = float(np.median(steps))
    odd = int(np.argmax(np.abs(np.subtract(steps, middle))))
    if abs(steps[odd] - middle) > 0.02 * middle:
        raise InputError(
            f"{windows[odd].window.scene}: {steps[odd]:.0f} us between images, others have {middle:.0f}; train on "
            "drives of one frame rate"
        )
    return round(middle)


def make_window_videos(
    dataset: Dataset, windows: Sequence[TrainingWindow], settings: TrainingSettings
) -> Iterator[ClipVideos]:
    """The videos of windows in their order; a drive is opened once for all of its windows that follow one another."""
    opened: tuple[str, FrontView, dict[str, TrueView]] | None = None
    for each in windows:
        if opened is None or opened[0] != each.key:
            opened = (each.key, *_open(dataset, each.key, settings))
        _, front, views = opened
        yield make_videos(front, views, each.indices, settings.width, settings.height)


def _open(dataset: Dataset, key: str, settings: TrainingSettings) -> tuple[FrontView, dict[str, TrueView]]:
    """The whole drive with true motion, and true distance where it is known."""
    options = OpenOptions(width=_OVERSAMPLING * settings.width, views=VIEWS, true_distance=True)
    last_us = int(dataset.drive(key).front_us[-1])
    recording = dataset.open(key, (0, last_us), options)
    if recording.reference is None:
        raise InputError(f"{key}: has no measured motion; training takes drives that have")
    motion = Trajectory(recording.timestamps_us, recording.reference.interpolate(recording.timestamps_us))
    front = _front(recording, motion)
    rig = pav_rig()
    views = {}
    for name in VIEWS[1:]:
        if name not in recording.views:
            raise InputError(f"{key}: has no true {name}")
        images = recording.views[name]
        mounted = recording.mounted.get(name)
        if mounted is None:
            mounted = rig.fitted(images.shape[2], images.shape[1])[name]
        views[name] = TrueView(images, mounted.camera, mounted.T_rig_camera)
    return front, views


def _front(recording: Recording, motion: Trajectory) -> FrontView:
    place = (motion, recording.camera, recording.T_rig_camera)
    if recording.distance is not None:
        return check_distances(FrontView(recording.frames, recording.distance, *place))
    found = estimate_distance(recording.frames, recording.camera, motion, recording.T_rig_camera)
    return check_distances(FrontView(recording.frames, found.distance, *place, found.confidence, found.moving))
