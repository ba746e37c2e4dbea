"""Two-stage training of the toy VLA.

Stage 1 trains the vision-language model to say the future in words. Its loss is the mean cross-entropy over the future
words; the real recipe adds a second mean over the other labelled words (reasoning, end of message), which the toy does
not have, and the toy adds the squared error of the future in numbers (`VisionLanguageModel.outlook`). Stage 2 takes
that model, freezes it, and trains the action expert alone by flow matching. Facts sheets alpamayo_interface, sections
6 and 7, and alpamayo_recipes_sft, section 2.
"""

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from olt_datasets.mixtures.dataset import MixtureDataset
from olt_datasets.mixtures.mixture import Mixture
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.poses import Array
from olt_generator.progress import Progress, silent
from olt_generator.seeds import derive_seed, make_generator
from olt_sft_recipes.action_expert import draw_training_times
from olt_sft_recipes.driving_samples import DrivingSamples
from olt_sft_recipes.stage_config import StageConfig
from olt_sft_recipes.tokens import FUTURE_TOKENS, encode_actions
from olt_sft_recipes.toy_config import ToyPolicyConfig
from olt_sft_recipes.toy_inputs import PolicyInputs, encode_inputs
from olt_sft_recipes.toy_model import ToyModel
from olt_sft_recipes.toy_policy import load_tensors, read_config, read_tensors, save_model
from olt_toolkit.policy.sample import PolicySample, SampleKey

Batches = Callable[[int], Sequence[Sequence[SampleKey]]]
"""The batches of an epoch."""

LoadSamples = Callable[[Sequence[SampleKey]], Sequence[PolicySample]]
LOG_FILE = "training_log.json"
VLM_PREFIX = "vlm."
# Words of a future whose cross-entropy a step computes, drawn anew each time: the mean is the same, at a quarter of the
# cost of the largest product.
JUDGED_WORDS = 32


@dataclass(frozen=True)
class StageResult:
    """What training one stage gave.

    Attributes:
        stage: 1 or 2.
        steps: optimizer steps.
        samples: distinct samples.
        losses: loss of every step.
        final_loss: mean loss of the last tenth of the steps.
        looking_losses: before them, the loss of every step of `looking_epochs`.
        saturated_words: future words of the unturned samples that say the end of the range in place of a value.
        seconds: run time; the only part that differs between equal trainings.
    """

    stage: int
    steps: int
    samples: int
    losses: tuple[float, ...]
    final_loss: float
    looking_losses: tuple[float, ...]
    saturated_words: int
    seconds: float


def train_on_mixture(
    mixture: Mixture, stages: tuple[StageConfig, StageConfig], seed: int, out: Path, on_progress: Progress = silent
) -> list[StageResult]:
    """Train both stages on a mixture, as `train_two_stages` does; `seed` replaces that of the stages.

    Raises:
        InputError: as `train_two_stages`, or a sample of the mixture cannot be loaded.
    """
    first, second = (stage.model_copy(update={"seed": seed}) for stage in stages)
    return train_two_stages(
        (first, second),
        lambda stage: lambda epoch: mixture.epoch(epoch, stage.samples_per_step),
        MixtureDataset(mixture, image_size=None).load_batch,
        out,
        on_progress=on_progress,
    )


def train_two_stages(
    stages: tuple[StageConfig, StageConfig],
    batches: Callable[[StageConfig], Batches],
    load_samples: LoadSamples,
    out: Path,
    model_config: ToyPolicyConfig | None = None,
    on_progress: Progress = silent,
) -> list[StageResult]:
    """Train both stages; `out/stage1` holds the first, `out/policy` what drives.

    A finished stage of the same configuration is taken as it is; an interrupted one starts anew.

    Args:
        stages: configurations of Stage 1 and Stage 2.
        batches: gives for a stage's batch size the batches of each epoch.
        load_samples: loads samples by key.
        out: folder of the training.
        model_config: sizes of the model.
        on_progress: told the share of the work that is done.

    Raises:
        InputError: a stage configuration does not fit, or a stage's weights do not match the model.
    """
    first, second = stages
    if (first.stage, second.stage) != (1, 2):
        raise InputError(f"training: stages {first.stage} and {second.stage} were given; give stage 1, then stage 2")
    one = train_stage(first, batches(first), load_samples, None, out / "stage1", model_config, _part(on_progress, 0))
    two = train_stage(
        second, batches(second), load_samples, out / "stage1", out / "policy", None, _part(on_progress, 1)
    )
    return [one, two]


def train_stage(
    stage: StageConfig,
    batches: Batches,
    load_samples: LoadSamples,
    checkpoint_in: Path | None,
    out: Path,
    model_config: ToyPolicyConfig | None = None,
    on_progress: Progress = silent,
) -> StageResult:
    """Train one stage and write its folder: configuration, weights, and the log of the losses.

    Args:
        stage: how to train.
        batches: the batches of each epoch.
        load_samples: loads samples by key; each distinct sample is loaded once and kept in memory.
        checkpoint_in: the Stage 1 folder that Stage 2 starts from; None for Stage 1.
        out: folder to write.
        model_config: sizes of a new model; None for the usual ones, or those of the checkpoint.
        on_progress: told the share of the work that is done.

    Raises:
        InputError: Stage 2 has no checkpoint, or its weights do not match the model.
    """
    epochs = [[list(batch) for batch in batches(epoch)] for epoch in range(stage.num_train_epochs)]
    keys = sorted({key for epoch in epochs for batch in epoch for key in batch})
    identity = _identify(stage, keys, checkpoint_in)
    finished = _read_finished(out, identity)
    if finished is not None:
        on_progress(1.0)
        return finished
    start = time.perf_counter()
    model = _make_model(stage, checkpoint_in, model_config)
    samples = DrivingSamples.gather(list(load_samples(keys)), model.config)
    rows = {key: row for row, key in enumerate(keys)}
    steps = [[rows[key] for key in batch] for epoch in epochs for batch in epoch]
    looking = sum(len(epoch) for epoch in epochs[: stage.looking_epochs])
    all_losses = [round(loss, 6) for loss in _optimize(model, stage, samples, steps, looking, on_progress)]
    losses = all_losses[looking:]
    tail = losses[-max(1, len(losses) // 10) :]
    result = StageResult(
        stage=stage.stage,
        steps=len(losses),
        samples=len(keys),
        losses=tuple(losses),
        final_loss=round(float(np.mean(tail)), 6),
        looking_losses=tuple(all_losses[:looking]),
        saturated_words=encode_actions(samples.actions()).saturated,
        seconds=time.perf_counter() - start,
    )
    save_model(out, model)
    with write_whole(out / LOG_FILE) as path:
        path.write_text(json.dumps({"identity": identity, **asdict(result)}) + "\n")
    return result


def _optimize(
    model: ToyModel,
    stage: StageConfig,
    samples: DrivingSamples,
    steps: list[list[int]],
    looking: int,
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
        draw = make_generator("training", stage.seed, stage.stage)
        noise = torch.Generator().manual_seed(derive_seed("noise", stage.seed, stage.stage))
        losses = []
        for step, batch in enumerate(steps):
            _set_learning_rate(optimizer, stage.learning_rate_at(step, len(steps)))
            varied = _vary(samples.take(batch), stage, draw)
            losses.append(_step(model, stage, step < looking, trained, optimizer, varied, noise))
            on_progress((step + 1) / len(steps))
        if not all(map(torch.equal, frozen, model.vlm.state_dict().values())):
            raise RuntimeError("stage 2 changed the frozen vision-language model")
        return losses
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(False)


def _step(
    model: ToyModel,
    stage: StageConfig,
    looking: bool,
    trained: nn.Module,
    optimizer: torch.optim.Optimizer,
    batch: DrivingSamples,
    noise: torch.Generator,
) -> float:
    total = 0.0
    for part in _split(batch, stage.gradient_accumulation_steps):
        inputs = encode_inputs(part.images, part.history)
        if looking:
            loss = _number_loss(model.look(inputs), part.actions())
        elif stage.stage == 1:
            loss = _word_loss(model, inputs, part.actions(), stage.hidden_token_probability, noise)
        else:
            loss = _flow_loss(model, inputs, part.actions(), noise)
        loss = loss * (len(part) / len(batch))
        loss.backward()
        total += loss.item()
    if not math.isfinite(total):
        raise RuntimeError(f"stage {stage.stage}: the loss is not finite")
    nn.utils.clip_grad_norm_(trained.parameters(), stage.max_grad_norm)
    optimizer.step()
    optimizer.zero_grad()
    return total


def _word_loss(model: ToyModel, inputs: PolicyInputs, actions: Array, hide: float, draw: torch.Generator) -> Tensor:
    words = torch.from_numpy(encode_actions(actions).tokens)
    hidden = torch.rand(words.shape, generator=draw) < hide
    spoken, outlook = model.say(inputs, words, hidden)
    judged = torch.randperm(FUTURE_TOKENS, generator=draw)[:JUDGED_WORDS]
    logits = model.vlm.logits(spoken[:, judged])
    return functional.cross_entropy(logits.flatten(0, 1), words[:, judged].flatten()) + _number_loss(outlook, actions)


def _number_loss(outlook: Tensor, actions: Array) -> Tensor:
    return functional.mse_loss(outlook, torch.from_numpy(actions.astype(np.float32)))


def _flow_loss(model: ToyModel, inputs: PolicyInputs, actions: Array, draw: torch.Generator) -> Tensor:
    wanted = torch.from_numpy(actions.astype(np.float32))
    times = draw_training_times(len(wanted), draw)
    noise = torch.randn(wanted.shape, generator=draw)
    return model.expert.loss(wanted, times, noise, model.cache(inputs))


def _vary(batch: DrivingSamples, stage: StageConfig, draw: np.random.Generator) -> DrivingSamples:
    if stage.move_metres or stage.turn_degrees:
        # A coarse grid, so that the few tables behind the moved images are made once.
        offsets, angles = draw.integers(-4, 5, (2, len(batch))) / 4.0
        batch = batch.moved(stage.move_metres * offsets, np.radians(stage.turn_degrees) * angles)
    return batch.mirrored() if draw.random() < stage.mirror_probability else batch


def _split(batch: DrivingSamples, parts: int) -> list[DrivingSamples]:
    rows = np.array_split(np.arange(len(batch)), min(parts, len(batch)))
    return [batch.take(part.tolist()) for part in rows]


def _make_model(stage: StageConfig, checkpoint_in: Path | None, config: ToyPolicyConfig | None) -> ToyModel:
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
    # A loader that skips names which do not match trains on an untouched model without a word
    # (docs/formats/sft_recipes.md); this one refuses.
    load_tensors(model.vlm, vlm, checkpoint_in)
    model.vlm.requires_grad_(False)
    return model


def _set_learning_rate(optimizer: torch.optim.Optimizer, rate: float) -> None:
    for group in optimizer.param_groups:
        group["lr"] = rate


def _identify(stage: StageConfig, keys: list[SampleKey], checkpoint_in: Path | None) -> str:
    samples = derive_seed(*(f"{key.clip_id} {key.t0_us}" for key in keys))
    before = "" if checkpoint_in is None else json.loads((checkpoint_in / LOG_FILE).read_text())["identity"]
    return f"{derive_seed(stage.model_dump_json(), samples, before):x}"


def _read_finished(out: Path, identity: str) -> StageResult | None:
    path = out / LOG_FILE
    if not path.exists():
        return None
    log = json.loads(path.read_text())
    if log.pop("identity") != identity:
        return None
    losses = {name: tuple(log[name]) for name in ("losses", "looking_losses")}
    return StageResult(**{**log, **losses})


def _part(on_progress: Progress, index: int) -> Progress:
    return lambda share: on_progress((index + share) / 2)
