"""The samples of a step whose loss is not finite, for whoever looks for the cause."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save_file

from olt_generator.files import write_whole_folder
from olt_sft_recipes.training.driving_samples import DrivingSamples
from olt_toolkit import SampleKey

_FILLED_UP = ("routes",)
"""What ends early is filled up with NaN."""


def save_failed_step(folder: Path, samples: DrivingSamples, keys: Sequence[SampleKey], step: int, why: str) -> None:
    """Write `samples.safetensors` (the arrays of `DrivingSamples`, before augmentation) and `step.json`."""
    arrays = {name: np.ascontiguousarray(of) for name, of in vars(samples).items() if isinstance(of, np.ndarray)}
    finite = {name: bool(_is_finite(name, of).all()) for name, of in arrays.items()}
    about = {"step": step + 1, "why": why, "finite": finite, "samples": [vars(key) for key in keys]}
    with write_whole_folder(folder) as temporary:
        save_file(arrays, temporary / "samples.safetensors")
        (temporary / "step.json").write_text(json.dumps(about, indent=2) + "\n")


def _is_finite(name: str, values: NDArray[Any]) -> NDArray[np.bool_]:
    return ~np.isinf(values) if name in _FILLED_UP else np.isfinite(values)
