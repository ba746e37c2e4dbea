"""Judging a model while it is trained: its loss and errors on held-out samples, and a small suite that it drives."""

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from olt_closed_loop import SimulationSettings, run_closed_loop, summarize_scores
from olt_generator.seeds import derive_seed
from olt_sft_recipes.open_loop import evaluate_open_loop
from olt_sft_recipes.toy.checkpoint import read_model
from olt_sft_recipes.toy.policy import ToyPolicy
from olt_sft_recipes.training.driving_samples import DrivingSamples
from olt_sft_recipes.training.objectives import plain_draws, prepare_batch, sample_losses
from olt_sft_recipes.training.stage_config import StageConfig
from olt_toolkit import PolicySample

PLANS = 6
# Samples that are judged at once.
_AT_ONCE = 64


@dataclass(frozen=True)
class Validation:
    """What a model is judged by. What it costs is bounded by what is listed here and by the number of evaluations.

    Attributes:
        samples: recorded samples, none of which is trained on: loss, and open-loop errors in metres.
        scenes: scenes that Stage 2 drives, once each (`run_closed_loop`).
        duration_us: how long each drive lasts at most, warm-up included.
        workers: processes that drive.
    """

    samples: Sequence[PolicySample] = ()
    scenes: Sequence[str] = ()
    duration_us: int = SimulationSettings.duration_us
    workers: int = 1

    def judges(self, stage: int) -> bool:
        """Whether there is anything to judge a stage by."""
        return bool(self.samples) or (stage == 2 and bool(self.scenes))

    def identity(self, stage: int) -> str:
        """What the errors depend on, besides the model."""
        content = hashlib.blake2b(digest_size=16)
        for sample in self.samples:
            for name, value in vars(sample).items():
                content.update(
                    f"\n{name} ".encode() + (value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
                )
        driven = [*self.scenes, str(self.duration_us)] if stage == 2 else []
        return f"{derive_seed(content.hexdigest(), *driven):x}"


def evaluate(checkpoint: Path, stage: StageConfig, validation: Validation) -> dict[str, Any]:
    """Judge a checkpoint, as it lies on the disk.

    Returns:
        eval_loss: mean loss of the samples as they are; None where there are none.
        open_loop: errors in metres (`evaluate_open_loop`) of Stage 2; None in Stage 1, whose model plans nothing.
        closed_loop: AS, CR, and the rollouts and valid ones they rest on; None where nothing was driven.
        seconds: run time.
    """
    start = time.perf_counter()
    result: dict[str, Any] = {"eval_loss": None, "open_loop": None, "closed_loop": None}
    if validation.samples:
        result["eval_loss"] = _mean_loss(checkpoint, stage, validation.samples)
    if stage.stage == 2 and validation.samples:
        result["open_loop"] = evaluate_open_loop(ToyPolicy(read_model(checkpoint)), validation.samples, PLANS)
    if stage.stage == 2 and validation.scenes:
        result["closed_loop"] = _drive(checkpoint, stage, validation)
    return result | {"seconds": time.perf_counter() - start}


def rank(evaluation: dict[str, Any]) -> tuple[float, float, float]:
    """Smaller is better: by the score of the closed loop, then the smallest open-loop error, then the loss."""
    driven, errors, loss = (evaluation[name] for name in ("closed_loop", "open_loop", "eval_loss"))
    score = driven["alpasim_score"] if driven else 0.0
    return (
        float("inf") if score is None else -score,  # nothing that it drove could be scored
        errors["min_ade"] if errors else 0.0,
        0.0 if loss is None else loss,
    )


def _mean_loss(checkpoint: Path, stage: StageConfig, samples: Sequence[PolicySample]) -> float:
    model = read_model(checkpoint)
    draws = plain_draws(stage, len(samples))
    total = 0.0
    for start in range(0, len(samples), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        gathered = DrivingSamples.gather(list(samples[part]), model.config)
        batch = prepare_batch(gathered, {name: values[part] for name, values in draws.items()})
        with torch.no_grad():
            total += sample_losses(model, stage, batch, warmup=False).sum().item()
    return total / len(samples)


def _drive(checkpoint: Path, stage: StageConfig, validation: Validation) -> dict[str, Any]:
    results = run_closed_loop(
        list(validation.scenes),
        f"toy:{checkpoint}",
        rollouts=1,
        seed=stage.seed,
        settings=SimulationSettings(duration_us=validation.duration_us),
        workers=validation.workers,
    )
    overall = summarize_scores([score for _, score in results]).overall
    kept = ("alpasim_score", "collision_rate", "rollouts", "valid", "failed")
    return {name: getattr(overall, name) for name in kept}
