"""The videos of training windows on disk, made by several processes, those of a drive by one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file

from olt_generator.diffusion.tensor_files import read_tensors
from olt_generator.diffusion.training_clips import ClipVideos
from olt_generator.diffusion.training_settings import TrainingSettings
from olt_generator.files import write_whole
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.training_data import TrainingWindow, make_window_videos
from olt_toolkit.recordings.drives import DatasetPlace
from olt_toolkit.runtime.workers import map_parallel


def keep_videos(
    place: DatasetPlace,
    windows: Sequence[TrainingWindow],
    settings: TrainingSettings,
    folder: Path,
    workers: int,
    on_progress: Progress = silent,
) -> None:
    """Make the videos of windows that are not in the folder yet; each file appears whole."""
    missing: dict[str, list[int]] = {}
    for number, window in enumerate(windows):
        if not _video_file(folder, number).exists():
            missing.setdefault(window.key, []).append(number)
    jobs = [
        _DriveJob(place, settings, folder, tuple((number, windows[number]) for number in numbers))
        for numbers in missing.values()
    ]
    map_parallel(_DriveJob.run, jobs, workers, on_progress)


def read_videos(folder: Path, number: int) -> ClipVideos:
    """The videos of the window of this number."""
    tensors = read_tensors(_video_file(folder, number), "remove it, and give the command again")
    return ClipVideos(**{name: value.numpy() for name, value in tensors.items()})


@dataclass(frozen=True)
class _DriveJob:
    """The windows of a drive, by number, whose videos are missing in a folder."""

    place: DatasetPlace
    settings: TrainingSettings
    folder: Path
    windows: tuple[tuple[int, TrainingWindow], ...]

    def run(self) -> None:
        made = make_window_videos(self.place.open(), [window for _, window in self.windows], self.settings)
        for (number, _), clip in zip(self.windows, made, strict=True):
            tensors = {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in vars(clip).items()}
            with write_whole(_video_file(self.folder, number)) as temporary:
                save_file(tensors, temporary)


def _video_file(folder: Path, number: int) -> Path:
    return folder / f"clip_{number:06d}.safetensors"
