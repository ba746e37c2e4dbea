"""The samples of a mixture at one size, decoded once and mapped into memory.

A sample shows a few frames of four videos, and decoding them takes far longer than a small policy takes to learn from
them. The cache is a folder of arrays: each distinct frame once, and for each sample which frames it shows and all of
its other fields. Readers map the files, so several processes share them.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.files import write_whole_folder
from olt_generator.progress import Progress, silent
from olt_toolkit import ClipStore, PolicySample, SampleKey
from olt_toolkit.rigs.contracts import CameraContract
from olt_toolkit.runtime.json_files import read_json

HEADER, FRAMES, FRAME_NUMBERS = "cache.json", "frames.bin", "frame_numbers.npy"
_WORDS = ("clip_id", "t0_us")
_LEFT_OUT = ("image_frames", "image_origin", *_WORDS)


@dataclass(frozen=True)
class CacheOptions:
    """What samples are as they are cached: see `ClipStore.load_samples`."""

    image_size: tuple[int, int] | None
    contract: CameraContract
    with_truth: bool


class SampleCache:
    """The samples of some keys, by key; made where the folder does not hold just these.

    Args:
        folder: of the cache.
        keys: of the samples.
        stores: the clip stores by the names that the keys have for them.
        options: how they are loaded.
        on_progress: told the share of the clips that are decoded.

    Raises:
        InputError: a sample cannot be loaded, images have several sizes, or the folder is another's or not writable.
    """

    def __init__(
        self,
        folder: Path,
        keys: Sequence[SampleKey],
        stores: Mapping[str, ClipStore],
        options: CacheOptions,
        on_progress: Progress = silent,
    ) -> None:
        keys = sorted(set(keys))
        identity = _identify(keys, stores, options)
        if _read_identity(folder) != identity:
            with write_whole_folder(folder) as temporary:
                shape = _write(temporary, keys, stores, options, on_progress)
                (temporary / HEADER).write_text(json.dumps({"identity": identity, "shape": shape}) + "\n")
        self._rows = {key: row for row, key in enumerate(keys)}
        self._map(folder)

    def _map(self, folder: Path) -> None:
        self._folder = folder
        self._frame_numbers = np.load(folder / FRAME_NUMBERS, mmap_mode="r")
        paths = sorted(folder.glob("sample_*.npy"))
        self._fields = {path.stem.removeprefix("sample_"): np.load(path, mmap_mode="r") for path in paths}
        shape = read_json(folder / HEADER, "sample cache")["shape"]
        self._frames = np.memmap(folder / FRAMES, np.uint8, "r").reshape(-1, *shape)

    def __getstate__(self) -> dict[str, Any]:
        # Mapped arrays would be sent to a worker whole.
        return {"_rows": self._rows, "_folder": self._folder}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._rows = state["_rows"]
        self._map(state["_folder"])

    def load(self, keys: Sequence[SampleKey]) -> list[PolicySample]:
        """Samples in the order of `keys`, equal to those of `ClipStore.load_samples`."""
        return [self._load(key, self._rows[key]) for key in keys]

    def _load(self, key: SampleKey, row: int) -> PolicySample:
        fields: dict[str, Any] = {name: np.array(values[row]) for name, values in self._fields.items()}
        images = self._frames[self._frame_numbers[row]]
        return PolicySample(image_frames=images, t0_us=key.t0_us, clip_id=key.clip_id, **fields)


def _identify(keys: Sequence[SampleKey], stores: Mapping[str, ClipStore], options: CacheOptions) -> str:
    """A hash of what a cache depends on: the clips by their checksums, the times, and how samples are loaded."""
    told = hashlib.blake2b(
        f"{options.image_size} {options.contract.name} {options.with_truth}".encode(), digest_size=16
    )
    for key in keys:
        told.update(f"\n{stores[key.store].info(key.clip_id).checksum} {key.clip_id} {key.t0_us}".encode())
    return told.hexdigest()


def _read_identity(folder: Path) -> str | None:
    path = folder / HEADER
    if not folder.exists():
        return None
    header = read_json(path, "sample cache") if path.is_file() else None
    if not isinstance(header, dict) or "identity" not in header:
        raise InputError(f"{folder}: is no sample cache, and would be replaced; give another folder")
    return header["identity"]


def _write(
    folder: Path,
    keys: Sequence[SampleKey],
    stores: Mapping[str, ClipStore],
    options: CacheOptions,
    on_progress: Progress,
) -> tuple[int, ...]:
    """Write all arrays; returns the shape of a frame."""
    columns: dict[str, list[NDArray[Any]]] = {}
    numbers: list[NDArray[np.int64]] = []
    shapes: set[tuple[int, ...]] = set()
    with (folder / FRAMES).open("wb") as file:
        written = 0
        for done, clip_keys in _by_clip(keys):
            store = stores[clip_keys[0].store]
            samples = store.load_samples(clip_keys, options.image_size, options.contract, with_truth=options.with_truth)
            found, written = _write_frames(file, samples, written)
            numbers += found
            shapes |= {sample.image_frames.shape[-3:] for sample in samples}
            for sample in samples:
                for name, value in vars(sample).items():
                    if name not in _LEFT_OUT and value is not None:
                        columns.setdefault(name, []).append(value)
            on_progress(done / len(keys))
    if len(shapes) > 1:
        raise InputError(f"the samples have images of {len(shapes)} sizes; give an image size to scale them to")
    for name, values in columns.items():
        np.save(folder / f"sample_{name}.npy", np.stack(values))
    np.save(folder / FRAME_NUMBERS, np.stack(numbers))
    return shapes.pop()


def _by_clip(keys: Sequence[SampleKey]) -> Iterator[tuple[int, list[SampleKey]]]:
    """The keys clip by clip, in their order, and how many keys that is so far."""
    start = 0
    for end in range(1, len(keys) + 1):
        if end == len(keys) or (keys[end].store, keys[end].clip_id) != (keys[start].store, keys[start].clip_id):
            yield end, list(keys[start:end])
            start = end


def _write_frames(file: BinaryIO, samples: Sequence[PolicySample], written: int) -> tuple[list[NDArray[np.int64]], int]:
    """Write the distinct frames of samples of one clip; the numbers (cameras, 4) of each, and how many there are."""
    known: dict[tuple[int, int], int] = {}
    numbers = []
    for sample in samples:
        own = np.empty(sample.absolute_timestamps.shape, dtype=np.int64)
        for place, time_us in np.ndenumerate(sample.absolute_timestamps):
            frame = place[0], int(time_us)
            if frame not in known:
                known[frame] = written + len(known)
                file.write(sample.image_frames[place].tobytes())
            own[place] = known[frame]
        numbers.append(own)
    return numbers, written + len(known)
