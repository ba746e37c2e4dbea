"""PandaSet: six cameras at 10 Hz for 8 s, each image with its pose in the world.

Layout of a sequence, a folder of three digits: `camera/<name>_camera/NN.jpg` with `intrinsics.json`, `poses.json` and
`timestamps.json`. LiDAR sweeps and annotations are pickles and never read.

The vehicle's motion comes from the poses of the front camera, camera to world; the LiDAR poses are reported to be
unreliable. The body frame of this data set, the LiDAR's, has x to the left and y to the back: the package's rig
`pandaset` is turned over to x forward and y left, and with it everything here. `intrinsics.json` does not tell the
distortion, which the images have; the static calibration does.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from olt_datasets.sources.content import hash_content, read_content
from olt_datasets.sources.surround import CameraImages, SurroundDrive
from olt_generator import BrownConradyCamera, InputError, Trajectory
from olt_generator.poses import Array, invert, pose_from_quaternion
from olt_toolkit import DatasetReader, Drive, Licence, OpenOptions, Recording
from olt_toolkit.policy.window import FUTURE_OFFSETS_US, HISTORY_OFFSETS_US, Span
from olt_toolkit.rigs.rig_files import load_rig
from olt_toolkit.runtime.json_files import read_json

SOURCE = "pandaset"
FRONT = "front_camera"
LICENCE = Licence(
    name="PandaSet (CC BY 4.0 with additional terms)",
    access="No longer served by its makers; community mirrors carry it.",
    terms="Commercial use allowed with attribution; no identification of persons, no use of names or marks.",
)
_LARGEST_JSON_BYTES = 16 * 2**20
_NEEDED_US = int(FUTURE_OFFSETS_US[-1] - HISTORY_OFFSETS_US[0])

Content = TypeVar("Content")
Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class _Intrinsics(BaseModel):
    fx: Positive
    fy: Positive
    cx: Number
    cy: Number


class _Position(BaseModel):
    x: Number
    y: Number
    z: Number


class _Heading(_Position):
    w: Number


class _Pose(BaseModel):
    """Camera to world."""

    position: _Position
    heading: _Heading


class Pandaset:
    """The sequences in a folder."""

    source = SOURCE
    licence = LICENCE

    def __init__(self, root: Path, _: Path) -> None:
        self._root = root
        self._folders = _sequences(root)
        self._rig = load_rig("pandaset")
        if not self._folders:
            raise InputError(f"{root}: holds no PandaSet sequence; give the folder that holds 001, 002, ...")

    def keys(self) -> list[str]:
        """See `Dataset.keys`: the sequences whose front images are there."""
        return sorted(self._folders)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`."""
        drive = self._read(key)
        span_us = int(drive.ego.timestamps_us[-1])
        note = (
            f"The {len(drive.ego)} images and poses of the drive span {span_us / 1e6:.3f} s and a policy sample needs "
            f"{_NEEDED_US / 1e6:.1f} s of motion: "
        )
        if span_us < _NEEDED_US:
            return drive.describe(notes=(f"{note}none fits.",))
        first = -int(HISTORY_OFFSETS_US[0]) / 1e6
        last = (span_us - int(FUTURE_OFFSETS_US[-1])) / 1e6
        return drive.describe(
            notes=(
                f"{note}t0 can only lie between {first:.3f} and {last:.3f} s of the drive, the time of the 16th image; "
                "as loaders refuse t0 up to 1.6 s, clip time must begin before the first image.",
            )
        )

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """See `Dataset.peek`."""
        return self._read(key).peek(times_us, width)

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`; the front images are freed of their distortion."""
        return self._read(key).open(window_us, options)

    def _read(self, key: str) -> SurroundDrive:
        if key not in self._folders:
            raise InputError(
                f"{self._root / key / 'camera' / FRONT}: no such folder; PandaSet has no sequence {key!r} here"
            )
        folder = self._folders[key] / "camera"
        times = _read_times(folder / FRONT)
        start = times[0]
        cameras = {name: self._camera(folder / name, start) for name in self._rig.cameras if (folder / name).is_dir()}
        front = cameras[FRONT]
        T_world_camera = _read_poses(folder / FRONT, len(front.files))
        return SurroundDrive(
            source=SOURCE,
            key=key,
            scene=hash_content(times, read_content(front.files[0])),
            front=FRONT,
            cameras=cameras,
            ego=Trajectory(front.times_us, T_world_camera @ invert(front.mounted.T_rig_camera)),
            vehicle=self._rig.vehicle,
            assumptions=(
                "Lens distortion and mounting of the cameras are those of PandaSet's static calibration.",
                *self._rig.assumptions,
            ),
        )

    def _camera(self, folder: Path, start: float) -> CameraImages:
        """Images, times and lens of one camera; `start` is drive time 0 in seconds."""
        times_us = np.rint((_read_times(folder) - start) * 1e6).astype(np.int64)
        files = tuple(sorted(folder.glob("*.jpg")))
        if len(files) != len(times_us):
            raise InputError(
                f"{folder / 'timestamps.json'}: {len(times_us)} times for {len(files)} images; copy the camera again"
            )
        if np.any(np.diff(times_us) <= 0):
            index = int(np.argmax(np.diff(times_us) <= 0)) + 1
            raise InputError(f"{folder / 'timestamps.json'}: time {index} is not after the one before it")
        # The lens of the sequence's own file with the distortion and the mounting of the static calibration.
        own, mounted = _read_json(folder / "intrinsics.json", TypeAdapter(_Intrinsics)), self._rig[folder.name]
        if not isinstance(mounted.camera, BrownConradyCamera):
            raise TypeError(f"rig pandaset: {folder.name} must be a brown_conrady camera")
        lens = replace(mounted.camera, fx=own.fx, fy=own.fy, cx=own.cx, cy=own.cy)
        return CameraImages(replace(mounted, camera=lens), files, times_us)


def _sequences(root: Path) -> dict[str, Path]:
    """The sequences with front images, by name."""
    return {
        folder.name: folder
        for folder in root.glob("[0-9][0-9][0-9]")
        if folder.name.isdecimal() and (folder / "camera" / FRONT).is_dir()
    }


def _read_times(folder: Path) -> NDArray[np.float64]:
    """Seconds (n,) of a camera's images."""
    path = folder / "timestamps.json"
    times = np.array(_read_json(path, TypeAdapter(list[Number])))
    if len(times) < 2:
        raise InputError(f"{path}: holds {len(times)} times; a drive needs at least two images")
    return times


def _read_poses(folder: Path, count: int) -> Array:
    """Poses (n, 4, 4) of a camera in the world."""
    path = folder / "poses.json"
    poses = _read_json(path, TypeAdapter(list[_Pose]))
    if len(poses) != count:
        raise InputError(f"{path}: {len(poses)} poses for {count} images; copy the camera again")
    turns = np.array([[pose.heading.x, pose.heading.y, pose.heading.z, pose.heading.w] for pose in poses])
    wrong = np.flatnonzero(np.abs(np.linalg.norm(turns, axis=1) - 1.0) > 1e-3)
    if len(wrong):
        raise InputError(f"{path}: {wrong[0]}.heading: a quaternion must have length 1")
    places = np.array([[pose.position.x, pose.position.y, pose.position.z] for pose in poses])
    return pose_from_quaternion(turns, places)


def _read_json(path: Path, content: TypeAdapter[Content]) -> Content:
    try:
        return content.validate_python(read_json(path, "table of a sequence", _LARGEST_JSON_BYTES))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}: {place}: {first['msg']}") from error


DATASET = DatasetReader(SOURCE, LICENCE, lambda path: bool(_sequences(path)), Pandaset)
