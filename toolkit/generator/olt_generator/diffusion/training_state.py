"""The state of a training run on disk, from which it goes on as if it had never stopped.

Randomness is drawn by the number of the step and not from a generator that runs on (`seeds`), so weights, their running
mean, the moments of AdamW and the number of the step are all there is to keep.
"""

import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from olt_generator.errors import InputError
from olt_generator.files import read_bounded, write_whole_folder

STEPS, STATE = "steps", "state.json"
# Checkpoints that are kept.
_KEPT = 2


class RunningMean:
    """The running mean of trained weights (EMA), which samples better than the last ones.

    Early on it keeps less, (1 + n) / (10 + n) after n steps, so that it forgets where the weights began.
    """

    def __init__(self, trained: Mapping[str, nn.Parameter], keep: float) -> None:
        self.keep = keep
        self.weights = {name: parameter.detach().clone() for name, parameter in trained.items()}

    @torch.no_grad()
    def update(self, trained: Mapping[str, nn.Parameter], step: int) -> None:
        """Take in the weights after a step, the first of which is 0."""
        keep = min(self.keep, (1.0 + step) / (10.0 + step))
        for name, parameter in trained.items():
            self.weights[name].lerp_(parameter.detach(), 1.0 - keep)

    @torch.no_grad()
    def copy_to(self, trained: Mapping[str, nn.Parameter]) -> None:
        """Give a model these weights."""
        for name, parameter in trained.items():
            parameter.copy_(self.weights[name])


def save_state(
    run: Path,
    step: int,
    trained: Mapping[str, nn.Parameter],
    mean: RunningMean,
    optimizer: torch.optim.Optimizer,
    settings: Mapping[str, Any],
) -> None:
    """Keep the state after `step` steps; the folder appears whole, and older ones but the last go."""
    moments = {
        f"{name}/{kind}": value.contiguous()
        for name, parameter in trained.items()
        for kind, value in optimizer.state[parameter].items()
    }
    with write_whole_folder(_folder(run, step)) as folder:
        save_file(
            {name: parameter.detach().contiguous() for name, parameter in trained.items()}, folder / "model.safetensors"
        )
        save_file(mean.weights, folder / "average.safetensors")
        save_file(moments, folder / "optimizer.safetensors")
        (folder / STATE).write_text(json.dumps({"step": step, "settings": settings}, indent=2) + "\n")
    for old in _steps(run)[:-_KEPT]:
        shutil.rmtree(_folder(run, old))


def load_state(
    run: Path,
    trained: Mapping[str, nn.Parameter],
    mean: RunningMean,
    optimizer: torch.optim.Optimizer,
    settings: Mapping[str, Any],
) -> int:
    """Go back to the last state that was kept; returns the number of steps done, 0 where there is none.

    Raises:
        InputError: a file is damaged, or the run has other settings or another model.
    """
    done = _steps(run)
    if not done:
        return 0
    folder = _folder(run, done[-1])
    try:
        told = json.loads(read_bounded(folder / STATE, "state of training", 1_000_000))
        weights, means, moments = (
            load_file(folder / f"{name}.safetensors") for name in ("model", "average", "optimizer")
        )
    except (ValueError, SafetensorError, OSError) as error:
        raise InputError(f"{folder}: cannot be read ({error}); remove it to go on from the one before") from error
    _compare(folder, told.get("settings"), json.loads(json.dumps(settings)))
    if weights.keys() != trained.keys() or any(weights[name].shape != p.shape for name, p in trained.items()):
        raise InputError(f"{folder}: holds the weights of another model; give another run folder")
    with torch.no_grad():
        for name, parameter in trained.items():
            parameter.copy_(weights[name])
            mean.weights[name].copy_(means[name])
            kinds = [key.rpartition("/") for key in moments if key.rpartition("/")[0] == name]
            optimizer.state[parameter] = {
                kind: _placed(moments[f"{name}/{kind}"], kind, parameter) for _, _, kind in kinds
            }
    return done[-1]


def read_settings(run: Path) -> dict[str, Any]:
    """What the last state of a run depends on.

    Raises:
        InputError: there is no state, or it is damaged.
    """
    done = _steps(run)
    if not done:
        raise InputError(f"{run}: holds no state of training; give the folder of a run")
    path = _folder(run, done[-1]) / STATE
    try:
        return json.loads(read_bounded(path, "state of training", 1_000_000))["settings"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error


def _placed(value: Tensor, kind: str, parameter: nn.Parameter) -> Tensor:
    """AdamW counts its steps on the processor."""
    return value if kind == "step" else value.to(parameter.device)


def _compare(folder: Path, before: Any, now: Any) -> None:
    if before != now:
        names = sorted(name for name in {*before, *now} if before.get(name) != now.get(name))
        raise InputError(f"{folder}: the run began with other settings ({', '.join(names)}); give another run folder")


def _steps(run: Path) -> list[int]:
    return sorted(int(path.name.removeprefix("step_")) for path in (run / STEPS).glob("step_*"))


def _folder(run: Path, step: int) -> Path:
    return run / STEPS / f"step_{step:06d}"


def keep_losses(path: Path, step: int) -> None:
    """Drop the losses of steps that will be done again."""
    rows: Iterable[str] = path.read_text().splitlines() if path.exists() else ()
    kept = [row for row in rows if row.endswith("}") and json.loads(row)["step"] < step]
    path.write_text("".join(f"{row}\n" for row in kept))
