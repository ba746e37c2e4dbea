"""Nexar's dashcam videos for collision prediction: front videos of consumer cameras, half of them before an accident.

Two layouts are read. The challenge's: `train.csv` (id, time_of_event, time_of_alert, target) beside `train/ID.mp4`, and
`test.csv` beside `test/ID.mp4`. The hub's: folders `train`, `test-public` and `test-private` with `metadata.csv` in
them or in their folders `positive` and `negative`, whose column `file_name` counts from where the table lies.

A video that ends in a crash is no demonstration to imitate: it may be used up to the moment at which an attentive
driver would have been alerted.
"""

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from olt_datasets.sources.video import CAMERA, UNKNOWN_CAMERA, open_video_window
from olt_generator.errors import InputError
from olt_generator.video import read_frame_times
from olt_toolkit.clips.clip import Split
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.drives import DatasetReader, Drive, Licence
from olt_toolkit.recordings.recording import OpenOptions, Recording
from olt_toolkit.rigs.rig import FRONT_WIDE

NAME = "nexar"
LICENCE = Licence(
    "Nexar open data licence",
    "Download from the hub (nexar-ai/nexar_collision_prediction) or from the challenge's page.",
    "The file LICENSE of the data set tells the terms, with limits on ethical grounds; read it before passing data on.",
)
_CHALLENGE_TABLES: dict[str, Split] = {"train.csv": "train", "test.csv": "test"}
_HUB_FOLDERS: dict[str, Split] = {"train": "train", "test-public": "test", "test-private": "test"}
_HUB_TABLE = "metadata.csv"
_POSITIVE, _NEGATIVE = "positive", "negative"
# Column, and what the factor made of it begins with.
_FACTORS = {"light_conditions": "light", "weather": "weather", "scene": "scene"}


@dataclass(frozen=True)
class _Video:
    """A row of the tables.

    Attributes:
        ends_badly: whether a collision or a near miss follows; None where the data set keeps it to itself.
        event, alert: seconds at which it happens, and at which it can be foreseen.
    """

    path: Path
    split: Split
    ends_badly: bool | None
    event: float | None
    alert: float | None
    factors: tuple[str, ...]


class Nexar:
    """The data set at a folder; see `Dataset`."""

    source = NAME
    licence = LICENCE

    def __init__(self, root: Path, cache: Path) -> None:
        self._root = root
        self._cache = cache / NAME
        self._videos = _read_tables(root)

    def keys(self) -> list[str]:
        """See `Dataset.keys`: paths of the videos without suffix; what stands in them stays text, `00022`."""
        return sorted(self._videos)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; reads the times of the frames and decodes none."""
        video = self._video(key)
        return Drive(
            source=NAME,
            scene_id=f"{NAME}/{video.split}/{video.path.stem}",
            key=key,
            front_us=read_frame_times(video.path),
            cameras=(CAMERA,),
            ego_span_us=None,
            true_views=(FRONT_WIDE,),
            factors=video.factors,
            split=video.split,
            usable_us=_usable(video, key),
            notes=(*UNKNOWN_CAMERA, *_ending(video)),
        )

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`."""
        return open_video_window(self._video(key).path, key, NAME, window_us, options, self._cache)

    def _video(self, key: str) -> _Video:
        if key not in self._videos:
            raise InputError(f"{self._root}: there is no Nexar video {key!r}")
        return self._videos[key]


def _tables(root: Path) -> list[tuple[Path, Path, Split]]:
    """Each table, the folder from which its file names count, and its split."""
    found: list[tuple[Path, Path, Split]] = []
    for name, split in _CHALLENGE_TABLES.items():
        if (root / name).is_file():
            found.append((root / name, root / name.removesuffix(".csv"), split))
    for name, split in _HUB_FOLDERS.items():
        found.extend((table, table.parent, split) for table in _hub_tables(root / name))
    return found


def _hub_tables(folder: Path) -> list[Path]:
    places = (folder, folder / _POSITIVE, folder / _NEGATIVE)
    return [place / _HUB_TABLE for place in places if (place / _HUB_TABLE).is_file()]


def _read_tables(root: Path) -> dict[str, _Video]:
    """All videos that the tables list, by key."""
    videos: dict[str, _Video] = {}
    for table, folder, split in _tables(root):
        for number, row in enumerate(_rows(table), start=2):
            video = _read_row(row, folder, split, f"{table}, line {number}")
            key = video.path.relative_to(root).with_suffix("").as_posix()
            if key in videos:
                raise InputError(f"{table}, line {number}: video {key} is listed twice; keep one of the rows")
            videos[key] = video
    if not videos:
        raise InputError(f"{root}: no train.csv, test.csv or {_HUB_TABLE} lists a video; give Nexar's folder")
    return videos


def _rows(table: Path) -> list[dict[str, str]]:
    try:
        with table.open(encoding="utf-8-sig", newline="") as file:
            return [
                {name: (value or "").strip() for name, value in row.items() if name} for row in csv.DictReader(file)
            ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{table}: cannot be read ({error}); download it again") from error


def _read_row(row: dict[str, str], folder: Path, split: Split, where: str) -> _Video:
    name = row.get("file_name") or (f"{row['id']}.mp4" if row.get("id") else "")
    path = folder / name
    if not name or not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"{where}: neither 'id' nor 'file_name' names a video in {folder.name}; download the table again"
        )
    event, alert = _seconds(row, "time_of_event", where), _seconds(row, "time_of_alert", where)
    factors = tuple(f"{kind}_{_word(row[column])}" for column, kind in _FACTORS.items() if row.get(column))
    return _Video(path, split, _ends_badly(row, path, event, where), event, alert, factors)


def _ends_badly(row: dict[str, str], path: Path, event: float | None, where: str) -> bool | None:
    if row.get("target"):
        if row["target"] not in ("0", "1"):
            raise InputError(f"{where}: target {row['target']!r} is neither 0 nor 1")
        return row["target"] == "1"
    if path.parent.name in (_POSITIVE, _NEGATIVE):
        return path.parent.name == _POSITIVE
    return True if event is not None else None


def _seconds(row: dict[str, str], column: str, where: str) -> float | None:
    """A time in seconds; None where the cell is empty or NaN."""
    try:
        value = float(row.get(column) or "nan")
    except ValueError as error:
        raise InputError(f"{where}: {column} {row[column]!r} is no number of seconds") from error
    if value < 0.0 or np.isinf(value):
        raise InputError(f"{where}: {column} {value} is no time of the video")
    return None if np.isnan(value) else value


def _word(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def _usable(video: _Video, key: str) -> Span | None:
    if not video.ends_badly:
        return None
    end = video.event if video.alert is None else video.alert
    if end is None:
        raise InputError(f"Nexar video {key}: ends badly, but no time_of_alert or time_of_event says when")
    return 0, max(0, round(end * 1e6) - 1)


def _ending(video: _Video) -> tuple[str, ...]:
    if video.ends_badly is None:
        return ("Whether a collision follows is not told.",)
    if not video.ends_badly:
        return ()
    what = "event" if video.alert is None else "alert"
    return (f"It ends in a collision or a near miss; only what lies before the {what} may be imitated.",)


def _recognise(path: Path) -> bool:
    challenge = (path / "train.csv").is_file() and (path / "train").is_dir()
    return challenge or any(_hub_tables(path / folder) for folder in _HUB_FOLDERS)


DATASET = DatasetReader(NAME, LICENCE, _recognise, Nexar)
