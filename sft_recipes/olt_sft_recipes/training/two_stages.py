"""Two-stage training of the toy policy.

Stage 1 trains the vision-language model on trajectory tokens. Its loss is the mean cross-entropy over the future
tokens; the real recipe adds a second mean over the other labelled tokens (reasoning, end of message), which the toy
does not have, and the toy adds the squared error of its regression head. Stage 2 takes that model, freezes it, and
trains the action expert alone by flow matching (docs/formats/alpamayo.md, docs/formats/sft_recipes.md).
"""

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from olt_datasets import Mixture, MixtureDataset
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.progress import Progress, silent
from olt_generator.seeds import derive_seed
from olt_sft_recipes.toy.checkpoint import ToyModel, load_tensors, read_config, read_tensors, save_model
from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.toy.tokens import encode_actions
from olt_sft_recipes.training.driving_samples import DrivingSamples
from olt_sft_recipes.training.objectives import StepDraws, draw_step, prepare_batch, sample_losses
from olt_sft_recipes.training.stage_config import StageConfig
from olt_toolkit import PolicySample, SampleKey
from olt_toolkit.runtime.json_files import read_json
from olt_toolkit.runtime.version import code_version

Batches = Callable[[int, int], Sequence[Sequence[SampleKey]]]
"""The batches of an epoch, given its number and the samples of an optimizer step (`Mixture.epoch`)."""

LoadSamples = Callable[[Sequence[SampleKey]], Sequence[PolicySample]]
LOG_FILE = "training_log.json"
VLM_PREFIX = "vlm."


@dataclass(frozen=True)
class StageResult:
    """What training one stage gave.

    Attributes:
        stage: 1 or 2.
        steps: optimizer steps after the regression warm-up.
        samples: distinct samples.
        losses: loss of each of the steps.
        final_loss: mean loss of the last tenth of the steps.
        regression_warmup_losses: before them, the loss of every step of the regression warm-up.
        saturated_tokens: future tokens of the samples as they are that stand for the end of the range.
        seconds: run time; the only part that differs between equal trainings.
    """

    stage: int
    steps: int
    samples: int
    losses: list[float]
    final_loss: float
    regression_warmup_losses: list[float]
    saturated_tokens: int
    seconds: float


def train_on_mixture(
    mixture: Mixture,
    stages: tuple[StageConfig, StageConfig],
    seed: int,
    out: Path,
    on_progress: Progress = silent,
    model_config: ToyPolicyConfig | None = None,
) -> list[StageResult]:
    """Train both stages on a mixture, as `train_two_stages` does; `seed` replaces that of the stages.

    The samples have the cameras of the model's contract.

    Raises:
        InputError: as `train_two_stages`, or a sample of the mixture cannot be loaded.
    """
    first, second = (stage.model_copy(update={"seed": seed}) for stage in stages)
    config = model_config or ToyPolicyConfig()
    weighted = any(stage.invented_pixel_weight < 1.0 for stage in stages)
    dataset = MixtureDataset(mixture, image_size=None, contract=config.contract, with_origin=weighted)
    return train_two_stages((first, second), mixture.epoch, dataset.load_batch, out, config, on_progress)


def train_two_stages(
    stages: tuple[StageConfig, StageConfig],
    batches: Batches,
    load_samples: LoadSamples,
    out: Path,
    model_config: ToyPolicyConfig | None = None,
    on_progress: Progress = silent,
) -> list[StageResult]:
    """Train both stages; `out/stage1` holds the first, `out/policy` what drives.

    A stage that the same code finished with the same configuration, samples and Stage 1 is taken as it is; any other,
    and one that was interrupted, is trained anew.

    The other arguments are those of `train_stage`.

    Raises:
        InputError: the stages are not 1 and 2, or a stage's weights do not match the model.
    """
    first, second = (stage.stage for stage in stages)
    if (first, second) != (1, 2):
        raise InputError(f"training: stages {first} and {second} were given; give stage 1, then stage 2")
    folders = (None, out / "stage1", out / "policy")
    return [
        train_stage(
            stage,
            batches,
            load_samples,
            folders[index],
            out_stage,
            model_config,
            lambda share, index=index: on_progress((index + share) / 2),
        )
        for index, (stage, out_stage) in enumerate(zip(stages, folders[1:], strict=True))
    ]


def train_stage(
    stage: StageConfig,
    batches: Batches,
    load_samples: LoadSamples,
    checkpoint_in: Path | None,
    out: Path,
    model_config: ToyPolicyConfig | None = None,
    on_progress: Progress = silent,
) -> StageResult:
    """Train one stage and write its checkpoint with the log of the losses.

    Args:
        stage: how to train.
        batches: the batches of each epoch.
        load_samples: loads samples by key; each distinct sample is loaded once and kept in memory.
        checkpoint_in: the Stage 1 checkpoint that Stage 2 starts from; None for Stage 1.
        out: folder to write.
        model_config: sizes of a new model; None for the usual ones, or those of the checkpoint.
        on_progress: told the share of the work that is done.

    Raises:
        InputError: Stage 2 has no checkpoint, or its weights do not match the model.
    """
    epochs = [
        [list(batch) for batch in batches(epoch, stage.samples_per_step)] for epoch in range(stage.num_train_epochs)
    ]
    keys = sorted({key for epoch in epochs for batch in epoch for key in batch})
    samples_seed = derive_seed(*(f"{key.clip_id} {key.t0_us}" for key in keys))
    before = "" if checkpoint_in is None else _read_log(checkpoint_in)["identity"]
    sizes = "" if model_config is None else model_config.model_dump_json()
    identity = f"{derive_seed(code_version(), stage.model_dump_json(), sizes, samples_seed, before):x}"
    if (out / LOG_FILE).exists():
        log = _read_log(out)
        if log.pop("identity") == identity:
            on_progress(1.0)
            return StageResult(**log)
    start = time.perf_counter()
    model = _make_model(stage, checkpoint_in, model_config)
    samples = DrivingSamples.gather(list(load_samples(keys)), model.config)
    rows = {key: row for row, key in enumerate(keys)}
    steps = [[rows[key] for key in batch] for epoch in epochs for batch in epoch]
    warmup = sum(len(epoch) for epoch in epochs[: stage.regression_warmup_epochs])
    losses = [round(loss, 6) for loss in _optimize(model, stage, samples, steps, warmup, on_progress)]
    result = StageResult(
        stage=stage.stage,
        steps=len(losses[warmup:]),
        samples=len(keys),
        losses=losses[warmup:],
        final_loss=round(float(np.mean(losses[-max(1, len(losses[warmup:]) // 10) :])), 6),
        regression_warmup_losses=losses[:warmup],
        saturated_tokens=encode_actions(samples.actions())[1],
        seconds=time.perf_counter() - start,
    )
    save_model(out, model)
    with write_whole(out / LOG_FILE) as path:
        path.write_text(json.dumps({"identity": identity, **asdict(result)}) + "\n")
    return result


def _read_log(folder: Path) -> dict[str, Any]:
    path = folder / LOG_FILE
    log = read_json(path, "log of a training")
    if not isinstance(log, dict) or log.keys() != {"identity", *(field.name for field in fields(StageResult))}:
        raise InputError(f"{path}: not the log of a training by this release; train again, into another folder")
    return log


def _make_model(stage: StageConfig, checkpoint_in: Path | None, config: ToyPolicyConfig | None) -> ToyModel:
    """A new model for Stage 1; for Stage 2 that of the checkpoint, frozen, with a new action expert."""
    if stage.stage == 1:
        with torch.random.fork_rng():
            torch.manual_seed(derive_seed("weights", stage.seed))
            return ToyModel(config or ToyPolicyConfig())
    if checkpoint_in is None:
        raise InputError("stage 2 starts from a Stage 1 folder; give one")
    with torch.random.fork_rng():
        torch.manual_seed(derive_seed("weights", stage.seed, 2))
        model = ToyModel(read_config(checkpoint_in))
    tensors = read_tensors(checkpoint_in)
    vlm = {name.removeprefix(VLM_PREFIX): tensor for name, tensor in tensors.items() if name.startswith(VLM_PREFIX)}
    load_tensors(model.vlm, vlm, checkpoint_in)
    model.vlm.requires_grad_(False)
    return model


def _optimize(
    model: ToyModel,
    stage: StageConfig,
    samples: DrivingSamples,
    steps: list[list[int]],
    warmup: int,
    on_progress: Progress,
) -> list[float]:
    """Run every step; returns the losses. One thread and own generators make equal runs equal byte for byte."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    try:
        trained = model.vlm if stage.stage == 1 else model.expert
        frozen = [tensor.clone() for tensor in model.vlm.state_dict().values()] if stage.stage == 2 else []
        optimizer = torch.optim.AdamW(trained.parameters(), lr=stage.learning_rate, weight_decay=stage.weight_decay)
        losses = []
        for step, rows in enumerate(steps):
            for group in optimizer.param_groups:
                group["lr"] = stage.learning_rate_at(step, len(steps))
            draws = draw_step(stage, len(rows), step)
            losses.append(_accumulate_gradient(model, stage, samples.take(rows), draws, step < warmup))
            nn.utils.clip_grad_norm_(trained.parameters(), stage.max_grad_norm)
            optimizer.step()
            optimizer.zero_grad()
            on_progress((step + 1) / len(steps))
        if not all(map(torch.equal, frozen, model.vlm.state_dict().values())):
            raise RuntimeError("stage 2 changed the frozen vision-language model")
        return losses
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(False)


def _accumulate_gradient(
    model: ToyModel, stage: StageConfig, samples: DrivingSamples, draws: StepDraws, warmup: bool
) -> float:
    """Add the gradient of the samples, part by part; returns the loss: their weighted mean."""
    total, weights = 0.0, samples.weights(stage.invented_pixel_weight)
    weights /= weights.sum()
    for rows in np.array_split(np.arange(len(samples)), min(stage.gradient_accumulation_steps, len(samples))):
        part = {name: values[rows] for name, values in draws.items()}
        losses = sample_losses(model, stage, prepare_batch(samples.take(rows.tolist()), part), warmup)
        loss = losses @ torch.from_numpy(weights[rows].astype(np.float32))
        loss.backward()
        total += loss.item()
    if not math.isfinite(total):
        raise RuntimeError(f"stage {stage.stage}: the loss is not finite")
    return total
