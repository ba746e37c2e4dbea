"""What solver, precision and images do to a toy policy, measured through its own `plan`."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from olt_sft_recipes.benchmarks.flow_solvers import COARSER, REFERENCE, SOLVERS, Solver, integrate
from olt_sft_recipes.benchmarks.motions import Motions
from olt_sft_recipes.benchmarks.tokens import extreme_motions
from olt_sft_recipes.open_loop import displacement_errors, observe
from olt_sft_recipes.toy.policy import ToyPolicy
from olt_toolkit import Observation, PolicySample
from olt_toolkit.runtime.environment import describe_machine

PLANS = 6
Plans = np.ndarray[Any, np.dtype[np.float64]]
"""Plans (samples, 6, 64, 3) in metres."""


@contextmanager
def solved_by(policy: ToyPolicy, solver: Solver, kind: str = "float32") -> Iterator[None]:
    """The policy with another solver in place of its own steps, its expert computing in that type."""
    expert = policy.model.expert

    def sample(noise: Tensor, prefix: Any) -> Tensor:
        lower = torch.autocast("cpu", torch.bfloat16) if kind == "bfloat16" else nullcontext()
        with lower:
            return integrate(expert, solver, noise, prefix).float()

    expert.sample = sample
    try:
        yield
    finally:
        del expert.sample


def plan_all(policy: ToyPolicy, observations: Sequence[Observation]) -> tuple[Plans, float]:
    """Plans of seeds 0 to 5 for each observation, and milliseconds of processor a plan."""
    start = time.process_time()
    plans = [[policy.plan(replace(seen, seed=seed)).xyz for seed in range(PLANS)] for seen in observations]
    spent = time.process_time() - start
    return np.array(plans), 1000.0 * spent / (len(observations) * PLANS)


def min_ade(plans: Plans, truths: Sequence[np.ndarray]) -> float:
    """Mean over samples of the mean distance of the best of six plans, in metres."""
    return float(np.mean([displacement_errors(of, truth)["min_ade"] for of, truth in zip(plans, truths, strict=True)]))


def measure(policy: ToyPolicy, samples: Sequence[PolicySample]) -> dict[str, Any]:
    """Rows by solver, by precision and by what is seen."""
    observations = [replace(observe(sample), route_xy=np.zeros((0, 2))) for sample in samples]
    truths = [sample.ego_future_xyz[0].astype(np.float64) for sample in samples]
    with solved_by(policy, REFERENCE):
        exact, _ = plan_all(policy, observations)
    with solved_by(policy, COARSER):
        coarser, _ = plan_all(policy, observations)

    def row(name: str, plans: Plans, spent: float) -> dict[str, Any]:
        off = np.linalg.norm(plans[..., :2] - exact[..., :2], axis=-1)
        return {
            "setting": name,
            "min_ade_m": min_ade(plans, truths),
            "distance_from_reference_m": float(off.mean()),
            "processor_ms_per_plan": round(spent, 2),
        }

    solvers = []
    for solver in SOLVERS:
        with solved_by(policy, solver):
            solvers.append(row(str(solver), *plan_all(policy, observations)) | {"evaluations": solver.evaluations})
    own = Solver("euler", policy.model.config.integration_steps)
    with solved_by(policy, own, "bfloat16"):
        rows = [row("expert computes in bfloat16", *plan_all(policy, observations))]
    with rounded_weights(policy):
        rows.append(row("weights rounded to bfloat16", *plan_all(policy, observations)))
    rows.append(row("float32", *plan_all(policy, observations)))
    return {
        "samples": len(samples),
        "plans_per_sample": PLANS,
        "reference": str(REFERENCE),
        "reference_doubt_m": float(np.linalg.norm(coarser[..., :2] - exact[..., :2], axis=-1).mean()),
        "own_solver": str(own),
        "solvers": solvers,
        "precision": rows,
        "inputs": _measure_inputs(policy, observations, truths),
        "extremes": [_drive_extreme(policy, name, each, observations[0]) for name, each in extreme_motions().items()],
        "machine": describe_machine(),
    }


@contextmanager
def rounded_weights(policy: ToyPolicy) -> Iterator[None]:
    """The policy with all weights rounded to bfloat16, computing in float32."""
    kept = {name: tensor.clone() for name, tensor in policy.model.state_dict().items()}
    rounded = {
        name: tensor.bfloat16().to(tensor.dtype) if tensor.is_floating_point() else tensor
        for name, tensor in kept.items()
    }
    try:
        policy.model.load_state_dict(rounded)
        yield
    finally:
        policy.model.load_state_dict(kept)


def _measure_inputs(
    policy: ToyPolicy, observations: Sequence[Observation], truths: Sequence[np.ndarray]
) -> list[dict[str, Any]]:
    """What a policy does that is shown nothing, or the images of another sample."""
    seen: dict[str, Callable[[int], Observation]] = {
        "as recorded": lambda number: observations[number],
        "all images black": lambda number: _with_images(observations[number], None),
        "images of another sample": lambda number: _with_images(observations[number], observations[number - 1]),
    }
    rows = []
    for name, show in seen.items():
        plans, _ = plan_all(policy, [show(number) for number in range(len(observations))])
        rows.append({"images": name, "min_ade_m": min_ade(plans, truths)})
    return rows


def _with_images(observation: Observation, other: Observation | None) -> Observation:
    assert observation.images is not None
    images = np.zeros_like(observation.images) if other is None else other.images
    return replace(observation, images=images)


def _drive_extreme(policy: ToyPolicy, name: str, motions: Motions, seen: Observation) -> dict[str, Any]:
    """Plans after a history that strains the policy, with the images of some sample; errors are against the motion."""
    history_xyz, history_rotation, future_xyz, _ = motions.poses()
    strained = replace(seen, history_xyz=history_xyz[0], history_rotation=history_rotation[0])
    plans, _ = plan_all(policy, [strained])
    finite = bool(np.isfinite(plans).all())
    return {
        "motion": name,
        "finite": finite,
        "min_ade_m": min_ade(plans, [future_xyz[0]]) if finite else None,
        "furthest_m": float(np.abs(plans).max()) if math.isfinite(float(np.abs(plans).max())) else None,
    }
