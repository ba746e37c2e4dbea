"""KITTI's raw data and its odometry benchmark as data sets: every drive folder or sequence is a drive.

Only the front camera is read, so all other views of the target rig have to be made.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from olt_datasets.sources import kitti_odometry, kitti_raw
from olt_datasets.sources.image_times import starting_at
from olt_datasets.sources.windows import images_within
from olt_generator.errors import InputError
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.drives import Drive, Licence
from olt_toolkit.recordings.recording import OpenOptions, Recording
from olt_toolkit.rigs.rig import FRONT_WIDE

LICENCE = Licence(
    "CC BY-NC-SA 3.0",
    "Download from the KITTI page with an account.",
    "Non-commercial use only, with attribution, and derived data under the same licence.",
)
# Raw drives that the sequences of the odometry benchmark were cut from (its development kit).
RAW_DRIVES = {
    "00": "2011_10_03_drive_0027",
    "01": "2011_10_03_drive_0042",
    "02": "2011_10_03_drive_0034",
    "03": "2011_09_26_drive_0067",
    "04": "2011_09_30_drive_0016",
    "05": "2011_09_30_drive_0018",
    "06": "2011_09_30_drive_0020",
    "07": "2011_09_30_drive_0027",
    "08": "2011_09_30_drive_0028",
    "09": "2011_09_30_drive_0033",
    "10": "2011_09_30_drive_0034",
}
_RAW_NAME = re.compile(r"\d{4}_\d\d_\d\d_drive_\d{4}")


class _Folder(Protocol):
    """What both kinds of drive folders answer."""

    @property
    def image_us(self) -> NDArray[np.int64]: ...

    def record(self, indices: NDArray[np.intp], width: int) -> Recording: ...


class KittiRaw:
    """Raw drives in a folder; see `Dataset`."""

    source = kitti_raw.NAME
    licence = LICENCE

    def __init__(self, root: Path) -> None:
        self._root = root
        self._folders = _find(root, kitti_raw.SOURCE.recognises)

    def keys(self) -> list[str]:
        """See `Dataset.keys`: paths of the drive folders; `.` for the folder itself."""
        return sorted(self._folders)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; no image and no GPS/IMU file is read."""
        folder = _folder(self._root, self._folders, key)
        name = _RAW_NAME.search(folder.name)
        drive = kitti_raw.KittiRawDrive(folder)
        return _describe(self.source, name[0] if name else folder.name, key, drive, "image_02", kitti_raw.ASSUMPTIONS)

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`; field of view and height come from the calibration, whatever the options say."""
        folder = _folder(self._root, self._folders, key)
        return _open(kitti_raw.KittiRawDrive(folder), window_us, options, str(folder))


class KittiOdometry:
    """Sequences of the odometry benchmark in a folder; see `Dataset`."""

    source = kitti_odometry.NAME
    licence = LICENCE

    def __init__(self, root: Path) -> None:
        self._root = root
        self._folders = _find(root, kitti_odometry.SOURCE.recognises)

    def keys(self) -> list[str]:
        """See `Dataset.keys`: paths of the sequence folders; `.` for the folder itself."""
        return sorted(self._folders)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; no image is read."""
        folder = _folder(self._root, self._folders, key)
        sequence = self._sequence(folder)
        notes = sequence.assumptions
        if folder.name in RAW_DRIVES:
            notes += (f"It is a part of KITTI's raw drive {RAW_DRIVES[folder.name]}; do not split them apart.",)
        described = _describe(self.source, folder.name, key, sequence, "image_0", notes)
        return described if sequence.has_poses else replace(described, ego_span_us=None)

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`; field of view and height are those of KITTI's car, whatever the options say."""
        folder = _folder(self._root, self._folders, key)
        return _open(self._sequence(folder), window_us, options, str(folder))

    def _sequence(self, folder: Path) -> kitti_odometry.KittiOdometrySequence:
        """The sequence with its poses, which the benchmark keeps in a folder of their own."""
        apart = folder.parent.parent / "poses" / f"{folder.name}.txt"
        return kitti_odometry.KittiOdometrySequence(folder, apart if apart.is_file() else None)


class KittiRawReader:
    """Opens folders of raw drives; see `DatasetReader`."""

    name = KittiRaw.source
    licence = LICENCE

    def recognises(self, root: Path) -> bool:
        """See `DatasetReader.recognises`; judged by the folders."""
        return bool(_find(root, kitti_raw.SOURCE.recognises))

    def open(self, root: Path, cache: Path) -> KittiRaw:
        """See `DatasetReader.open`; nothing is cached."""
        return KittiRaw(root)


class KittiOdometryReader:
    """Opens folders of sequences; see `DatasetReader`."""

    name = KittiOdometry.source
    licence = LICENCE

    def recognises(self, root: Path) -> bool:
        """See `DatasetReader.recognises`; judged by the folders."""
        return bool(_find(root, kitti_odometry.SOURCE.recognises))

    def open(self, root: Path, cache: Path) -> KittiOdometry:
        """See `DatasetReader.open`; nothing is cached."""
        return KittiOdometry(root)


def _find(root: Path, is_drive: Callable[[Path], bool]) -> dict[str, Path]:
    """Drive folders by key: the root itself, or folders in it, or in its folders of dates or in `sequences`."""
    if is_drive(root.resolve()):
        return {".": root.resolve()}
    folders = [path for path in (*root.glob("*"), *root.glob("*/*")) if path.is_dir()]
    return {path.relative_to(root).as_posix(): path.resolve() for path in folders if is_drive(path)}


def _folder(root: Path, folders: dict[str, Path], key: str) -> Path:
    if key not in folders:
        raise InputError(f"{root}: there is no KITTI drive {key!r}")
    return folders[key]


def _describe(source: str, name: str, key: str, drive: _Folder, camera: str, notes: tuple[str, ...]) -> Drive:
    return Drive(
        source=source,
        scene_id=f"{source}/{name}",
        key=key,
        front_us=drive.image_us,
        cameras=(camera,),
        ego_span_us=(0, int(drive.image_us[-1])),
        true_views=(FRONT_WIDE,),
        country="DE",
        notes=notes,
    )


def _open(drive: _Folder, window_us: Span, options: OpenOptions, where: str) -> Recording:
    inside = images_within(drive.image_us, window_us, where)
    recording = drive.record(inside, options.width)
    start_us = int(recording.timestamps_us[0])
    reference = None if recording.reference is None else starting_at(recording.reference, start_us)
    return replace(recording, timestamps_us=recording.timestamps_us - start_us, reference=reference)


RAW, ODOMETRY = KittiRawReader(), KittiOdometryReader()
