"""What KITTI's raw data and its odometry benchmark share: the car, its images, and drive folders as a data set.

Only the front camera is read, so all other views of the target rig have to be made.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from olt_datasets.sources.times import images_within, nearest_images, starting_at
from olt_generator.errors import InputError
from olt_generator.files import read_bounded
from olt_generator.video import shrink
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.drives import WHOLE, DatasetReader, Drive, Licence
from olt_toolkit.recordings.pictures import LARGEST_BYTES, decode_picture
from olt_toolkit.recordings.recording import OpenOptions, Recording
from olt_toolkit.rigs.rig import FRONT_WIDE, VehicleDimensions

LICENCE = Licence(
    "CC BY-NC-SA 3.0",
    "Download from the KITTI page with an account.",
    "Non-commercial use only, with attribution, and derived data under the same licence.",
)
_LARGEST_TEXT = 64 << 20
# VW Passat B6 estate, KITTI's car; the rear overhang places the centre of the box.
PASSAT = VehicleDimensions(
    length=4.774, width=1.820, height=1.517, rear_axle_to_bbox_center=1.36, wheelbase=2.709, track_width=1.551
)


class KittiDrive(Protocol):
    """A drive folder, of which times, calibration and names of files are read; images and poses as they are needed."""

    camera: str
    images: list[Path]
    image_us: NDArray[np.int64]
    has_motion: bool
    notes: tuple[str, ...]

    def identify(self) -> str:
        """What tells the drive from all others, wherever its folder lies and whatever it is called."""
        ...

    def record(self, indices: NDArray[np.intp], width: int) -> Recording:
        """Decode some images, shrunk to `width`, else InputError; times are the drive's, and so is the reference."""
        ...


class KittiDrives:
    """Drive folders as a data set; see `Dataset`."""

    licence = LICENCE

    def __init__(self, source: str, root: Path, folders: dict[str, Path], read: Callable[[Path], KittiDrive]) -> None:
        self.source, self._root, self._folders, self._read = source, root, folders, read

    def keys(self) -> list[str]:
        """See `Dataset.keys`: paths of the drive folders."""
        return sorted(self._folders)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; no image is decoded."""
        drive = self._read(self._folder(key))
        return Drive(
            source=self.source,
            scene_id=f"{self.source}/{drive.identify()}",
            key=key,
            front_us=drive.image_us,
            cameras=(drive.camera,),
            ego_span_us=(0, int(drive.image_us[-1])) if drive.has_motion else None,
            true_views=(FRONT_WIDE,),
            country="DE",
            notes=drive.notes,
        )

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """See `Dataset.peek`; every image is decoded on its own."""
        drive = self._read(self._folder(key))
        numbers = nearest_images(drive.image_us, times_us)
        distinct, places = np.unique(numbers, return_inverse=True)
        images, _ = read_images([drive.images[number] for number in distinct], width)
        return images[places], drive.image_us[numbers]

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`."""
        folder = self._folder(key)
        options.refuse_camera(str(folder))
        drive = self._read(folder)
        recording = drive.record(images_within(drive.image_us, window_us, str(folder)), options.width)
        start_us = int(recording.timestamps_us[0])
        reference = None if recording.reference is None else starting_at(recording.reference, start_us)
        return replace(recording, timestamps_us=recording.timestamps_us - start_us, reference=reference)

    def _folder(self, key: str) -> Path:
        if key not in self._folders:
            raise InputError(f"{self._root}: there is no KITTI drive {key!r}")
        return self._folders[key]


def kitti_reader(name: str, is_drive: Callable[[Path], bool], read: Callable[[Path], KittiDrive]) -> DatasetReader:
    """The reader of drive folders that `is_drive` tells by their names and `read` reads."""

    def find(root: Path) -> dict[str, Path]:
        """Drive folders by key: the root itself, or folders in it, or in its folders of dates or in `sequences`."""
        if is_drive(root.resolve()):
            return {WHOLE: root.resolve()}
        folders = [path for path in (*root.glob("*"), *root.glob("*/*")) if path.is_dir()]
        return {path.relative_to(root).as_posix(): path.resolve() for path in folders if is_drive(path)}

    return DatasetReader(
        name, LICENCE, lambda path: bool(find(path)), lambda path, _: KittiDrives(name, path, find(path), read)
    )


def list_images(folder: Path) -> list[Path]:
    """The image files of a folder in the order of their names."""
    pictures = (file for file in folder.iterdir() if file.suffix.lower() in (".png", ".jpg", ".jpeg"))
    return sorted(file for file in pictures if file.is_file())


def read_text(path: Path) -> str:
    """A text file of a drive; what is no text in it is replaced. InputError where it cannot be read."""
    return read_bounded(path, "text file", _LARGEST_TEXT).decode("utf-8", errors="replace")


def read_images(files: list[Path], width: int) -> tuple[NDArray[np.uint8], tuple[int, int]]:
    """Images (n, H, W, 3) RGB, shrunk to `width`, and the width and height that all, else InputError, are stored in."""
    images, size = [], None
    for file in files:
        image = decode_picture(read_bounded(file, "image", LARGEST_BYTES), str(file))
        if size not in (None, image.shape[1::-1]):
            raise InputError(f"{file}: is {image.shape[1]} x {image.shape[0]} pixels, unlike the images before it")
        size = image.shape[1], image.shape[0]
        images.append(shrink(image, width))
    assert size is not None  # a window holds at least one image
    return np.stack(images), size


def check_increasing(times: NDArray[np.int64], path: Path) -> NDArray[np.int64]:
    """The times (n,) as they are; InputError where one of them is not after the one before it."""
    wrong = np.flatnonzero(np.diff(times) <= 0)
    if len(wrong):
        raise InputError(f"{path}, line {wrong[0] + 2}: its time is not after the one before it; copy the drive again")
    return times
