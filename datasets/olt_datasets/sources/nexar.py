"""Nexar's dashcam videos for collision prediction: front videos of consumer cameras, half of them before an accident.

Two layouts are read. The challenge's: `train.csv` (id, time_of_event, time_of_alert, target) beside `train/ID.mp4`, and
`test.csv` beside `test/ID.mp4`. The hub's: folders `train`, `test-public` and `test-private` with `metadata.csv` in
them or in their folders `positive` and `negative`, whose column `file_name` counts from where the table lies.

A video that ends in a crash is no demonstration to imitate: it may be used up to the moment at which an attentive
driver would have been alerted.
"""

import csv
import io
import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_datasets.sources.video import CAMERA, UNKNOWN_CAMERA, open_video_window
from olt_generator.errors import InputError
from olt_generator.files import read_bounded
from olt_generator.video import read_frame_times, read_video_images
from olt_toolkit import DatasetReader, Drive, Licence, OpenOptions, Recording
from olt_toolkit.clips.clip import Split
from olt_toolkit.policy.window import Span
from olt_toolkit.rigs.rig import FRONT_WIDE

NAME = "nexar"
LICENCE = Licence(
    "Nexar open data licence",
    "Download from the hub (nexar-ai/nexar_collision_prediction) or from the challenge's page.",
    "The file LICENSE of the data set tells the terms, with limits on ethical grounds; read it before passing data on.",
)
_HUB_FOLDERS: dict[str, Split] = {"train": "train", "test-public": "test", "test-private": "test"}
_LARGEST_TABLE = 1 << 30
_POSITIVE, _NEGATIVE = "positive", "negative"
# Each table, the folder from which its file names count, and its split; first those of the challenge.
_TABLES: list[tuple[str, str, Split]] = [("train.csv", "train", "train"), ("test.csv", "test", "test")]
_HUB_TABLES: list[tuple[str, str, Split]] = [
    (f"{folder}/metadata.csv", folder, split)
    for name, split in _HUB_FOLDERS.items()
    for folder in (name, f"{name}/{_POSITIVE}", f"{name}/{_NEGATIVE}")
]
# Column, and what the factor made of it begins with.
_FACTORS = {"light_conditions": "light", "weather": "weather", "scene": "scene"}


@dataclass(frozen=True)
class _Video:
    """A row of the tables; event and alert are the seconds at which it happens, and at which it can be foreseen.

    `ends_badly` is whether a collision or a near miss follows; None where the data set keeps it to itself.
    """

    path: Path
    split: Split
    ends_badly: bool | None
    event: float | None
    alert: float | None
    factors: tuple[str, ...]

    @property
    def scene(self) -> str:
        """The id that the tables give, which counts within a split."""
        return f"{self.split}/{self.path.stem}"


_LONGEST_NAME = 512


class Nexar:
    """The data set at a folder; see `Dataset`."""

    source = NAME
    licence = LICENCE

    def __init__(self, root: Path, cache: Path) -> None:
        self._root = root
        self._cache = cache / NAME
        self._videos: dict[str, _Video] = {}
        named: dict[str, str] = {}
        for table, folder, split in (*_TABLES, *_HUB_TABLES):
            if not (root / table).is_file():
                continue
            for number, row in enumerate(_read_rows(root / table), start=2):
                where = f"{root / table}, line {number}"
                video = _read_video(row, root / folder, split, where)
                key = video.path.relative_to(root).with_suffix("").as_posix()
                if key in self._videos:
                    raise InputError(f"{where}: video {key} is listed twice; keep one of the rows")
                if (other := named.setdefault(video.scene, key)) != key:
                    raise InputError(
                        f"{where}: {key} and {other} have one id in the split {split}, and each video needs its own; "
                        "download the tables again"
                    )
                self._videos[key] = video
        if not self._videos:
            raise InputError(f"{root}: no train.csv, test.csv or metadata.csv lists a video; give Nexar's folder")

    def keys(self) -> list[str]:
        """See `Dataset.keys`: paths of the videos without suffix; what stands in them stays text, `00022`."""
        return sorted(self._videos)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; reads the times of the frames and decodes none."""
        video = self._video(key)
        front_us, usable_us, notes = read_frame_times(video.path), None, UNKNOWN_CAMERA
        if video.ends_badly is None:
            notes += ("Whether a collision follows is not told.",)
        elif video.ends_badly:
            what, end = ("event", video.event) if video.alert is None else ("alert", video.alert)
            if end is None:
                raise InputError(f"Nexar video {key}: ends badly, but no time_of_alert or time_of_event says when")
            usable_us = 0, max(0, round(end * 1e6) - 1)
            notes += (f"It ends in a collision or a near miss; only what lies before the {what} may be imitated.",)
        return Drive(
            source=NAME,
            scene_id=f"{NAME}/{video.scene}",
            key=key,
            front_us=front_us,
            cameras=(CAMERA,),
            ego_span_us=None,
            true_views=(FRONT_WIDE,),
            factors=video.factors,
            split=video.split,
            usable_us=usable_us,
            notes=notes,
        )

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """See `Dataset.peek`; key frames are decoded without others."""
        return read_video_images(self._video(key).path, times_us, reach_us, width)

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`."""
        return open_video_window(self._video(key).path, key, NAME, window_us, options, self._cache)

    def _video(self, key: str) -> _Video:
        if key not in self._videos:
            raise InputError(f"{self._root}: there is no Nexar video {key!r}")
        return self._videos[key]


def _read_rows(table: Path) -> list[dict[str, str]]:
    try:
        text = read_bounded(table, "table of videos", _LARGEST_TABLE).decode("utf-8-sig")
        rows = csv.DictReader(io.StringIO(text, newline=""))
        return [{name: (value or "").strip() for name, value in row.items() if name} for row in rows]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{table}: cannot be read ({error}); download it again") from error


def _read_video(row: dict[str, str], folder: Path, split: Split, where: str) -> _Video:
    name = row.get("file_name") or (f"{row['id']}.mp4" if row.get("id") else "")
    path = folder / name
    if not name or len(name) > _LONGEST_NAME or not _is_inside(path, folder):
        raise InputError(
            f"{where}: neither 'id' nor 'file_name' names a video in {folder.name}; download the table again"
        )
    event, alert = _seconds(row, "time_of_event", where), _seconds(row, "time_of_alert", where)
    ends_badly = True if event is not None else None
    if target := row.get("target"):
        if target not in ("0", "1"):
            raise InputError(f"{where}: target {target!r:.80} is neither 0 nor 1")
        ends_badly = target == "1"
    elif path.parent.name in (_POSITIVE, _NEGATIVE):
        ends_badly = path.parent.name == _POSITIVE
    factors = tuple(
        f"{kind}_{re.sub(r'[^a-z0-9]+', '_', row[column].lower()).strip('_')}"
        for column, kind in _FACTORS.items()
        if row.get(column)
    )
    return _Video(path, split, ends_badly, event, alert, factors)


def _is_inside(path: Path, folder: Path) -> bool:
    try:
        return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))
    except ValueError:  # a zero byte is in no path
        return False


def _seconds(row: dict[str, str], column: str, where: str) -> float | None:
    """A time in seconds; None where the cell is empty or NaN."""
    try:
        value = float(row.get(column) or "nan")
    except ValueError as error:
        raise InputError(f"{where}: {column} {row[column]!r} is no number of seconds") from error
    if value < 0.0 or np.isinf(value):
        raise InputError(f"{where}: {column} {value} is no time of the video")
    return None if np.isnan(value) else value


def _is_nexar(path: Path) -> bool:
    challenge = (path / "train.csv").is_file() and (path / "train").is_dir()
    return challenge or any((path / table).is_file() for table, _, _ in _HUB_TABLES)


DATASET = DatasetReader(NAME, LICENCE, _is_nexar, Nexar)
