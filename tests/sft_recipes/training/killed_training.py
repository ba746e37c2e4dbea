"""Trains both stages on fabricated drives; as a script it kills its own process where it is told to.

A script, since a process that is forked after torch had threads of its own cannot train.
"""

import importlib
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from olt_sft_recipes.training import sample_arrays
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.two_stages import StageResult, train_two_stages
from olt_sft_recipes.training.validation import Validation
from olt_toolkit.policy.sample import SampleKey

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from conftest import TINY_CONFIG, make_drives

AUGMENTED = {"mirror_probability": 0.5, "turn_degrees": 4.0, "move_metres": 0.5}
SETTINGS = {"num_train_epochs": 2, "per_device_train_batch_size": 4, "learning_rate": 3e-3, "warmup_steps": 2}
STAGES = (
    StageConfig(stage=1, save_steps=2, hidden_token_probability=0.5, **SETTINGS, **AUGMENTED),
    StageConfig(stage=2, save_steps=2, eval_steps=3, **SETTINGS, **AUGMENTED),
)
STEPS = 12  # six of each stage


@cache
def drives() -> dict[SampleKey, Any]:
    return make_drives()


def load(asked: list[SampleKey]) -> list[Any]:
    return [drives()[key] for key in asked]


def load_slowly_ahead(asked: list[SampleKey]) -> list[Any]:
    if multiprocessing.parent_process() is not None and asked[0].clip_id > "clip06":
        time.sleep(600)
    return load(asked)


def train(
    out: Path,
    on_progress: Callable[[float], object] = lambda share: None,
    load: Callable[[list[SampleKey]], list[Any]] = load,
    workers: int = 0,
) -> list[StageResult]:
    """Twelve drives, left, right and straight at several speeds; the first judges."""
    keys = sorted(drives())

    def batches(epoch: int, size: int) -> list[list[SampleKey]]:
        return [keys[start : start + size] for start in range(0, len(keys), size)]

    judged = Validation([drives()[keys[0]]])
    return train_two_stages(STAGES, batches, load, out, TINY_CONFIG, on_progress, judged, workers=workers)


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def train_until_step(out: Path, step: int) -> None:
    train(out, lambda share: kill() if share >= step / STEPS - 1e-9 else None)


def train_three_steps(out: Path) -> None:
    taken: list[float] = []
    train(out, lambda share: taken.append(share) or (len(taken) == 3 and kill()))


def train_while_another_process_decodes(out: Path) -> None:
    """Kills after a step, and tells whom it leaves alone."""

    def leave_alone(share: float) -> None:
        children = [str(child.pid) for child in multiprocessing.active_children()]
        out.with_suffix(".left").write_text(" ".join(children))
        kill()

    sample_arrays._AT_ONCE, sample_arrays._SECONDS_TO_START = 1, -1.0
    train(out, leave_alone, load_slowly_ahead, workers=1)


def train_until_called(out: Path, function: str, times: int, after: bool) -> None:
    """Kills before or after the given call of the function 'module.name'."""
    module = importlib.import_module(function.rpartition(".")[0])
    name = function.rpartition(".")[2]
    real, calls = getattr(module, name), []

    def killing(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == times and not after:
            kill()
        result = real(*arguments)
        if len(calls) == times:
            kill()
        return result

    setattr(module, name, killing)
    train(out)


if __name__ == "__main__":
    out, where, *rest = sys.argv[1:]
    if where == "step":
        train_until_step(Path(out), int(rest[0]))
    elif where == "three steps":
        train_three_steps(Path(out))
    elif where == "decoded ahead":
        train_while_another_process_decodes(Path(out))
    else:
        train_until_called(Path(out), where, int(rest[0]), rest[1] == "after")
