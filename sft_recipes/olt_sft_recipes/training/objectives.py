"""What a step of each stage learns from: its random draws, its batch, and its loss for each sample.

Everything random of an optimizer step is drawn at once for all of its samples, from the seed, the stage and the step.
So a step comes out the same when training is resumed at it, and in however many parts it is computed.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from olt_generator.seeds import derive_seed, make_generator
from olt_sft_recipes.toy.action_expert import draw_training_times
from olt_sft_recipes.toy.checkpoint import ToyModel
from olt_sft_recipes.toy.inputs import PolicyInputs, encode_inputs
from olt_sft_recipes.toy.tokens import FUTURE_TOKENS, encode_actions
from olt_sft_recipes.training.auxiliary import SightTruth, plan_errors, sight_errors
from olt_sft_recipes.training.driving_samples import DrivingSamples
from olt_sft_recipes.training.stage_config import StageConfig
from olt_toolkit.policy.contract import FUTURE_STEPS

# Future tokens whose cross-entropy a step computes, drawn anew for each sample: the mean is the same, at a quarter of
# the cost of the largest product.
LOSS_TOKENS = 32

StepDraws = dict[str, NDArray[np.generic]]
"""What an optimizer step draws at random, by name; the first axis of each is the samples of the step."""


@dataclass(frozen=True)
class TrainingBatch:
    """Samples as a stage learns from them.

    Attributes:
        inputs: what the prefix is made of.
        actions: (n, 64, 2) normalised actions that drive the futures.
        tokens: (n, 128) of them.
        speeds: (n,) at t0, m/s, from which the actions are driven.
        truth: what is where, for the heads of the image encoder.
        draws: rows of the draws of the step, as tensors.
    """

    inputs: PolicyInputs
    actions: Tensor
    tokens: Tensor
    speeds: Tensor
    truth: SightTruth
    draws: dict[str, Tensor]


def draw_step(stage: StageConfig, count: int, step: int) -> StepDraws:
    """The draws of one optimizer step, counted from 0, over `count` samples."""
    augment = make_generator("training", stage.seed, stage.stage, step)
    noise = torch.Generator().manual_seed(derive_seed("noise", stage.seed, stage.stage, step))
    # A coarse grid, so that the few tables behind the perturbed images are made once.
    offsets, angles = augment.integers(-4, 5, (2, count)) / 4.0
    draws: StepDraws = {
        "offset": stage.move_metres * offsets,
        "angle": np.radians(stage.turn_degrees) * angles,
        "mirrored": np.full(count, augment.random() < stage.mirror_probability),
    }
    if stage.stage == 2:
        draws["time"] = draw_training_times(count, noise).numpy()
        draws["noise"] = torch.randn((count, FUTURE_STEPS, 2), generator=noise).numpy()
    else:
        draws["hidden"] = (torch.rand((count, FUTURE_TOKENS), generator=noise) < stage.hidden_token_probability).numpy()
        draws["chosen"] = torch.rand((count, FUTURE_TOKENS), generator=noise).argsort(dim=1)[:, :LOSS_TOKENS].numpy()
    return draws


def plain_draws(stage: StageConfig, count: int) -> StepDraws:
    """Draws by which samples are judged: nothing is augmented, and what is noise is the same every time."""
    plain = {"mirror_probability": 0.0, "move_metres": 0.0, "turn_degrees": 0.0, "hidden_token_probability": 0.0}
    return draw_step(stage.model_copy(update=plain), count, step=-1)


def augment(samples: DrivingSamples, draws: StepDraws) -> DrivingSamples:
    """The samples with the augmentation that was drawn for them."""
    if draws["offset"].any() or draws["angle"].any():
        samples = samples.perturbed(draws["offset"].astype(np.float64), draws["angle"].astype(np.float64))
    return samples.mirrored() if draws["mirrored"].all() else samples


def prepare_batch(samples: DrivingSamples, draws: StepDraws) -> TrainingBatch:
    """Augment samples and encode them; the draws are those of the same samples."""
    samples = augment(samples, draws)
    actions = samples.actions()
    return TrainingBatch(
        encode_inputs(samples.images, samples.history, samples.routes, samples.config),
        torch.from_numpy(actions.astype(np.float32)),
        torch.from_numpy(encode_actions(actions)[0]),
        torch.from_numpy(samples.speeds().astype(np.float32)),
        SightTruth(
            torch.from_numpy(samples.truth_known.copy()),
            torch.from_numpy(samples.truth_route.copy()),
        ),
        {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in draws.items()},
    )


def sample_losses(model: ToyModel, stage: StageConfig, batch: TrainingBatch, warmup: bool) -> Tensor:
    """Loss (n,) of each sample.

    Of the regression head and the sight (warm-up), of tokens, regression head and sight (Stage 1), or flow matching
    (Stage 2).
    """
    if stage.stage == 2:
        prefix = model.vlm.read_prefix(batch.inputs)
        return model.expert.loss(batch.actions, batch.draws["time"], batch.draws["noise"], prefix)
    if stage.sight_weight > 0.0 and batch.truth.known[:, 0].any():
        model.vlm.sight_taught.fill_(1.0)
    if warmup:
        regressed, sight = model.vlm.regress(batch.inputs)
        return plan_errors(regressed, batch.actions, batch.speeds) + stage.sight_weight * sight_errors(
            sight, batch.truth
        )
    states, regressed, sight = model.vlm(batch.inputs, batch.tokens, batch.draws["hidden"])
    chosen = batch.draws["chosen"]
    logits = model.vlm.logits(states.gather(1, chosen[..., None].expand(-1, -1, states.shape[-1])))
    tokens = batch.tokens.gather(1, chosen)
    token_losses = functional.cross_entropy(logits.transpose(1, 2), tokens, reduction="none").mean(dim=1)
    return (
        token_losses
        + plan_errors(regressed, batch.actions, batch.speeds)
        + stage.sight_weight * sight_errors(sight, batch.truth)
    )
