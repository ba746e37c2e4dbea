"""Arithmetic of the steps, the warm-up and the learning rate."""

from collections.abc import Iterator

from olt_datasets.mixtures.training_arithmetic import TrainingStage, training_arithmetic
from olt_sft_recipes.preflight.plan import PreflightPlan, StagePlan
from olt_sft_recipes.preflight.rows import Row, RowMaker

ROWS = RowMaker("steps")
_LONG_WARMUP = 0.5


def total_steps(plan: PreflightPlan, samples: int | None) -> dict[int, int]:
    """Optimizer steps by stage; empty where the number of samples is not known or 0."""
    if not samples:
        return {}
    return {stage.stage: _arithmetic(plan, stage, samples)["total_steps"] for stage in plan.stages}


def step_rows(plan: PreflightPlan, samples: int | None) -> Iterator[Row]:
    """One row a stage."""
    for stage in plan.stages:
        check, where = f"stage {stage.stage} steps", f"{plan.nodes} nodes x {plan.gpus} devices"
        if not samples:
            yield ROWS.not_checked(check, where, "the number of samples is not known")
            continue
        yield _step_row(plan, stage, samples, check, where)


def _arithmetic(plan: PreflightPlan, stage: StagePlan, samples: int) -> dict[str, int]:
    divided = TrainingStage(
        plan.devices, stage.per_device_train_batch_size, stage.gradient_accumulation_steps, stage.num_train_epochs
    )
    return training_arithmetic(samples, divided)


def _step_row(plan: PreflightPlan, stage: StagePlan, samples: int, check: str, where: str) -> Row:
    numbers = _arithmetic(plan, stage, samples)
    total, warmup = numbers["total_steps"], stage.warmup_steps
    said = (
        f"{samples} samples / ({plan.devices} devices x {stage.per_device_train_batch_size} x accumulation "
        f"{stage.gradient_accumulation_steps}) = {numbers['steps_per_epoch']} steps an epoch, x "
        f"{stage.num_train_epochs} epochs = {total} steps; warm-up {warmup} ({100 * warmup / total:.0f} %); learning "
        f"rate {stage.learning_rate_at(0, total):.3g} at first, {_peak(stage, total):.3g} at most, "
        f"{stage.learning_rate_at(total - 1, total):.3g} at the end"
    )
    if warmup >= total:
        found = f"{said}: the rate never reaches its peak of {stage.learning_rate:g}"
        return ROWS.failed(check, where, found, f"set warmup_steps below {total}, or train on more samples")
    if stage.stage == 2 and stage.per_device_train_batch_size > 1 and plan.policy != "toy":
        found = f"{said}: with more than one sample a device the cache is cut where the last row says"
        return ROWS.failed(check, where, found, "keep per_device_train_batch_size=1 in stage 2")
    notes = [f"the warm-up is {100 * warmup / total:.0f} % of the run"] if warmup > _LONG_WARMUP * total else []
    if numbers["global_batch"] > samples:
        notes.append(
            f"a step would take {numbers['global_batch']} samples and there are {samples}: every epoch is one step"
        )
    elif numbers["padded_samples"] * 4 > samples:
        notes.append(f"{numbers['padded_samples']} of {numbers['samples_per_epoch']} places of an epoch are not filled")
    if stage.save_steps >= total:
        notes.append("no checkpoint is saved before the last step")
    if notes:
        return ROWS.note(check, where, f"{said}; {'; '.join(notes)}")
    return ROWS.passed(check, where, said)


def _peak(stage: StagePlan, total: int) -> float:
    return max(stage.learning_rate_at(step, total) for step in (min(stage.warmup_steps, total) - 1, 0) if step >= 0)
