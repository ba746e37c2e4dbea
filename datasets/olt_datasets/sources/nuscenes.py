"""nuScenes: six undistorted cameras at 12 Hz for 20 s, each image with the vehicle's pose at its time.

Layout: tables in `v1.0-{trainval,test,mini}/*.json`, images in `samples/<CHANNEL>` (two a second) and
`sweeps/<CHANNEL>` (the rest). Images may be missing, as where only some of the archives were unpacked: a drive is then
what is there. Poses are planar in position, z is always 0; quaternions are w, x, y, z.
"""

from functools import cached_property
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.sources.nuscenes_tables import LENS, MOUNTING, POSITION, TABLES, camera_images
from olt_datasets.sources.surround import CameraImages, SurroundDrive
from olt_generator import InputError, PinholeCamera, Trajectory
from olt_generator.poses import pose_from_quaternion
from olt_toolkit import DatasetReader, Drive, Licence, OpenOptions, Recording
from olt_toolkit.clips.clip import Split
from olt_toolkit.policy.window import Span
from olt_toolkit.rigs.rig import MountedCamera
from olt_toolkit.rigs.rig_files import load_rig

SOURCE = "nuscenes"
FRONT = "CAM_FRONT"
RELEASES = ("v1.0-trainval", "v1.0-test", "v1.0-mini")
LICENCE = Licence(
    name="CC BY-NC-SA 4.0 (nuScenes)",
    access="Registration at nuscenes.org and acceptance of its terms of use.",
    terms="Non-commercial use with attribution, derived data under the same licence; else by separate agreement.",
)
_SPLITS: dict[str, Split] = {"v1.0-test": "test"}
# What `log.location` begins with.
_COUNTRIES = {"singapore": "SG", "boston": "US"}
# Poses closer in time than this make accelerations out of rounding errors.
_LEAST_POSE_STEP_US = 10_000
_FEWEST_IMAGES = 2
# Images rarer than this, in a second, lack their sweeps.
_SWEEP_RATE = 6.0


class Nuscenes:
    """The scenes in a folder."""

    source = SOURCE
    licence = LICENCE

    def __init__(self, root: Path, cache: Path) -> None:
        if not any((root / name).is_dir() for name in RELEASES):
            raise InputError(f"{root}: holds none of the tables {', '.join(RELEASES)}; give the root of nuScenes")
        self.root = root
        self._cache = cache

    def keys(self) -> list[str]:
        """See `Dataset.keys`: the names of the scenes of which front images are on disk."""
        # Names as the tables have them.
        files = [file for kind in ("samples", "sweeps") for file in self.root.glob(f"{kind}/{FRONT}/*")]
        names = [file.relative_to(self.root).as_posix() for file in files]
        on_disk = pl.Series(sorted(names), dtype=pl.String)
        scenes: set[str] = set()
        for release in set(self._tables.values()):
            images = pl.scan_parquet(camera_images(release, self._cache))
            found = images.filter(pl.col("filename").is_in(on_disk.implode())).group_by("scene").len().collect()
            scenes |= set(found.filter(pl.col("len") >= _FEWEST_IMAGES)["scene"])
        return sorted(scenes)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; images that are not on disk are left out."""
        rows = self._rows(key)
        drive = self._read(key, rows)
        location, description = rows["location"][0], rows["description"][0]
        release = self._tables[key].name
        notes = [f"nuScenes describes the scene as: {description}"]
        rate = 1e6 / float(np.median(np.diff(drive.cameras[FRONT].times_us)))
        if rate < _SWEEP_RATE:
            notes.append(f"The front camera has {rate:.1f} images a second on disk; its sweeps are missing.")
        if release not in _SPLITS:
            notes.append("The tables do not tell which scenes nuScenes keeps for validation.")
        country = _COUNTRIES.get(location.split("-")[0])
        return drive.describe(country=country, split=_SPLITS.get(release), notes=tuple(notes))

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """See `Dataset.peek`."""
        return self._read(key, self._rows(key)).peek(times_us, width)

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`."""
        return self._read(key, self._rows(key)).open(window_us, options)

    @cached_property
    def _tables(self) -> dict[str, Path]:
        """The release of each scene; scenes of the mini release are also in the full one, which goes first."""
        found: dict[str, Path] = {}
        for release in (self.root / name for name in RELEASES):
            if release.is_dir():
                images = pl.scan_parquet(camera_images(release, self._cache))
                scenes = images.filter(pl.col("channel") == FRONT).select(pl.col("scene").unique()).collect()
                found = dict.fromkeys(scenes["scene"], release) | found
        return found

    def _rows(self, key: str) -> pl.DataFrame:
        """The rows of a scene's images, on disk or not."""
        if key not in self._tables:
            raise InputError(f"{self.root}: nuScenes has no scene {key!r} here; it has {len(self._tables)} others")
        images = pl.scan_parquet(camera_images(self._tables[key], self._cache))
        return images.filter(pl.col("scene") == key).collect().sort("channel", "timestamp")

    def _token(self, key: str, rows: pl.DataFrame) -> str:
        """The scene's token: names, unlike tokens, are given anew by whoever makes tables of this form."""
        tokens = rows["scene_token"].unique().sort()
        if len(tokens) != 1:
            table = self._tables[key] / "scene.json"
            raise InputError(f"{table}: {len(tokens)} scenes are called {key!r} ({', '.join(tokens)}); rename them")
        return tokens[0]

    def _read(self, key: str, rows: pl.DataFrame) -> SurroundDrive:
        on_disk = pl.Series([(self.root / name).is_file() for name in rows["filename"]], dtype=pl.Boolean)
        groups = {channel: part for (channel,), part in rows.filter(on_disk).group_by("channel", maintain_order=True)}
        if FRONT not in groups or len(groups[FRONT]) < _FEWEST_IMAGES:
            raise InputError(f"{self.root}: scene {key}: the images of {FRONT} are not on disk; unpack their archives")
        start_us = int(groups[FRONT]["timestamp"][0])
        return SurroundDrive(
            source=SOURCE,
            key=key,
            scene=self._token(key, rows),
            front=FRONT,
            cameras={str(name): self._camera(f"scene {key}: {name}", part, start_us) for name, part in groups.items()},
            ego=_ego_motion(rows, start_us),
            vehicle=load_rig("nuscenes").vehicle,
            assumptions=(
                "The vehicle has the size that third parties estimate for the Renault Zoe of nuScenes.",
                "The motion is planar in position: nuScenes tells no height.",
            ),
        )

    def _camera(self, where: str, rows: pl.DataFrame, start_us: int) -> CameraImages:
        where = f"{self.root}: {where}"
        for column in ("calibrated_sensor", "width", "height"):
            if rows[column].n_unique() != 1:
                raise InputError(f"{where}: sample_data.{column} changes within the scene")
        times_us = rows["timestamp"].to_numpy() - start_us
        if np.any(np.diff(times_us) <= 0):
            raise InputError(f"{where}: sample_data.timestamp {rows['timestamp'][0]} or a later one is there twice")
        first = rows.row(0, named=True)
        lens = PinholeCamera(first["width"], first["height"], *(first[name] for name in LENS))
        x, y, z, qw, qx, qy, qz = (first[name] for name in MOUNTING)
        mounted = MountedCamera(lens, pose_from_quaternion([qx, qy, qz, qw], [x, y, z]))
        return CameraImages(mounted, tuple(self.root / name for name in rows["filename"]), times_us)


def _ego_motion(rows: pl.DataFrame, start_us: int) -> Trajectory:
    """The vehicle's poses at the times of all images, over drive time; of those too close together the first."""
    rows = rows.unique("timestamp", keep="first").sort("timestamp")
    times_us = rows["timestamp"].to_numpy() - start_us
    kept = [0]
    for index in range(1, len(times_us)):
        if times_us[index] - times_us[kept[-1]] >= _LEAST_POSE_STEP_US:
            kept.append(index)
    turn = rows.select("qx", "qy", "qz", "qw").to_numpy()[kept]
    return Trajectory(times_us[kept], pose_from_quaternion(turn, rows.select(POSITION).to_numpy()[kept]))


DATASET = DatasetReader(
    SOURCE,
    LICENCE,
    lambda path: any((path / name / f"{TABLES[0]}.json").is_file() for name in RELEASES),
    Nuscenes,
)
