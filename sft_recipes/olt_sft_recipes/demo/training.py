"""Stage: the toy policy trained on each mixture, in two stages."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from olt_datasets.mixtures.mixture import Mixture
from olt_sft_recipes.demo.job import Job
from olt_sft_recipes.demo.mixtures import RECIPES, compose
from olt_sft_recipes.open_loop import evaluate_open_loop, spread_keys
from olt_sft_recipes.stage_config import builtin_stage_config
from olt_sft_recipes.toy_policy import load_toy
from olt_sft_recipes.training import train_on_mixture
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.runtime.workers import map_parallel

VALIDATION_SAMPLES_PER_CLIP = 6


@dataclass(frozen=True)
class TrainingOrder:
    """One policy to train: on which mixture, into which folder, with which seed."""

    mixture: Mixture
    out: Path
    seed: int


def train_policies(job: Job) -> dict[str, Any]:
    """Train a policy on each mixture, one process each; returns losses and open-loop errors by mixture."""
    orders = [TrainingOrder(compose(job, name), job.policy(name), job.settings.seed) for name in RECIPES]
    trained = map_parallel(train_to_order, orders, job.workers, job.on_progress)
    return {
        name: {"stages": stages, "open_loop": _evaluate(job, name), "seconds": seconds}
        for name, (stages, seconds) in zip(RECIPES, trained, strict=True)
    }


def train_to_order(order: TrainingOrder) -> tuple[list[dict[str, Any]], float]:
    """Train one policy; returns the results of its stages, times apart."""
    stages = builtin_stage_config(1), builtin_stage_config(2)
    results = train_on_mixture(order.mixture, stages, order.seed, order.out)
    described = [vars(result).copy() for result in results]
    return described, sum(stage.pop("seconds") for stage in described)


def _evaluate(job: Job, name: str) -> dict[str, float]:
    """Errors on the held-out drives."""
    store = ClipStore(job.clips)
    samples = store.load_samples(spread_keys(store, "val", VALIDATION_SAMPLES_PER_CLIP))
    return evaluate_open_loop(load_toy(str(job.policy(name) / "policy")), samples)
