"""The Waymo Open data set for end-to-end driving (WOD-E2E): shards of shuffled frames, put together again as drives.

Layout: TFRecord shards `training_*.tfrecord-*`, `val_*` and `test_*`, in the folder or below it. A frame is named
`SEQUENCE-INDEX`; frames are 0.1 s apart. Ego motion is put together from the past and future that every frame tells.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.sources.surround import CameraImages, SurroundDrive
from olt_datasets.sources.waymo.frames import CAMERAS, FrameImages, read_images
from olt_datasets.sources.waymo.index import SHARDS, build_index, positions
from olt_datasets.sources.waymo.motion import FramePath, chain_paths
from olt_datasets.sources.waymo.tfrecord import map_records, read_record
from olt_generator.errors import InputError
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import Split
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.drives import DatasetReader, Drive, Licence
from olt_toolkit.recordings.recording import OpenOptions, Recording
from olt_toolkit.rigs.rig import MountedCamera, VehicleDimensions

NAME = "waymo_e2e"
LICENCE = Licence(
    "Waymo Dataset License Agreement for Non-Commercial Use",
    "Download with an account after accepting the agreement.",
    "Non-commercial use only; the agreement limits how data derived from it may be passed on.",
)
FRONT = CAMERAS[1]
FRAME_US = 100_000
# From the data sheet of the Jaguar I-Pace, without mirrors; the place of the box over the rear axle and the track are
# estimates.
JAGUAR_I_PACE = VehicleDimensions(
    length=4.682, width=1.895, height=1.566, rear_axle_to_bbox_center=1.50, wheelbase=2.990, track_width=1.65
)
_SPLITS: dict[str, Split] = {"training": "train", "train": "train", "val": "val", "validation": "val", "test": "test"}
_USE = "The paper fine-tunes policies with clips of this data set and keeps it out of all training of the generator."
_ASSUMPTIONS = (
    "Frames are 0.1 s apart, and all cameras of one expose at once; the data set tells no times.",
    "The motion is in the plane, and headings follow from the paths that the frames tell; the data set tells none.",
    "The vehicle frame, to which the cameras are calibrated, is taken to be on the ground under the rear axle.",
    "The vehicle has the size of a Jaguar I-Pace, which is what most of Waymo's cars are.",
)


@dataclass(frozen=True)
class _Frames:
    """The frames of one drive, in order of time.

    Attributes:
        rows: rows of the index.
        times_us: (n,) drive times of the rows.
    """

    key: str
    rows: pl.DataFrame
    times_us: NDArray[np.int64]

    @property
    def with_front(self) -> "_Frames":
        """Those with an image of the front camera."""
        has_front = self.rows["cameras"].list.contains(FRONT).to_numpy()
        return _Frames(self.key, self.rows.filter(pl.Series(has_front)), self.times_us[has_front])

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras that have images throughout."""
        seen = [set(names) for names in self.rows["cameras"].to_list()]
        return tuple(name for name in CAMERAS.values() if all(name in names for names in seen))

    @property
    def split(self) -> Split | None:
        """The split that the names of the shards tell."""
        splits: set[Split | None] = {_SPLITS.get(_prefix(name)) for name in self.rows["shard"].unique()}
        if len(splits) > 1:
            raise InputError(f"{self.key}: its frames lie in shards of different splits; give Waymo's shards unchanged")
        return splits.pop()

    @cached_property
    def trajectory(self) -> Trajectory:
        """The motion that the frames tell, in drive time, in the rig of the first frame."""
        paths = [
            FramePath.from_states(int(time_us), positions(past), positions(future))
            for time_us, past, future in zip(self.times_us, self.rows["past"], self.rows["future"], strict=True)
        ]
        return chain_paths(paths, f"Waymo E2E drive {self.key}")


class WaymoE2E:
    """The data set at a folder; see `Dataset`."""

    source = NAME
    licence = LICENCE

    def __init__(self, root: Path, cache: Path) -> None:
        """The first time all shards are indexed."""
        self._root = root
        self._index = build_index(root, cache / NAME)

    def keys(self) -> list[str]:
        """See `Dataset.keys`: the names of the sequences."""
        return pl.scan_parquet(self._index).select(pl.col("sequence").unique().sort()).collect()["sequence"].to_list()

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; no image is read."""
        frames = self._frames(key)
        front = frames.with_front
        rated = front.times_us[front.rows["rated"].to_numpy()]
        described = self._surround(frames).describe(country="US", split=frames.split, notes=(_USE, *_missing(frames)))
        return replace(described, event_t0s_us=tuple(rated.tolist()))

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`; the front images, which are portraits, are freed of their distortion."""
        return self._surround(self._frames(key)).open(window_us, options)

    def _surround(self, frames: _Frames) -> SurroundDrive:
        """The images of a drive and its motion; nothing but the calibration of the first frame is read."""
        front = frames.with_front
        records = self._records(front.rows)
        mounted = records[0].calibrated
        cameras = {}
        for name in front.cameras:
            images = tuple(_RecordImage(record, name, mounted[name]) for record in records)
            cameras[name] = CameraImages(mounted[name], images, front.times_us)
        return SurroundDrive(
            source=NAME,
            key=frames.key,
            front=FRONT,
            cameras=cameras,
            ego=frames.trajectory,
            vehicle=JAGUAR_I_PACE,
            assumptions=_ASSUMPTIONS,
        )

    def _records(self, rows: pl.DataFrame) -> list["_Record"]:
        shards = {name: map_records(self._root / name) for name in rows["shard"].unique()}
        cells = rows.select("shard", "offset", "length").iter_rows()
        return [_Record(shards[name], offset, length, str(self._root / name)) for name, offset, length in cells]

    def _frames(self, key: str) -> _Frames:
        rows = pl.scan_parquet(self._index).filter(pl.col("sequence") == key).sort("index").collect()
        if rows.is_empty():
            raise InputError(f"{self._root}: there is no Waymo E2E drive {key!r}")
        twice = rows.filter(pl.col("index").is_duplicated())
        if not twice.is_empty():
            index, shards = twice["index"][0], ", ".join(twice["shard"].unique().sort())
            raise InputError(
                f"Waymo E2E drive {key}: frame {index} is there more than once ({shards}); give each shard once"
            )
        times_us = FRAME_US * rows["index"].to_numpy().astype(np.int64)
        has_front = rows["cameras"].list.contains(FRONT).to_numpy()
        if not has_front.any():
            raise InputError(f"Waymo E2E drive {key}: no frame has an image of the front camera")
        return _Frames(key, rows, times_us - times_us[has_front.argmax()])


class _Record:
    """A record of a shard."""

    def __init__(self, shard: memoryview, offset: int, length: int, path: str) -> None:
        self._shard, self._offset, self._length, self._path = shard, offset, length, path

    def __str__(self) -> str:
        return f"{self._path}: record at byte {self._offset}"

    @property
    def calibrated(self) -> dict[str, MountedCamera]:
        """The cameras, read without looking at the images, so the checksum of the record is not looked at either."""
        return read_images(self._shard[self._offset : self._offset + self._length], str(self), False).cameras

    @cached_property
    def images(self) -> FrameImages:
        """Images and cameras, checked; all images of a record are asked for one after the other."""
        return read_images(read_record(self._shard, self._offset, self._length, self._path), str(self))


@dataclass(frozen=True)
class _RecordImage:
    """The image of a camera in a record; see `StoredImage`. `mounted` is the camera as the drive has it."""

    record: _Record
    camera: str
    mounted: MountedCamera

    def __str__(self) -> str:
        return f"{self.record}: {self.camera}"

    def read_bytes(self) -> bytes:
        images = self.record.images
        own = images.cameras[self.camera]
        if own.camera != self.mounted.camera or not np.array_equal(own.T_rig_camera, self.mounted.T_rig_camera):
            raise InputError(f"{self}: its calibration is not that of the first frame; give Waymo's shards unchanged")
        return images.jpegs[self.camera]


def _prefix(shard: str) -> str:
    """What the name of a shard begins with: `training` of `folder/training_202504031202...`."""
    return Path(shard).name.partition("_")[0]


def _missing(frames: _Frames) -> tuple[str, ...]:
    indices = frames.rows["index"].to_numpy()
    absent = int(indices[-1] - indices[0] + 1 - len(indices))
    return (f"{absent} frames between the first and the last are missing; they lie in other shards.",) if absent else ()


def _recognise(path: Path) -> bool:
    """Judged by the names of files in the folder and one below."""
    return any(_prefix(shard.name) in _SPLITS for shard in (*path.glob(SHARDS), *path.glob(f"*/{SHARDS}")))


DATASET = DatasetReader(NAME, LICENCE, _recognise, WaymoE2E)
