"""Argoverse 2 as a data set of trajectories: motion scenarios, and the ego motion of sensor logs.

Layout: `<split>/<scenario>/scenario_*.parquet` or `<split>/<log>/city_SE3_egovehicle.feather`, or such folders without
splits. Motion scenarios have no images at all, and those of sensor logs are not read: the drives serve trajectory
priors and statistics of actions, and cannot be opened as recordings.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.sources.argoverse2 import read_motion_ego, read_scenario_id, read_sensor_ego
from olt_datasets.sources.content import hash_content, read_content
from olt_generator import InputError, Trajectory
from olt_toolkit import DatasetReader, Drive, Licence, OpenOptions, Recording
from olt_toolkit.clips.clip import Split
from olt_toolkit.policy.window import Span

NAME = "argoverse2"
LICENCE = Licence(
    "CC BY-NC-SA 4.0",
    "Free download from the Argoverse page.",
    "Non-commercial use only, with attribution, and derived data under the same licence.",
)
_SCENARIO, _LOG = "scenario_*.parquet", "city_SE3_egovehicle.feather"
_DEPTHS = ("", "*/", "*/*/")
_SPLITS: tuple[Split, ...] = ("train", "val", "test")
_NOTES = {
    _SCENARIO: (
        "It has no images: trajectories only, 11 s at 10 Hz in the plane.",
        "The recorded position is taken for the rear axle, whose sideways speed in bends it has.",
    ),
    _LOG: ("Images of sensor logs are not read: trajectories only.",),
}


class Argoverse2:
    """Scenarios and logs in a folder; see `Dataset`."""

    source = NAME
    licence = LICENCE

    def __init__(self, root: Path, _: Path) -> None:
        self._root = root
        # A folder that holds both is a scenario.
        self._files = {key: file for file in (_LOG, _SCENARIO) for key in _keys(root, file)}

    def keys(self) -> list[str]:
        """See `Dataset.keys`: paths of the folders; `.` for the folder itself."""
        return sorted(self._files)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; drive time 0 is the first pose, as there are no images."""
        ego = self.ego_motion(key)
        folder = (self._root / key).resolve()
        (file,) = folder.glob(self._files[key])
        scene = read_scenario_id(file) if self._files[key] == _SCENARIO else None
        return Drive(
            source=NAME,
            scene_id=f"{NAME}/{scene or hash_content(read_content(file))}",
            key=key,
            front_us=np.empty(0, np.int64),
            cameras=(),
            ego_span_us=(0, int(ego.timestamps_us[-1])),
            true_views=(),
            country="US",
            split=next((split for split in _SPLITS if split == folder.parent.name), None),
            notes=_NOTES[self._files[key]],
        )

    def ego_motion(self, key: str) -> Trajectory:
        """The motion of the rig over a drive, else InputError; its frame is the city's, moved to a scenario's start."""
        if key not in self._files:
            raise InputError(f"{self._root}: there is no Argoverse 2 drive {key!r}")
        return (read_motion_ego if self._files[key] == _SCENARIO else read_sensor_ego)(self._root / key)

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """See `Dataset.peek`; always refused."""
        raise self._no_images(key)

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`; always refused."""
        raise self._no_images(key)

    def _no_images(self, key: str) -> InputError:
        return InputError(
            f"Argoverse 2 drive {key}: has no images to open; take its trajectory with `ego_motion`, or drive it in "
            "the closed loop as a scene"
        )


def _keys(root: Path, file: str) -> set[str]:
    return {path.parent.relative_to(root).as_posix() for depth in _DEPTHS for path in root.glob(depth + file)}


DATASET = DatasetReader(
    NAME,
    LICENCE,
    lambda path: any(any(path.glob(depth + file)) for file in (_SCENARIO, _LOG) for depth in _DEPTHS),
    Argoverse2,
)
