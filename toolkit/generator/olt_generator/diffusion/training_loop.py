"""The loop of training: AdamW, its schedule, clipping, running mean, checkpoints; one process or many by accelerate.

Everything random of step n is drawn from the seed and n, so a run that was killed and goes on has the losses that it
would have had.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn

from olt_generator.diffusion.training_settings import OptimizerSettings
from olt_generator.diffusion.training_state import RunningMean, keep_losses, load_state, save_state
from olt_generator.errors import InputError
from olt_generator.files import make_folder
from olt_generator.progress import Progress, silent

Precision = Literal["float32", "bfloat16"]

# The losses (n,) of samples by number, with gradients: of the model, and the numbers of this process's samples.
SampleLosses = Callable[[nn.Module, list[int]], Tensor]


def train(
    model: nn.Module,
    losses_of: SampleLosses,
    settings: OptimizerSettings,
    run: Path,
    precision: Precision = "float32",
    facts: Mapping[str, Any] | None = None,
    on_progress: Progress = silent,
) -> dict[str, Tensor]:
    """Train what wants gradients of a model, or go on where a run in this folder stopped.

    Step n takes the samples n b to n b + b - 1, shared out among the processes. Losses go to `losses.jsonl`.

    Args:
        facts: what else the run depends on; a run with other facts is not gone on with.

    Returns:
        The running mean of the trained weights by name, which the model has too.

    Raises:
        InputError: accelerate is not installed, the samples of a step cannot be shared out evenly, a loss is not
            finite, the folder holds another run, or sharded training is asked for.
    """
    accelerator = _make_accelerator()
    if settings.batch % accelerator.num_processes:
        raise InputError(f"batch {settings.batch}: give a multiple of the {accelerator.num_processes} processes")
    model.to(accelerator.device)
    trained = {name: parameter for name, parameter in model.named_parameters() if parameter.requires_grad}
    optimizer, mean = make_optimizer(trained, settings), RunningMean(trained, settings.average)
    told = {"optimizer": asdict(settings), "precision": precision, **(facts or {})}
    begun = load_state(run, trained, mean, optimizer, told)
    log = make_folder(run) / "losses.jsonl"
    if accelerator.is_main_process:
        keep_losses(log, begun)
    # The optimizer is not prepared: there is nothing of it to share out, and it keeps the parameters as they are.
    wrapped = accelerator.prepare_model(model)
    wrapped.train()
    share = settings.batch // accelerator.num_processes
    for step in range(begun, settings.steps):
        first = step * settings.batch + accelerator.process_index * share
        with torch.autocast(accelerator.device.type, torch.bfloat16, enabled=precision == "bfloat16"):
            loss = losses_of(wrapped, list(range(first, first + share))).mean()
        accelerator.backward(loss)
        norm = nn.utils.clip_grad_norm_(trained.values(), settings.clip)
        for group in optimizer.param_groups:
            group["lr"] = group["rate"] * rate_share(step, settings)
        value = float(accelerator.reduce(loss.detach().float(), "mean"))
        if not math.isfinite(value) or not math.isfinite(float(norm)):
            raise InputError(f"{run}: loss {value}, gradient {float(norm)} in step {step}; lower the learning rate")
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        mean.update(trained, step)
        if accelerator.is_main_process:
            with log.open("a") as file:
                file.write(json.dumps({"step": step, "loss": value, "gradient": float(norm)}) + "\n")
            if (step + 1) % settings.save_every == 0 or step + 1 == settings.steps:
                save_state(run, step + 1, trained, mean, optimizer, told)
        on_progress((step + 1) / settings.steps)
    accelerator.wait_for_everyone()
    mean.copy_to(trained)
    model.eval()
    return mean.weights


def make_optimizer(trained: Mapping[str, nn.Parameter], settings: OptimizerSettings) -> torch.optim.AdamW:
    """AdamW with two groups: the adapters, without weight decay, and everything else."""
    adapters = [parameter for name, parameter in trained.items() if "lora_" in name]
    others = [parameter for name, parameter in trained.items() if "lora_" not in name]
    groups = [
        {"params": adapters, "rate": settings.adapter_rate, "weight_decay": 0.0},
        {"params": others, "rate": settings.new_rate, "weight_decay": settings.weight_decay},
    ]
    return torch.optim.AdamW([group for group in groups if group["params"]], betas=settings.betas)


def rate_share(step: int, settings: OptimizerSettings) -> float:
    """Share of the largest learning rate in step n >= 0: a line up to the warm-up's end, then half a cosine down."""
    if step < settings.warmup:
        return (step + 1) / settings.warmup
    done = (step - settings.warmup) / max(1, settings.steps - 1 - settings.warmup)
    return settings.least_ratio + (1.0 - settings.least_ratio) * 0.5 * (1.0 + math.cos(math.pi * min(1.0, done)))


def _make_accelerator() -> Any:
    try:
        from accelerate import Accelerator, DistributedType
        from accelerate.utils import DistributedDataParallelKwargs
    except ImportError as error:
        raise InputError("training needs accelerate; pip install 'olt-generator[learned]'") from error
    accelerator = Accelerator(
        mixed_precision="no",
        cpu=not torch.cuda.is_available(),
        kwargs_handlers=[DistributedDataParallelKwargs(broadcast_buffers=False, find_unused_parameters=True)],
    )
    if accelerator.distributed_type in (DistributedType.FSDP, DistributedType.DEEPSPEED):
        raise InputError(
            "training: what is trained of an engine fits on every device; launch it without FSDP or DeepSpeed"
        )
    return accelerator
