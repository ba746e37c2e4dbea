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
from olt_datasets.sources.waymo.frames import CAMERAS, read_images
from olt_datasets.sources.waymo.index import SHARDS, build_index
from olt_datasets.sources.waymo.motion import FramePath, chain_paths
from olt_generator.errors import InputError
from olt_toolkit import DatasetReader, Drive, Licence, OpenOptions, Recording
from olt_toolkit.clips.clip import Split
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.tfrecord import map_records, read_record
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
_HAS_FRONT = pl.col("cameras").list.contains(FRONT)
_USE = "The paper fine-tunes policies with clips of this data set and keeps it out of all training of the generator."
_ASSUMPTIONS = (
    "Frames are 0.1 s apart, and all cameras of one expose at once; the data set tells no times.",
    "The motion is in the plane, and headings follow from the paths that the frames tell; the data set tells none.",
    "The vehicle frame, to which the cameras are calibrated, is taken to be on the ground under the rear axle.",
    "The vehicle has the size of a Jaguar I-Pace, which is what most of Waymo's cars are.",
)


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
        # The split that the names of the shards tell.
        splits: set[Split | None] = {_SPLITS.get(_prefix(name)) for name in frames["shard"].unique()}
        if len(splits) > 1:
            raise InputError(f"{key}: its frames lie in shards of different splits; give Waymo's shards unchanged")
        absent = frames["index"][-1] - frames["index"][0] + 1 - len(frames)
        missing = f"{absent} frames between the first and the last are missing; they lie in other shards."
        notes = (_USE, missing) if absent else (_USE,)
        described = self._surround(key, frames).describe(country="US", split=splits.pop(), notes=notes)
        rated = frames.filter(_HAS_FRONT & pl.col("rated"))["time_us"].to_list()
        return replace(described, event_t0s_us=tuple(rated))

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """See `Dataset.peek`."""
        return self._surround(key, self._frames(key)).peek(times_us, width)

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`; the front images, which are portraits, are freed of their distortion."""
        return self._surround(key, self._frames(key)).open(window_us, options)

    def _frames(self, key: str) -> pl.DataFrame:
        """Rows of the index for the frames of a drive, in order of time, and their drive times `time_us`."""
        rows = pl.scan_parquet(self._index).filter(pl.col("sequence") == key).sort("index").collect()
        if rows.is_empty():
            raise InputError(f"{self._root}: there is no Waymo E2E drive {key!r}")
        twice = rows.filter(pl.col("index").is_duplicated())
        if not twice.is_empty():
            index, shards = twice["index"][0], ", ".join(twice["shard"].unique().sort())
            raise InputError(
                f"Waymo E2E drive {key}: frame {index} is there more than once ({shards}); give each shard once"
            )
        front = rows.filter(_HAS_FRONT)
        if front.is_empty():
            raise InputError(f"Waymo E2E drive {key}: no frame has an image of the front camera")
        return rows.with_columns(time_us=FRAME_US * (pl.col("index").cast(pl.Int64) - front["index"][0]))

    def _surround(self, key: str, frames: pl.DataFrame) -> SurroundDrive:
        """The images of a drive and its motion; nothing but the calibration of the first frame is read."""
        front = frames.filter(_HAS_FRONT)
        times_us = front["time_us"].to_numpy()
        shards = {name: map_records(self._root / name) for name in front["shard"].unique()}
        cells = front.select("shard", "offset", "length").iter_rows()
        records = [_Record(shards[name], offset, length, str(self._root / name)) for name, offset, length in cells]
        mounted = records[0].calibrated
        # Cameras that have images throughout.
        steady = [name for name in CAMERAS.values() if front["cameras"].list.contains(name).all()]
        images = {name: tuple(_RecordImage(record, name, mounted[name]) for record in records) for name in steady}
        paths = [FramePath.from_states(*row) for row in frames.select("time_us", "past", "future").iter_rows()]
        return SurroundDrive(
            source=NAME,
            key=key,
            scene=key,
            front=FRONT,
            cameras={name: CameraImages(mounted[name], images[name], times_us) for name in steady},
            ego=chain_paths(paths, f"Waymo E2E drive {key}"),
            vehicle=JAGUAR_I_PACE,
            assumptions=_ASSUMPTIONS,
        )


class _Record:
    """A record of a shard."""

    def __init__(self, shard: memoryview, offset: int, length: int, path: str) -> None:
        self._shard, self._offset, self._length, self._path = shard, offset, length, path

    def __str__(self) -> str:
        return f"{self._path}: record at byte {self._offset}"

    @property
    def calibrated(self) -> dict[str, MountedCamera]:
        """The cameras, read without looking at the images, so the checksum of the record is not looked at either."""
        return read_images(self._shard[self._offset : self._offset + self._length], str(self), False)[1]

    @cached_property
    def images(self) -> tuple[dict[str, bytes], dict[str, MountedCamera]]:
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
        jpegs, cameras = self.record.images
        own = cameras[self.camera]
        if own.camera != self.mounted.camera or not np.array_equal(own.T_rig_camera, self.mounted.T_rig_camera):
            raise InputError(f"{self}: its calibration is not that of the first frame; give Waymo's shards unchanged")
        return jpegs[self.camera]


def _prefix(shard: str) -> str:
    """What the name of a shard begins with: `training` of `folder/training_202504031202...`."""
    return Path(shard).name.partition("_")[0]


DATASET = DatasetReader(
    NAME,
    LICENCE,
    lambda path: any(_prefix(shard.name) in _SPLITS for shard in (*path.glob(SHARDS), *path.glob(f"*/{SHARDS}"))),
    WaymoE2E,
)
