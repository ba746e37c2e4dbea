"""Do checkpoints fit on the disk, and a training step into the memory of the cards?"""

import math
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.checkpoint_folder import CheckpointFolder
from olt_sft_recipes.preflight.memory import ASSUMED, OPTIMIZER_BYTES, describe_bytes, sample_tokens, step_memory
from olt_sft_recipes.preflight.names import PolicyName
from olt_sft_recipes.preflight.parameters import ModelSizes, published_sizes, sizes_of_checkpoint
from olt_sft_recipes.preflight.plan import PreflightPlan, StagePlan
from olt_sft_recipes.preflight.profiles import PROFILES
from olt_sft_recipes.preflight.rows import Row, RowMaker

DISK, MEMORY = RowMaker("disk"), RowMaker("memory")
_BF16 = 2
_SECONDS = 5


def model_sizes(plan: PreflightPlan, base: CheckpointFolder | None) -> ModelSizes | str:
    """Sizes of the model, or why they cannot be told."""
    if base is not None and base.whole:
        try:
            return sizes_of_checkpoint(base.tensors, f"headers of {base.root}")
        except InputError as error:
            return str(error)
    if plan.policy == PolicyName.ALPAMAYO_2:
        return "the sizes of Alpamayo 2 are not published; give a whole checkpoint with --base"
    return published_sizes()


def checkpoint_bytes(sizes: ModelSizes, stage: StagePlan, steps: int | None) -> tuple[int, int, str]:
    """Bytes of one checkpoint, how many lie on the disk at once, and the sum in words.

    The newest is written before the oldest goes. DeepSpeed writes float32 copies and moments of what is trained, and
    the weights a second time; without it the moments are bf16 as the weights.
    """
    trained = sum(sizes.trainable(stage).values())
    held = (sizes.total if stage.stage == 2 else sizes.language_model) + sizes.trainable(stage).get("adapters", 0)
    copies = 2 if stage.zero_stage else 1
    states = OPTIMIZER_BYTES if stage.zero_stage else 2 * _BF16
    each = copies * _BF16 * held + states * trained
    written = math.inf if steps is None else math.ceil(steps / stage.save_steps)
    kept = int(min(stage.save_total_limit + 1, written))
    told = f"stage {stage.stage}: {kept} x {each / 1e9:.1f} GB"
    why = f"{copies} x 2 B x {held / 1e9:.2f} G weights + {states} B x {trained / 1e9:.2f} G trained"
    return each, kept, f"{told} ({why})"


def disk_row(plan: PreflightPlan, sizes: ModelSizes | str, steps: dict[int, int]) -> Row:
    """Free space against the checkpoints of all stages that will run."""
    check = "space for checkpoints"
    if plan.out is None:
        return DISK.not_checked(check, "--out", "no output folder was given")
    if isinstance(sizes, str):
        return DISK.not_checked(check, plan.out, sizes)
    each = [checkpoint_bytes(sizes, stage, steps.get(stage.stage)) for stage in plan.stages]
    needed = sum(size * kept for size, kept, _ in each)
    there = existing_parent(plan.out)
    free = shutil.disk_usage(there).free
    said = f"{' + '.join(told for *_, told in each)} = {needed / 1e9:.1f} GB; {free / 1e9:.1f} GB are free"
    wrong = [said] if needed > free else []
    action = "choose another --out, or a lower save_total_limit or a larger save_steps"
    return DISK.judge(check, there, wrong, said, action)


def existing_parent(path: Path) -> Path:
    """The folder itself, or the nearest above it that is there."""
    path = path.absolute()
    return next(folder for folder in (path, *path.parents) if folder.is_dir())


def memory_rows(plan: PreflightPlan, sizes: ModelSizes | str) -> Iterator[Row]:
    """The peak of a step of each stage against the cards, and what is trained."""
    if isinstance(sizes, str):
        yield MEMORY.not_checked("memory", "--base", sizes)
        return
    cards, told = card_memory(plan)
    profile = PROFILES[plan.policy]
    tokens = sample_tokens(len(plan.contract.cameras), profile.history_tokens, profile.future_tokens)
    for stage in plan.stages:
        trained = sizes.trainable(stage)
        parts = step_memory(sizes, stage, tokens, plan.devices)
        said = f"{describe_bytes(parts)} a card of {plan.devices}, {tokens.total} tokens a sample"
        where = f"stage {stage.stage}, ZeRO {stage.zero_stage}"
        if cards is None:
            why = f"{told}; it needs {said}"
            yield MEMORY.not_checked(f"stage {stage.stage} memory", where, why, "give --gpu-memory")
        else:
            said += f"; {told} have {cards / 2**30:.1f} GiB"
            wrong = [said] if sum(parts.values()) > cards else []
            yield MEMORY.judge(
                f"stage {stage.stage} memory", where, wrong, f"{said}; assumed: {ASSUMED}", _advice(stage)
            )
        count = " + ".join(f"{name} {number:,}" for name, number in trained.items())
        found = f"{sum(trained.values()):,} of {sizes.total:,} parameters: {count} ({sizes.source})"
        action = ""
        if stage.stage == 1 and stage.lora_rank is not None and not stage.lora_freezes_rest:
            action = "beside adapters, embedding, head and image encoder are trained; freeze them if that is not meant"
        yield MEMORY.note(f"stage {stage.stage} trains", where, found, action)


def _advice(stage: StagePlan) -> str:
    more = [] if stage.gradient_checkpointing else ["gradient checkpointing"]
    more += ["a higher ZeRO stage"] if stage.zero_stage < 3 else []
    more += ["a smaller batch a device with more accumulation"] if stage.per_device_train_batch_size > 1 else []
    more += ["LoRA"] if stage.stage == 1 and stage.lora_rank is None else []
    return f"more or larger cards, {', '.join(more)}"


def card_memory(plan: PreflightPlan) -> tuple[int | None, str]:
    """Bytes of the smallest card that would be used, and which these are or why they are not known."""
    if plan.gpu_memory_gib is not None:
        return round(plan.gpu_memory_gib * 2**30), "the cards that were named"
    query = ["nvidia-smi", "--query-gpu=memory.total", "--format=csv,noheader,nounits"]
    try:
        done = subprocess.run(query, capture_output=True, text=True, timeout=_SECONDS, check=True)
        sizes = [int(line) << 20 for line in done.stdout.split("\n") if line.strip()]
    except (OSError, ValueError, subprocess.SubprocessError):
        return None, "there is no nvidia-smi here"
    if len(sizes) < plan.gpus:
        return None, f"{len(sizes)} cards are here and {plan.gpus} were asked for"
    return min(sorted(sizes, reverse=True)[: plan.gpus]), f"the {len(sizes)} cards that are here"
