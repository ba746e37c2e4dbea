"""Training clips on disk: a table of them in Parquet, the tensors of each in a safetensors file.

    cache.json            format, size, frames, digest of what made the latents
    clips.parquet         file, source, scene, first_us, last_us, split
    clip_000000.safetensors

Latents are kept in half precision, whose error is far below that of the autoencoder. Clips for evaluation keep their
videos too. Docs: docs/formats/generator.md.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import torch
from safetensors.torch import save_file

from olt_generator.diffusion.splits import Split, Window, check_splits
from olt_generator.diffusion.tensor_files import read_tensors
from olt_generator.diffusion.training_clips import ClipVideos, TrainingClip
from olt_generator.errors import InputError
from olt_generator.files import read_bounded, write_whole, write_whole_folder

FORMAT = 1
FACTS, TABLE = "cache.json", "clips.parquet"
_MOST_BYTES = 1_000_000
_COLUMNS = ("file", "source", "scene", "first_us", "last_us", "split")
_HALF = ("latents", "warped", "visibility")


@dataclass(frozen=True)
class CacheFacts:
    """What holds for all clips of a cache.

    Attributes:
        width, height, frames: of the videos.
        frame_us: time between their frames.
        made_by: what made latents and warps, such as the digest of the autoencoder; a cache of another is refused.
    """

    width: int
    height: int
    frames: int
    frame_us: int
    made_by: str


class TrainingCache:
    """Clips of a finished cache.

    Args:
        folder: as `write_cache` writes it.

    Raises:
        InputError: files are missing, damaged or of another format, or the splits leak.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.facts = _read_facts(folder / FACTS)
        rows = _read_table(folder / TABLE)
        self.windows = [Window(row["source"], row["scene"], row["first_us"], row["last_us"]) for row in rows]
        self.splits: list[Split] = [row["split"] for row in rows]
        self._files = [folder / Path(row["file"]).name for row in rows]
        check_splits(self.windows, self.splits)
        self._load = lru_cache(maxsize=256)(partial(read_tensors, advice="make the cache again"))

    def numbers(self, split: Split) -> list[int]:
        """The clips of a split."""
        return [number for number, own in enumerate(self.splits) if own == split]

    def clip(self, number: int) -> TrainingClip:
        """The tensors of a clip, in single precision."""
        tensors = self._load(self._files[number])
        try:
            return TrainingClip(*(tensors[name].float() for name in TrainingClip.__dataclass_fields__))
        except KeyError as error:
            raise InputError(f"{self._files[number]}: holds no {error.args[0]}; make the cache again") from error

    def videos(self, number: int) -> ClipVideos:
        """The videos of a clip that is kept for evaluation.

        Raises:
            InputError: it is one of those to train on, which have none.
        """
        tensors, arrays = self._load(self._files[number]), {}
        for name in ClipVideos.__dataclass_fields__:
            if name not in tensors:
                raise InputError(f"{self._files[number]}: holds no {name}; only clips for evaluation keep videos")
            arrays[name] = tensors[name].numpy()
        return ClipVideos(**arrays | {"known": arrays["known"].astype(np.bool_)})


def write_cache(
    folder: Path,
    facts: CacheFacts,
    windows: Sequence[Window],
    splits: Sequence[Split],
    clips: Iterable[tuple[TrainingClip, ClipVideos]],
) -> TrainingCache:
    """Write a cache; the folder appears whole.

    Args:
        clips: one for each window; videos are kept of those for evaluation.

    Raises:
        InputError: the splits leak (`splits.check_splits`).
    """
    check_splits(windows, splits)
    with write_whole_folder(folder) as temporary:
        rows = []
        for number, ((clip, videos), window, split) in enumerate(zip(clips, windows, splits, strict=True)):
            name = f"clip_{number:06d}.safetensors"
            tensors = {key: value.half() if key in _HALF else value for key, value in vars(clip).items()}
            if split != "train":
                tensors |= {key: torch.from_numpy(_storable(value)) for key, value in vars(videos).items()}
            save_file({key: value.contiguous() for key, value in tensors.items()}, temporary / name)
            rows.append({"file": name, **asdict(window), "split": split})
        _write_table(temporary / TABLE, rows)
        (temporary / FACTS).write_text(json.dumps({"format": FORMAT, **asdict(facts)}, indent=2) + "\n")
    return TrainingCache(folder)


def _storable(values: Any) -> Any:
    return np.ascontiguousarray(values, np.uint8 if values.dtype == np.bool_ else values.dtype)


def _write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with write_whole(path) as temporary:
        pq.write_table(pa.Table.from_pylist(rows), temporary)


def _read_table(path: Path) -> list[dict[str, Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    content = read_bounded(path, "table of training clips", 256 * _MOST_BYTES)
    try:
        rows = cast(list[dict[str, Any]], pq.read_table(pa.BufferReader(content)).to_pylist())
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path}: not a readable Parquet file; make the cache again") from error
    for number, row in enumerate(rows):
        texts = all(isinstance(row.get(name), str) for name in ("file", "source", "scene", "split"))
        if row.keys() != set(_COLUMNS) or not texts or row["split"] not in get_args(Split):
            raise InputError(f"{path}: row {number}: give {', '.join(_COLUMNS)}, split one of {get_args(Split)}")
        if not all(isinstance(row[name], int) for name in ("first_us", "last_us")):
            raise InputError(f"{path}: row {number}: first_us and last_us are whole microseconds")
    return rows


def _read_facts(path: Path) -> CacheFacts:
    try:
        told = json.loads(read_bounded(path, "training cache", _MOST_BYTES))
        if told.pop("format") != FORMAT:
            raise InputError(f"{path}: not of format {FORMAT}; make the cache again with this release")
        return CacheFacts(**told)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{path}: not the facts of a training cache; make it again") from error
