"""Sampling of one view by the tiny engine: solver, steps and precision against time."""

from functools import lru_cache, partial
from typing import get_args

import numpy as np
import torch
from numpy.typing import NDArray

from olt_generator.diffusion.accounting import make_inputs
from olt_generator.diffusion.conditioned_model import ConditionedModel, Conditions, build_model, cast
from olt_generator.diffusion.config import CONFIGS
from olt_generator.diffusion.generation import draw_noise
from olt_generator.diffusion.sampling import Solver, guided_velocity, integrate, sigma_grid
from olt_toolkit.bench.benchmark import Benchmark, list_settings

FRAMES, HEIGHT, WIDTH, CONDITIONS, TEXT_TOKENS = 5, 32, 48, 2, 8
GUIDANCE = 3.5
STEPS = (10, 25, 50, 100)
REFERENCE_STEPS = 1000
DEFAULT = "euler, 50 steps"

Latents = NDArray[np.float32]


@lru_cache(maxsize=2)
def engine(precision: str) -> tuple[ConditionedModel, Conditions, torch.Tensor]:
    """A model with random weights in which every layer says something, its conditions, and the empty prompt."""
    model = build_model(CONFIGS["tiny"], seed=0).eval().requires_grad_(False)
    generator = torch.Generator().manual_seed(0)
    for parameter in model.parameters():
        if not parameter.any():
            parameter.copy_(0.05 * torch.randn(parameter.shape, generator=generator))
    cast(model, getattr(torch, precision), trainable=True)
    _, conditions = make_inputs(CONFIGS["tiny"], (FRAMES, HEIGHT, WIDTH), CONDITIONS, TEXT_TOKENS)
    for tensor in (conditions.text, conditions.rays, conditions.control, conditions.motion):
        tensor.copy_(torch.randn(tensor.shape, generator=generator))
    return model, conditions, torch.zeros_like(conditions.text)


@torch.inference_mode()
def sample(solver: Solver, steps: int, precision: str = "float32", guidance: float = GUIDANCE) -> Latents:
    """Latents (1, 16, t, h, w) of the view, from always the same noise."""
    model, conditions, empty = engine(precision)
    noise = draw_noise(0, 1, 0, (1 + (FRAMES - 1) // 4, HEIGHT // 8, WIDTH // 8), 0.5)
    velocity = guided_velocity(model, conditions, empty, guidance)
    return integrate(velocity, noise, sigma_grid(steps), solver).float().numpy()


@lru_cache(maxsize=1)
def reference() -> Latents:
    """The same in 1,000 steps of Heun's method, in single precision."""
    return sample("heun", REFERENCE_STEPS)


def measure_error(latents: Latents) -> float:
    """Root mean square difference from the reference, of latents (1, 16, t, h, w) of about unit size."""
    return float(np.sqrt(np.mean((latents.astype(np.float64) - reference()) ** 2)))


def _calls() -> dict[str, partial[Latents]]:
    calls = {
        f"{solver}, {steps} steps": partial(sample, solver, steps) for solver in get_args(Solver) for steps in STEPS
    }
    calls["euler, 50 steps, bfloat16"] = partial(sample, "euler", 50, "bfloat16")
    return calls


def _prepare() -> None:
    engine("float32")
    engine("bfloat16")


BENCHMARK = Benchmark(
    title=f"a view by the tiny engine with random weights, {FRAMES} frames of {WIDTH} x {HEIGHT}, two passes a step",
    error_name="rms error of latents",
    error_unit="of their unit spread",
    reference=f"Heun's method with {REFERENCE_STEPS} steps in single precision, from the same noise",
    settings=lambda: list_settings(_prepare, _calls(), default=DEFAULT),
    measure_error=measure_error,
)
