"""The samples of a training in memory-mapped files: decoded once, read row by row, however many there are."""

import json
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import open_memmap

from olt_generator.errors import InputError
from olt_generator.files import find_whole_folder, write_whole_folder
from olt_generator.seeds import derive_seed
from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.training.driving_samples import DrivingSamples
from olt_toolkit import PolicySample, SampleKey
from olt_toolkit.runtime.json_files import read_json

LoadSamples = Callable[[Sequence[SampleKey]], Sequence[PolicySample]]

_ABOUT_FILE = "samples.json"
# Samples that are in memory at once while they are decoded.
_AT_ONCE = 64


def name_samples(keys: Sequence[SampleKey], config: ToyPolicyConfig) -> str:
    """What tells the samples with these keys, at the size that the model takes, from any other."""
    return f"{derive_seed(config.model_dump_json(), *(f'{key.clip_id} {key.t0_us}' for key in keys)):x}"


def gather_samples(
    keys: Sequence[SampleKey], load_samples: LoadSamples, config: ToyPolicyConfig, folder: Path
) -> DrivingSamples:
    """Decode samples into a folder and map it; a folder that holds them is taken as it is.

    Args:
        keys: which samples, sorted, so that those of a clip are decoded together.
        load_samples: loads samples by key.
        config: what the model takes of them.
        folder: appears whole, and replaces one with other samples.

    Raises:
        InputError: a sample cannot be loaded or is not finite, or the disk is full.
    """
    name = name_samples(keys, config)
    if not (find_whole_folder(folder) / _ABOUT_FILE).exists() or _read_about(folder)["samples"] != name:
        with write_whole_folder(folder) as temporary:
            _decode(keys, load_samples, config, temporary)
            (temporary / _ABOUT_FILE).write_text(json.dumps({"samples": name, "count": len(keys)}) + "\n")
    arrays = {path.stem: np.load(path, mmap_mode="r") for path in sorted(find_whole_folder(folder).glob("*.npy"))}
    return DrivingSamples(config=config, **arrays)


def _decode(keys: Sequence[SampleKey], load_samples: LoadSamples, config: ToyPolicyConfig, folder: Path) -> None:
    arrays: dict[str, np.memmap[Any, Any]] = {}
    for start in range(0, len(keys), _AT_ONCE):
        part = DrivingSamples.gather(list(load_samples(keys[start : start + _AT_ONCE])), config)
        _refuse_not_finite(part, keys[start : start + _AT_ONCE])
        for name, values in _arrays(part).items():
            if name not in arrays:
                shape = (len(keys), *values.shape[1:])
                arrays[name] = open_memmap(folder / f"{name}.npy", mode="w+", dtype=values.dtype, shape=shape)
            arrays[name][start : start + len(values)] = values
    for array in arrays.values():
        array.flush()


def _refuse_not_finite(samples: DrivingSamples, keys: Sequence[SampleKey]) -> None:
    for name in ("history", "future"):
        finite = np.isfinite(getattr(samples, name)).reshape(len(samples), -1).all(axis=1)
        if not finite.all():
            bad = keys[int(np.argmin(finite))]
            raise InputError(
                f"{bad.store}: clip {bad.clip_id} at {bad.t0_us} us: the {name} holds a number that is not finite; "
                "leave this clip out, or build it again"
            )


def _arrays(samples: DrivingSamples) -> dict[str, np.ndarray[Any, Any]]:
    values = {field.name: getattr(samples, field.name) for field in fields(samples)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def _read_about(folder: Path) -> dict[str, Any]:
    return read_json(find_whole_folder(folder) / _ABOUT_FILE, "description of samples")
