"""Drives: what a data set holds, told from its tables without decoding an image; and how one is opened.

A data set is a folder in one public layout. Its reader lists the keys of its drives, describes one (cheap: tables and
file headers only) and opens a time window of one as a `Recording`. Drive time is integer microseconds; 0 is the first
image of the front camera. Readers are found through the entry-point group `olt.datasets`.
"""

from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.labels import UNLABELLED, Split
from olt_toolkit.recordings.recording import OpenOptions, Recording


@dataclass(frozen=True)
class Licence:
    """On what terms a data set may be used; carried along with every clip by its name.

    Attributes:
        name: short name of the licence.
        access: how one comes by the data, in a sentence.
        terms: what it allows and forbids, in a sentence.
    """

    name: str
    access: str
    terms: str


@dataclass(frozen=True)
class Drive:
    """One continuous recording of a data set.

    Attributes:
        source: name of the reader.
        scene_id: the scene, unique over all data sets: it begins with the reader's name and a slash.
        key: what opens the drive again, unique in its data set.
        front_us: (n,) int64 drive times of the front images, strictly increasing, the first is 0; empty for a data
            set without images.
        cameras: names of the cameras, as the data set calls them, that have images.
        ego_span_us: drive times that measured ego motion covers; None where motion must come from the images.
        true_views: policy cameras of which the data set has true images, at their own place or as a mosaic of several
            cameras; the front camera alone for a dashcam.
        category: long-tail category, `UNLABELLED` where the data set does not tell.
        factors: scene factors that the data set tells.
        country: ISO 3166 code of two letters, None where it is not told.
        split: the data set's own split, None where it has none.
        event_t0s_us: drive times that the data set marks as the moments to learn from.
        usable_us: drive times within which it may be imitated (a window that ends in a crash may not); None for all.
        notes: a sentence for everything that a user of the drive must know, such as what was assumed.
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


class Dataset(Protocol):
    """A data set at a folder, opened for reading. Workers open their own."""

    source: str
    licence: Licence

    def keys(self) -> list[str]:
        """Keys of all drives, sorted."""
        ...

    def drive(self, key: str) -> Drive:
        """Describe one drive without decoding its images.

        Raises:
            InputError: its files are missing or damaged; names file and field.
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


class DatasetReader(Protocol):
    """Opens data sets of one layout."""

    name: str
    licence: Licence

    def recognises(self, root: Path) -> bool:
        """Whether the folder looks like this layout, judged cheaply by names."""
        ...

    def open(self, root: Path, cache: Path) -> Dataset:
        """Open the data set in a folder.

        Args:
            root: the folder; it is only read.
            cache: a folder where the reader may keep what takes long to find again.

        Raises:
            InputError: the tables that list the drives are missing or damaged.
        """
        ...


def readers() -> dict[str, DatasetReader]:
    """All installed readers by name."""
    loaded: list[DatasetReader] = [entry.load() for entry in sorted(entry_points(group="olt.datasets"))]
    return {reader.name: reader for reader in loaded}


def open_dataset(root: Path, cache: Path, source: str | None = None) -> Dataset:
    """Open a data set with the reader of this name, or with the first that recognises the folder.

    Raises:
        InputError: the folder is missing, or no reader recognises it.
    """
    if not root.is_dir():
        raise InputError(f"{root}: no such folder")
    known = readers()
    if source is not None:
        if source not in known:
            raise InputError(f"no data set reader is called {source!r}; there are {', '.join(known)}")
        return known[source].open(root, cache)
    for reader in known.values():
        if reader.recognises(root):
            return reader.open(root, cache)
    raise InputError(f"{root}: not a data set that any reader knows ({', '.join(known)})")
