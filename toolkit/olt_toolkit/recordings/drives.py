"""Drives: what a data set holds, told from its tables without decoding an image; and how one is opened.

A data set is a folder in one public layout, or a single recording, which is a data set with one drive. Its reader lists
the keys of its drives, describes one (cheap: tables and file headers only) and opens a time window of one as a
`Recording`. Drive time is integer microseconds; 0 is the first image of the front camera. Readers are found through the
entry-point group `olt.datasets`, so packages further up bring their own formats.
"""

import math
import tempfile
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.files import make_folder
from olt_generator.omissions import Omission
from olt_generator.trajectory import Trajectory
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.labels import UNLABELLED, Split
from olt_toolkit.recordings.recording import OpenOptions, Recording

WHOLE = "."
"""Key of the drive of a path that is itself a recording: a video file, a KITTI drive folder."""

# Keys that an error names.
_SHOWN = 5


@dataclass(frozen=True)
class Licence:
    """On what terms a data set may be used: a short name, and how one comes by it and what is allowed in a sentence."""

    name: str
    access: str
    terms: str


@dataclass(frozen=True)
class Drive:
    """One continuous recording of a data set.

    Attributes:
        source: name of the reader.
        scene_id: the scene, unique over all data sets: the reader's name, a slash, and an id that stands in the source
            or else a hash of what was recorded. Names and places of files and folders do not enter it.
        key: what opens the drive again, unique in its data set.
        front_us: (n,) int64 drive times of the front images, strictly increasing, the first is 0; empty for a data
            set without images.
        cameras: names of the cameras, as the data set calls them, that have images.
        ego_span_us: drive times that measured ego motion covers; None where motion must come from the images.
        true_views: cameras of the target rig of which the data set has true images, at their own place or as a mosaic
            of several cameras; the front camera alone for a dashcam.
        category: long-tail category, `UNLABELLED` where the data set does not tell.
        factors: scene factors that the data set tells.
        country: ISO 3166 code of two letters, None where it is not told.
        split: the data set's own split, None where it has none.
        event_t0s_us: drive times that the data set marks as the moments to learn from.
        usable_us: drive times within which it may be imitated (a window that ends in a crash may not); None for all.
        notes: a sentence for everything that a user of the drive must know, such as what was assumed.
        take: tells recordings of one scene apart, such as those of one invented world by day and by night.

    Raises:
        InputError: an id or the key holds control characters, which a table of clips cannot tell.
    """

    source: str
    scene_id: str
    key: str
    front_us: NDArray[np.int64]
    cameras: tuple[str, ...]
    ego_span_us: Span | None
    true_views: tuple[str, ...]
    category: str = UNLABELLED
    factors: tuple[str, ...] = ()
    country: str | None = None
    split: Split | None = None
    event_t0s_us: tuple[int, ...] = ()
    usable_us: Span | None = None
    notes: tuple[str, ...] = ()
    take: str = ""

    def __post_init__(self) -> None:
        for what, text in (("scene id", self.scene_id), ("take", self.take), ("key", self.key)):
            if any(unicodedata.category(each) == "Cc" for each in text):
                raise InputError(
                    f"{self.source}: {what} {text!r:.200} holds control characters; rename the file, folder or scene"
                )


class Dataset(Protocol):
    """A data set at a folder, opened for reading. Workers open their own."""

    source: str
    licence: Licence

    def keys(self) -> list[str]:
        """Keys of all drives, sorted."""
        ...

    def drive(self, key: str) -> Drive:
        """Describe one drive without decoding its images; an `InputError` names file and field that are damaged."""
        ...

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Front images (m, H, W, 3) of a drive near drive times (m,), as cheaply as its files allow, and their times.

        Each time gets the image nearest to it, or one at most its `reach_us` (m,) away that is decoded without others.
        Which one depends on nothing but the drive, that time and its reach; two may get the same. Images are RGB, at
        most `width` pixels wide, and need not be as fine as those of `open`.

        Raises:
            InputError: an image is missing or damaged, or the drive has none.
        """
        ...

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """Decode the part of a drive whose front images lie in [first, last].

        Times of the recording begin at 0 with its first image. `reference` covers all measured ego motion of the drive
        and so reaches before 0 and beyond the last image. `options.duration` does not apply.

        Raises:
            InputError: the files are missing or damaged; names file and field.
        """
        ...


@dataclass(frozen=True)
class DatasetReader:
    """Opens data sets of one layout; what the entry points of `olt.datasets` name.

    Attributes:
        name: what the data set is called as the source of clips.
        recognises: whether a folder or file looks like this layout, judged cheaply by names.
        open: opens the data set at a path, which is only read, with a folder for what takes long to find again. It
            raises an `InputError` where the tables that list the drives are missing or damaged.
    """

    name: str
    licence: Licence
    recognises: Callable[[Path], bool]
    open: Callable[[Path, Path], Dataset]


@dataclass(frozen=True)
class DatasetPlace:
    """Where a data set is, and how it is opened; can be sent to other processes.

    Attributes:
        path: its folder, or its only recording.
        cache: where its reader keeps what takes long to find again; None for a folder that goes with the process.
        source: name of its reader; None for the first that recognises the path.
    """

    path: Path
    cache: Path | None = None
    source: str | None = None

    def open(self) -> Dataset:
        """Open the data set, once in each process; errors are those of `open_dataset`."""
        return _open_once(self)

    def drive_name(self, key: str) -> str:
        """What a drive is called in results: its file, without suffix, or its folder, or the last part of its key."""
        path = (self.path / key).resolve()
        return path.stem if path.is_file() else path.name


def readers() -> dict[str, DatasetReader]:
    """All installed readers by name."""
    loaded: list[DatasetReader] = [entry.load() for entry in sorted(entry_points(group="olt.datasets"))]
    return {reader.name: reader for reader in loaded}


def find_reader(path: Path) -> DatasetReader | None:
    """The first reader that recognises a path; None where there is none."""
    return next((reader for reader in readers().values() if reader.recognises(path)), None)


def open_dataset(path: Path, cache: Path | None = None, source: str | None = None) -> Dataset:
    """Open a data set, or a single recording as one; the arguments are those of a `DatasetPlace`.

    Raises:
        InputError: the path is missing, or no reader recognises it.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    known = readers()
    if source is not None and source not in known:
        raise InputError(f"no data set reader is called {source!r}; there are {', '.join(known)}")
    reader = find_reader(path) if source is None else known[source]
    if reader is None:
        raise InputError(
            f"{path}: no recording and no data set that any reader knows ({', '.join(known)}); give a video, a drive "
            "folder or the folder of a data set"
        )
    return reader.open(path, Path(_make_own_cache().name) if cache is None else make_folder(cache))


def open_recording(path: Path, options: OpenOptions | None = None, cache: Path | None = None) -> Recording:
    """Open the only drive of a video, a drive folder or the folder of a data set, from its start.

    Raises:
        InputError: see `open_dataset`; there is more than one drive.
    """
    dataset = open_dataset(path, cache)
    keys = dataset.keys()
    if len(keys) != 1:
        some = ", ".join(keys[:_SHOWN]) + (", ..." if len(keys) > _SHOWN else "")
        raise InputError(f"{path}: holds {len(keys)} drives ({some}); give the path of one")
    return open_start(dataset, keys[0], options or OpenOptions())


def open_start(dataset: Dataset, key: str, options: OpenOptions) -> Recording:
    """Open a drive from its start, up to the duration of the options; motion is known while images last."""
    recording = dataset.open(key, start_window(options), options)
    if recording.reference is None:
        return recording
    times_us = recording.timestamps_us
    shown = Trajectory(times_us, recording.reference.interpolate(times_us))
    return replace(recording, reference=shown.in_first_frame())


def start_window(options: OpenOptions) -> Span:
    """The drive times within which the images lie that `open_start` decodes."""
    return 0, math.ceil(min(options.duration * 1e6, 2.0**62)) - 1


def find_drives(path: Path, cache: Path | None = None) -> list[tuple[DatasetPlace, str]]:
    """All drives at a path by key, and the data set that each is in.

    A recording is its own only drive, `WHOLE`. Of a folder they are the recordings that lie directly in it, by name,
    or, where there is none or some lie in folders below, the drives of the data set that it is.

    Raises:
        InputError: there is none.
    """
    place = DatasetPlace(path, cache)
    inside = sorted(path.iterdir()) if path.is_dir() else []
    keys = place.open().keys() if not inside or find_reader(path) else []
    if keys == [WHOLE]:
        return [(place, WHOLE)]
    shown = [(each, find_reader(each)) for each in inside if not each.name.startswith(".")]
    # Files that the data set passes over, such as rear videos beside front ones, are no recordings of their own.
    own = find_reader(path) if keys else None
    passed_over = {each for each, reader in shown if own and reader == own and each.is_file() and each.name not in keys}
    places = [DatasetPlace(each, cache) for each, reader in shown if reader and each not in passed_over]
    direct = [(each, WHOLE) for each in places if each.open().keys() == [WHOLE]]
    # Recordings in folders below are of the data set alone.
    found = direct if direct and not any("/" in key for key in keys) else [(place, key) for key in keys] or direct
    if not found:
        raise InputError(
            f"{path}: holds no recording that any reader knows; give a video, a drive, a folder of them or a data set"
        )
    return found


def list_left_out(path: Path, cache: Path | None = None) -> tuple[Omission, ...]:
    """What the reader of a folder passed over beside its drives, where it tells; nothing where no reader knows it."""
    return getattr(open_dataset(path, cache), "left_out", ()) if find_reader(path) else ()


_make_own_cache = cache(lambda: tempfile.TemporaryDirectory(prefix="olt-"))


@lru_cache(maxsize=1)
def _open_once(place: DatasetPlace) -> Dataset:
    return open_dataset(place.path, place.cache, place.source)
