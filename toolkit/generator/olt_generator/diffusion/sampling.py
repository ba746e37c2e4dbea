"""From noise to latents: the grid of noise levels, the solvers, and guidance.

z(sigma) = (1 - sigma) z + sigma eps, and the model tells dz / dsigma = eps - z. sigma runs from 1 (noise) to 0.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from olt_generator.diffusion.conditioned_model import ConditionedModel, Conditions
from olt_generator.diffusion.memory_bank import Memory
from olt_generator.errors import InputError
from olt_generator.poses import Array

# By which the noise levels of training and sampling are shifted (docs/formats/generator.md).
SHIFT = 3.0

Solver = Literal["euler", "heun", "unipc", "dpm++"]

# Velocity (b, 16, t, h, w) of latents at noise levels (b,).
Velocity = Callable[[Tensor, Tensor], Tensor]


def shift_sigma(time: Array, shift: float = SHIFT) -> Array:
    """Noise levels sigma = s t / (1 + (s - 1) t) of uniform times t from 0 to 1."""
    return shift * time / (1.0 + (shift - 1.0) * time)


def sigma_grid(steps: int, shift: float = SHIFT, start: float = 1.0) -> Array:
    """Noise levels (steps + 1,) from `start` to exactly 0, uniform in time and shifted once.

    Raises:
        InputError: no step, or a start outside of (0, 1].
    """
    if steps < 1 or not 0.0 < start <= 1.0 or shift <= 0.0:
        raise InputError(f"{steps} steps from sigma {start} with shift {shift}: give at least 1, a sigma in (0, 1]")
    start_time = start / (shift - (shift - 1.0) * start)
    return shift_sigma(np.linspace(start_time, 0.0, steps + 1), shift)


def integrate(velocity: Velocity, noise: Tensor, sigmas: Array, solver: Solver = "euler") -> Tensor:
    """Latents at the last noise level from those at the first.

    "euler" and "dpm++" and "unipc" ask for one velocity a step, "heun" for two but in the last one, where it is Euler.
    The last two are diffusers' multistep solvers on these same levels.

    Args:
        velocity: asked in the type of `noise`.
        noise: (b, 16, t, h, w) at noise level `sigmas[0]`.
        sigmas: (n + 1,) falling to 0, of `sigma_grid`.

    Raises:
        InputError: no such solver, levels that do not fall to 0, or a velocity that is not finite.
    """
    if solver not in get_args(Solver):
        raise InputError(f"solver {solver!r}: choose from {', '.join(get_args(Solver))}")
    if len(sigmas) < 2 or sigmas[-1] != 0.0 or not (np.diff(sigmas) < 0.0).all():
        raise InputError("noise levels do not fall to 0; take them from sigma_grid")
    if solver in ("unipc", "dpm++"):
        return _multistep(velocity, noise, sigmas, solver)
    latents = noise
    for sigma, following in zip(sigmas[:-1].tolist(), sigmas[1:].tolist(), strict=True):
        slope = _ask(velocity, latents, sigma)
        ahead = latents + (following - sigma) * slope
        if solver == "heun" and following > 0.0:
            ahead = latents + 0.5 * (following - sigma) * (slope + _ask(velocity, ahead, following))
        latents = ahead
    return latents


def guided_velocity(
    model: ConditionedModel,
    conditions: Conditions,
    empty_text: Tensor | None = None,
    scale: float = 1.0,
    memory: Memory | None = None,
) -> Velocity:
    """The model's velocity, led away from what it says without the prompt: v_empty + scale (v_text - v_empty).

    At scale 1 that is v_text, and the pass without the prompt is left out.

    Args:
        empty_text: (1 or b, l, text_dim) embedding of the empty prompt.
        memory: of `ConditionedModel.remember`; made once where it is None.

    Raises:
        InputError: a scale other than 1 without the empty prompt.
    """
    if scale != 1.0 and empty_text is None:
        raise InputError(f"guidance {scale}: needs the embedding of the empty prompt; give it, or a scale of 1")
    if memory is None and conditions.views is not None:
        memory = model.remember(conditions.views, conditions.motion)
    if scale == 1.0 or empty_text is None:
        return lambda latents, sigma: model(latents, sigma, conditions, memory)
    without = replace(conditions, text=empty_text.expand(len(conditions.text), -1, -1))

    def velocity(latents: Tensor, sigma: Tensor) -> Tensor:
        unguided = model(latents, sigma, without, memory)
        return unguided + scale * (model(latents, sigma, conditions, memory) - unguided)

    return velocity


def _ask(velocity: Velocity, latents: Tensor, sigma: float) -> Tensor:
    slope = velocity(latents, torch.full((len(latents),), sigma, device=latents.device))
    if not torch.isfinite(slope).all():
        raise InputError(f"sampling: a velocity at sigma {sigma:.4g} is not finite; use a higher precision")
    return slope


def _multistep(velocity: Velocity, noise: Tensor, sigmas: Array, solver: str) -> Tensor:
    scheduler = _make_scheduler(solver)
    scheduler.set_timesteps(len(sigmas) - 1, device=noise.device)
    # Its own grid would be another one; these are the levels that were asked for. At exactly 1 it divides by zero.
    levels = np.minimum(sigmas, 1.0 - 1e-6)
    scheduler.sigmas = torch.tensor(levels, dtype=torch.float32)
    scheduler.timesteps = torch.arange(len(sigmas) - 1, device=noise.device)
    latents = noise
    for timestep, sigma in zip(scheduler.timesteps, sigmas[:-1].tolist(), strict=True):
        latents = scheduler.step(_ask(velocity, latents, sigma), timestep, latents, return_dict=False)[0]
    return latents


def _make_scheduler(solver: str) -> Any:
    try:
        from diffusers.schedulers.scheduling_dpmsolver_multistep import DPMSolverMultistepScheduler
        from diffusers.schedulers.scheduling_unipc_multistep import UniPCMultistepScheduler
    except ImportError as error:
        raise InputError(f"solver {solver!r} needs diffusers; pip install 'olt-generator[learned]'") from error
    kind = UniPCMultistepScheduler if solver == "unipc" else DPMSolverMultistepScheduler
    return kind(prediction_type="flow_prediction", use_flow_sigmas=True)
