"""The Waymo Open data set for end-to-end driving (WOD-E2E): shards of shuffled frames, put together again as drives.

Layout: TFRecord shards `training_*.tfrecord-*`, `val_*` and `test_*`, in the folder or below it. A frame is named
`SEQUENCE-INDEX`; frames are 0.1 s apart. Ego motion is put together from the past and future that every frame tells.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.drives import Drive, Licence
from olt_datasets.sources.tfrecord import map_records, read_record
from olt_datasets.sources.waymo_frames import CAMERAS, FrameImages, read_images
from olt_datasets.sources.waymo_index import SHARDS, build_index, positions
from olt_datasets.sources.waymo_motion import FramePath, chain_paths
from olt_datasets.sources.windows import from_window_start, images_within
from olt_generator.errors import InputError
from olt_generator.trajectory import Trajectory
from olt_generator.video import shrink
from olt_toolkit.clip import Split
from olt_toolkit.policy_window import Span
from olt_toolkit.recording import OpenOptions, Recording
from olt_toolkit.rig import FRONT_WIDE, VehicleDimensions

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
_ASSUMPTIONS = (
    "Frames are 0.1 s apart, and all cameras of one expose at once; the data set tells no times.",
    "The motion is in the plane, and headings follow from the paths that the frames tell; the data set tells none.",
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
        splits: set[Split | None] = {
            _SPLITS.get(Path(name).name.partition("_")[0]) for name in self.rows["shard"].unique()
        }
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

    def __init__(self, root: Path, index: Path) -> None:
        self._root = root
        self._index = index

    def keys(self) -> list[str]:
        """See `Dataset.keys`: the names of the sequences."""
        return pl.scan_parquet(self._index).select(pl.col("sequence").unique().sort()).collect()["sequence"].to_list()

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; no image is read."""
        frames = self._frames(key)
        front, span = frames.with_front, frames.trajectory.timestamps_us
        rated = front.rows["rated"].to_numpy()
        return Drive(
            source=NAME,
            scene_id=f"{NAME}/{key}",
            key=key,
            front_us=front.times_us,
            cameras=front.cameras,
            ego_span_us=(int(span[0]), int(span[-1])),
            true_views=(FRONT_WIDE,),
            country="US",
            split=frames.split,
            event_t0s_us=tuple(front.times_us[rated].tolist()),
            notes=(*_ASSUMPTIONS, *_missing(frames)),
        )

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`; field of view and height come from the calibration, whatever the options say."""
        frames = self._frames(key)
        front = frames.with_front
        inside = images_within(front.times_us, window_us, f"Waymo E2E drive {key}")
        records = self._read_records(front.rows[inside])
        camera = records[0].cameras[FRONT]
        images = np.stack([_decode(record, FRONT, options.width, key) for record in records])
        start_us = int(front.times_us[inside[0]])
        return Recording(
            name=key,
            source=NAME,
            frames=images,
            timestamps_us=front.times_us[inside] - start_us,
            camera=camera.camera.resized(images.shape[2], images.shape[1]),
            T_rig_camera=camera.T_rig_camera,
            vehicle=JAGUAR_I_PACE,
            assumptions=_ASSUMPTIONS,
            reference=from_window_start(frames.trajectory, start_us),
        )

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

    def _read_records(self, rows: pl.DataFrame) -> list[FrameImages]:
        shards = {name: map_records(self._root / name) for name in rows["shard"].unique()}
        images = []
        for name, offset, length in rows.select("shard", "offset", "length").iter_rows():
            where = f"{self._root / name}: record at byte {offset}"
            images.append(read_images(read_record(shards[name], offset, length, str(self._root / name)), where))
        return images


class WaymoE2EReader:
    """Opens the folder with the shards; see `DatasetReader`."""

    name = NAME
    licence = LICENCE

    def recognises(self, root: Path) -> bool:
        """See `DatasetReader.recognises`; judged by the names of files in the folder and one below."""
        shards = (*root.glob(SHARDS), *root.glob(f"*/{SHARDS}"))
        return any(_prefix(shard.name) in _SPLITS for shard in shards)

    def open(self, root: Path, cache: Path) -> WaymoE2E:
        """See `DatasetReader.open`; the first time all shards are indexed."""
        return WaymoE2E(root, build_index(root, cache / NAME))


def _prefix(shard: str) -> str:
    """What the name of a shard begins with: `training` of `folder/training_202504031202...`."""
    return Path(shard).name.partition("_")[0]


def _decode(record: FrameImages, name: str, width: int, key: str) -> NDArray[np.uint8]:
    """The image (H, W, 3) of a camera, shrunk to `width`."""
    camera = record.cameras[name].camera
    image = cv2.imdecode(np.frombuffer(record.jpegs[name], np.uint8), cv2.IMREAD_COLOR_RGB)
    if image is None:
        raise InputError(f"Waymo E2E drive {key}: an image of {name} cannot be decoded; copy the shard again")
    if image.shape[1::-1] != (camera.width, camera.height):
        raise InputError(
            f"Waymo E2E drive {key}: an image of {name} is {image.shape[1]} x {image.shape[0]} pixels, its calibration "
            f"says {camera.width} x {camera.height}"
        )
    return shrink(np.asarray(image, np.uint8), width)


def _missing(frames: _Frames) -> tuple[str, ...]:
    indices = frames.rows["index"].to_numpy()
    absent = int(indices[-1] - indices[0] + 1 - len(indices))
    return (f"{absent} frames between the first and the last are missing; they lie in other shards.",) if absent else ()


DATASET = WaymoE2EReader()
