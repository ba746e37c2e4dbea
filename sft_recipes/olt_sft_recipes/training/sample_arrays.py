"""The samples of a training in memory-mapped files: each is decoded once, while training goes on, however many."""

import json
import os
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import fields
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import open_memmap

from olt_generator.errors import InputError
from olt_generator.files import make_folder, naming, sync, sync_folder, write_whole
from olt_generator.seeds import derive_seed
from olt_sft_recipes.toy.config import PATCH, ToyPolicyConfig
from olt_sft_recipes.training.driving_samples import DrivingSamples
from olt_toolkit import PolicySample, SampleKey
from olt_toolkit.policy.contract import FUTURE_STEPS, HISTORY_STEPS, IMAGE_FRAMES
from olt_toolkit.runtime.json_files import read_json
from olt_toolkit.runtime.workers import working_ahead

LoadSamples = Callable[[Sequence[SampleKey]], Sequence[PolicySample]]
NameSample = Callable[[SampleKey], str]
"""What tells a sample from any other, wherever its store is."""
Arrays = dict[str, np.ndarray[Any, Any]]
Piece = tuple[list[int], list[SampleKey]]
"""Samples that are decoded together: their rows and their keys."""

_ABOUT_FILE = "samples.json"
# Most samples of a piece, which are in memory at once.
_AT_ONCE = 16
# Pieces that a process has been handed at most: it never waits, and little of what is wanted waits for it.
_HANDED_OUT = 3
# What a process costs before it decodes; who is done alone sooner does without.
_SECONDS_TO_START = 4.0


def name_by_key(key: SampleKey) -> str:
    """The clip and the time, where a clip never changes."""
    return f"{key.clip_id} {key.t0_us}"


def bytes_of_sample(config: ToyPolicyConfig) -> int:
    """What a decoded sample takes on the disk while it is trained on."""
    cameras = len(config.contract.cameras)
    places, turns = np.zeros((1, FUTURE_STEPS, 3), np.float32), np.zeros((1, FUTURE_STEPS, 3, 3), np.float32)
    sample = PolicySample(
        image_frames=np.zeros((cameras, IMAGE_FRAMES, 3, PATCH, PATCH), np.uint8),
        camera_indices=np.array(config.contract.indices, np.int64),
        ego_history_xyz=places[:, :HISTORY_STEPS],
        ego_history_rot=turns[:, :HISTORY_STEPS],
        ego_future_xyz=places,
        ego_future_rot=turns,
        relative_timestamps=np.zeros((cameras, IMAGE_FRAMES), np.float32),
        absolute_timestamps=np.zeros((cameras, IMAGE_FRAMES), np.int64),
        t0_us=0,
        clip_id="none",
    )
    return sum(values.nbytes for values in _to_arrays(DrivingSamples.gather([sample], config)).values())


class SampleArrays:
    """Samples that are decoded into a folder in the order in which they are wanted, while training goes on.

    Processes decode ahead of it, and so does who would otherwise wait for them. A folder that was left whole is taken
    as it is, one that was not is begun anew. It is for a `with` block: when that is left, the processes end, and a
    folder that is not whole is removed.

    Args:
        keys: which samples; row k is that of key k.
        load_samples: loads samples by key; with `workers` it can be pickled.
        config: what the model takes of them.
        folder: where the files are.
        workers: most processes that decode ahead; 0 for none.
        name_sample: what tells the samples of a folder that was left whole from others.
        options: how they are loaded, in words; a folder of samples that were loaded otherwise is begun anew.
    """

    def __init__(
        self,
        keys: Sequence[SampleKey],
        load_samples: LoadSamples,
        config: ToyPolicyConfig,
        folder: Path,
        workers: int = 0,
        name_sample: NameSample = name_by_key,
        options: str = "",
    ) -> None:
        self.keys = keys
        self._config, self._folder, self._workers = config, folder, workers
        self._name_sample, self._options = name_sample, options
        self._gather = partial(_gather, load_samples, config)
        self._decode = partial(_decode, load_samples, config, folder)
        self._samples: DrivingSamples | None = None
        self._pieces: list[list[int]] = []
        self._piece_of = np.zeros(len(keys), np.int64)
        self._missing: set[int] = set()
        self._waiting: dict[int, None] = {}
        self._handed: dict[int, Future[None]] = {}
        self._submit: Callable[[Piece], Future[None]] | None = None
        self._ahead = ExitStack()
        self._finishing: Future[None] | None = None

    def __enter__(self) -> "SampleArrays":
        return self

    def __exit__(self, *_: object) -> None:
        self._ahead.close()
        if self._finishing is not None:
            self._finishing.result()
        elif self._missing:
            shutil.rmtree(self._folder, ignore_errors=True)

    def open(self, steps: Sequence[Sequence[int]], whole: bool = False) -> None:
        """Begin, with the samples of the first step, unless it was begun before.

        Args:
            steps: the rows that are wanted, step by step.
            whole: whether to return only when all samples are there, so that other processes may open them, too.

        Raises:
            InputError: a sample cannot be loaded or is not finite, or the disk is full.
        """
        if self._samples is not None:
            return
        if not self._is_whole():
            self._begin(steps)
        self._samples = self._map()
        self.having(range(len(self.keys)) if whole else steps[0] if steps else [])
        if whole and self._finishing is not None:
            self._finishing.result()

    def having(self, rows: Sequence[int]) -> DrivingSamples:
        """All samples, of which those in the given rows are there; waits for them or decodes them.

        Raises:
            InputError: as `open`, which was called before.
        """
        assert self._samples is not None
        wanted = [piece for piece in np.unique(self._piece_of[list(rows)]).tolist() if piece in self._missing]
        self._hand_out()
        for piece in reversed(wanted):  # the processes come from the other end
            if piece in self._waiting:
                self._decode_here(piece)
        for piece in wanted:
            while piece in self._handed and self._waiting and not self._handed[piece].done():
                self._decode_here(next(iter(self._waiting)))  # rather than wait
            if piece in self._handed:
                self._wait_for(piece)
        if self._pieces and not self._missing and self._finishing is None:
            pool = ThreadPoolExecutor(1)
            self._finishing = pool.submit(self._finish)
            pool.shutdown(wait=False)
        return self._samples

    def _decode_here(self, piece: int) -> None:
        del self._waiting[piece]
        self._decode(self._piece(piece))
        self._missing.remove(piece)
        self._hand_out()

    def _hand_out(self) -> None:
        """Take back what the processes have decoded, and give them more."""
        for piece in [piece for piece, decoded in self._handed.items() if decoded.done()]:
            self._wait_for(piece)
        while self._submit and self._waiting and len(self._handed) < _HANDED_OUT * self._workers:
            piece = next(iter(self._waiting))
            del self._waiting[piece]
            self._handed[piece] = self._submit(self._piece(piece))

    def _wait_for(self, piece: int) -> None:
        try:
            self._handed.pop(piece).result()
        except BrokenProcessPool as error:
            raise InputError(
                f"{self._folder}: a process that decodes samples was ended from outside; the system does that where "
                "memory is short. Free some, and train again: it goes on where it was saved"
            ) from error
        self._missing.remove(piece)

    def _begin(self, steps: Sequence[Sequence[int]]) -> None:
        """Decode the first piece, which tells what the files are like, and have the others decoded."""
        shutil.rmtree(self._folder, ignore_errors=True)
        self._pieces = _divide(self.keys, steps)
        for number, rows in enumerate(self._pieces):
            self._piece_of[rows] = number
        self._missing = set(range(len(self._pieces)))
        rows, keys = self._piece(0)
        start = time.perf_counter()
        arrays = self._gather(keys)
        for name, values in arrays.items():
            path = make_folder(self._folder) / f"{name}.npy"
            with naming(path):
                open_memmap(path, mode="w+", dtype=values.dtype, shape=(len(self.keys), *values.shape[1:]))
                _reserve(path)
        _write(self._folder, rows, arrays)
        self._missing.remove(0)
        seconds = (time.perf_counter() - start) / len(rows) * (len(self.keys) - len(rows))
        if self._workers and seconds > _SECONDS_TO_START:
            self._submit = self._ahead.enter_context(working_ahead(self._decode, self._workers))
        first = set(self._piece_of[list(steps[0])].tolist()) if steps else set[int]()
        # While the processes start, what the first step wants is decoded here.
        self._waiting = dict.fromkeys([*sorted(self._missing - first), *sorted(self._missing & first)])

    def _finish(self) -> None:
        """All samples are there: end the processes, and write what makes the folder whole after them."""
        self._ahead.close()
        sync_folder(self._folder)
        with write_whole(self._folder / _ABOUT_FILE) as path:
            path.write_text(json.dumps({"samples": self._name, "count": len(self.keys)}) + "\n")
            sync(path)

    def _is_whole(self) -> bool:
        path = self._folder / _ABOUT_FILE
        if not path.exists():
            return False
        return read_json(path, "description of samples")["samples"] == self._name

    @cached_property
    def _name(self) -> str:
        """What tells these samples, at the size that the model takes, from any other."""
        names = map(self._name_sample, self.keys)
        return f"{derive_seed(self._config.model_dump_json(), self._options, *names):x}"

    def _map(self) -> DrivingSamples:
        arrays = {path.stem: np.load(path, mmap_mode="r") for path in sorted(self._folder.glob("*.npy"))}
        return DrivingSamples(config=self._config, **arrays)

    def _piece(self, number: int) -> Piece:
        rows = self._pieces[number]
        return rows, [self.keys[row] for row in rows]


def _reserve(path: Path) -> None:
    """Take a file's space on the disk: the system ends who writes to a map where there is none."""
    if hasattr(os, "posix_fallocate"):
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)


def _divide(keys: Sequence[SampleKey], steps: Sequence[Sequence[int]]) -> list[list[int]]:
    """Rows that are decoded together, in the order in which steps first want a clip, whose samples come together."""
    of_clip: dict[tuple[str, str], list[int]] = {}
    for row, key in enumerate(keys):
        of_clip.setdefault((key.store, key.clip_id), []).append(row)
    wanted = (keys[row] for step in steps for row in step)
    pieces: list[list[int]] = [[]]
    for clip in {**dict.fromkeys((key.store, key.clip_id) for key in wanted), **of_clip}:
        rows = of_clip[clip]
        if len(pieces[-1]) + len(rows) <= _AT_ONCE:
            pieces[-1] += rows
        else:
            pieces += [rows[start : start + _AT_ONCE] for start in range(0, len(rows), _AT_ONCE)]
    return [rows for rows in pieces if rows]


def _decode(load_samples: LoadSamples, config: ToyPolicyConfig, folder: Path, piece: Piece) -> None:
    rows, keys = piece
    _write(folder, rows, _gather(load_samples, config, keys))


def _gather(load_samples: LoadSamples, config: ToyPolicyConfig, keys: Sequence[SampleKey]) -> Arrays:
    samples = DrivingSamples.gather(list(load_samples(keys)), config)
    _refuse_not_finite(samples, keys)
    return _to_arrays(samples)


def _to_arrays(samples: DrivingSamples) -> Arrays:
    values = {field.name: getattr(samples, field.name) for field in fields(samples)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def _write(folder: Path, rows: list[int], arrays: Arrays) -> None:
    for name, values in arrays.items():
        np.load(folder / f"{name}.npy", mmap_mode="r+")[rows] = values


def _refuse_not_finite(samples: DrivingSamples, keys: Sequence[SampleKey]) -> None:
    for name in ("history", "future"):
        finite = np.isfinite(getattr(samples, name)).reshape(len(samples), -1).all(axis=1)
        if not finite.all():
            bad = keys[int(np.argmin(finite))]
            raise InputError(
                f"{bad.store}: clip {bad.clip_id} at {bad.t0_us} us: the {name} holds a number that is not finite; "
                "leave this clip out, or build it again"
            )
