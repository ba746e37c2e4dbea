"""Checkpoints of a stage: `checkpoint-N` after N optimizer steps, with all that going on exactly needs, and no pickle.

A folder holds the model as `toy.checkpoint` writes it, `optimizer.safetensors` with the moments of AdamW by name of the
parameter, and `trainer_state.json` with the keys of transformers where it has them. The learning rate and everything
random are functions of the seed and the step, so no more state is kept of them than these two numbers.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from olt_generator.errors import InputError
from olt_generator.files import (
    find_whole_folder,
    remove_whole_folder,
    sync,
    sync_folder,
    write_whole,
    write_whole_folder,
)
from olt_sft_recipes.toy.checkpoint import ToyModel, write_model
from olt_toolkit.runtime.json_files import read_json

STATE_FILE = "trainer_state.json"
OPTIMIZER_FILE = "optimizer.safetensors"
_PREFIX = "checkpoint-"


@dataclass
class TrainerState:
    """How far a stage is.

    Attributes:
        identity: what decides the trained weights, as a hash; a training goes on only where it is the same.
        stage: 1 or 2.
        seed: with the step it gives the learning rate and everything random.
        global_step, max_steps: optimizer steps taken and in all, regression warm-up included.
        warmup_steps: of them are the regression warm-up.
        samples: distinct samples.
        samples_per_step: samples of a whole optimizer step.
        num_train_epochs: passes over the mixture.
        saturated_tokens: future tokens of the samples that stand for the end of the range; None before the last step,
            at which all samples are there.
        log_history: step (from 1), epoch, loss, learning_rate and grad_norm of every step.
        evaluations: step and errors of every evaluation (`validation.Evaluation`).
        best_model_checkpoint: name of the checkpoint that was judged best; None where nothing was judged.
        vlm_sha256: hash of the vision-language model that Stage 2 keeps as it is; None in Stage 1.
        files: SHA-256 of the other files of the checkpoint, by name.
        seconds: run time up to here by what it was spent on.
    """

    identity: str
    stage: int
    seed: int
    max_steps: int
    warmup_steps: int
    samples: int
    samples_per_step: int
    num_train_epochs: int
    saturated_tokens: int | None = None
    global_step: int = 0
    log_history: list[dict[str, float]] = field(default_factory=list)
    evaluations: list[dict[str, Any]] = field(default_factory=list)
    best_model_checkpoint: str | None = None
    vlm_sha256: str | None = None
    files: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


def checkpoint_name(step: int) -> str:
    """The folder of the checkpoint after so many steps."""
    return f"{_PREFIX}{step}"


def list_checkpoints(folder: Path) -> list[Path]:
    """The whole checkpoints of a stage, oldest first."""
    steps = [path.name.removeprefix(_PREFIX) for path in folder.glob(f"{_PREFIX}*") if (path / STATE_FILE).exists()]
    return [folder / checkpoint_name(step) for step in sorted(int(step) for step in steps if step.isdecimal())]


def save_checkpoint(
    folder: Path, model: ToyModel, trained: nn.Module, optimizer: torch.optim.AdamW, state: TrainerState
) -> Path:
    """Write the checkpoint of the step that the state tells; it appears whole, and outlives a power cut."""
    path = folder / checkpoint_name(state.global_step)
    with write_whole_folder(path) as temporary:
        write_model(temporary, model)
        save_file(_moments(trained, optimizer), temporary / OPTIMIZER_FILE)
        state.files = {file.name: _hash_file(file) for file in sorted(temporary.iterdir())}
        (temporary / STATE_FILE).write_text(_to_json(state))
        sync_folder(temporary)
    sync(folder)
    return path


def update_state(checkpoint: Path, state: TrainerState) -> None:
    """Write the state of a checkpoint again, after it was judged."""
    with write_whole(checkpoint / STATE_FILE) as path:
        path.write_text(_to_json(state))
        sync(path)


def read_state(checkpoint: Path) -> TrainerState:
    """The state in a checkpoint.

    Raises:
        InputError: it cannot be read, or is not of this release.
    """
    path = find_whole_folder(checkpoint) / STATE_FILE
    try:
        content = read_json(path, "state of a training")
    except InputError as error:
        raise InputError(f"{error}; {_go_on_before(checkpoint)}") from error
    if not isinstance(content, dict) or content.keys() != {known.name for known in fields(TrainerState)}:
        raise InputError(f"{path}: not the state of a training by this release; train again, into another folder")
    return TrainerState(**content)


def check_files(checkpoint: Path) -> None:
    """Check that the files of a checkpoint are as they were written.

    Raises:
        InputError: one is absent or another, or the state cannot be read.
    """
    for name, known in read_state(checkpoint).files.items():
        path = checkpoint / name
        if not path.is_file() or _hash_file(path) != known:
            raise InputError(f"{path}: is not as it was written; {_go_on_before(checkpoint)}")


def _go_on_before(checkpoint: Path) -> str:
    return f"remove {checkpoint} and any after it, and training goes on before it"


def restore_optimizer(checkpoint: Path, trained: nn.Module, optimizer: torch.optim.AdamW) -> None:
    """Give the optimizer the moments that were saved.

    Raises:
        InputError: they cannot be read, or are of other parameters.
    """
    path = checkpoint / OPTIMIZER_FILE
    try:
        moments = load_file(path)
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: cannot be read ({error}); {_go_on_before(checkpoint)}") from error
    state: dict[int, dict[str, Tensor]] = {}
    for index, (name, parameter) in enumerate(trained.named_parameters()):
        found = {key: moments.pop(f"{name}/{key}") for key in _KEYS if f"{name}/{key}" in moments}
        if found and (found.keys() != {*_KEYS} or found["exp_avg"].shape != parameter.shape):
            raise InputError(f"{path}: {name}: not the moments of this model; remove {checkpoint}")
        if found:
            state[index] = found
    if moments:
        raise InputError(f"{path}: holds moments of {next(iter(moments))}, which is not trained; remove {checkpoint}")
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def prune_checkpoints(folder: Path, limit: int, best: str | None) -> None:
    """Remove all but the newest checkpoints and the best; none is ever half there under its name."""
    for path in list_checkpoints(folder)[:-limit]:
        if path.name != best:
            remove_whole_folder(path)


def hash_tensors(module: nn.Module) -> str:
    """SHA-256 of the names and bytes of all tensors of a module."""
    digest = hashlib.sha256()
    for name, tensor in sorted(module.state_dict().items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        digest.update(tensor.contiguous().numpy().tobytes())
    return digest.hexdigest()


def _hash_file(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_KEYS = ("step", "exp_avg", "exp_avg_sq")


def _moments(trained: nn.Module, optimizer: torch.optim.AdamW) -> dict[str, Tensor]:
    """The state of AdamW by name; parameters that had no gradient yet have none."""
    return {
        f"{name}/{key}": optimizer.state[parameter][key].contiguous()
        for name, parameter in trained.named_parameters()
        if parameter in optimizer.state
        for key in _KEYS
    }


def _to_json(state: TrainerState) -> str:
    return json.dumps(asdict(state), indent=1, allow_nan=False) + "\n"
