"""`olt sft preflight`: look at everything that a launch would use before a card is rented."""

from pathlib import Path
from typing import Annotated

import typer

from olt_sft_recipes.preflight.names import PolicyName, StageChoice

DataOption = Annotated[
    Path | None,
    typer.Option(help="`local_dir` of the training data, an export; for the toy a mixture or a clip store."),
]
ChunksOption = Annotated[
    str | None, typer.Option(help="`chunk_ids` as the recipe gets them: FIRST-END, END left out. All by default.")
]


def preflight(
    policy: Annotated[PolicyName, typer.Option(help="Whose training is to be launched.")],
    stage: Annotated[StageChoice, typer.Option(help="Which stages will run.")] = StageChoice.BOTH,
    data: DataOption = None,
    chunk_ids: ChunksOption = None,
    val_data: Annotated[Path | None, typer.Option(help="`local_dir` of the validation data.")] = None,
    val_chunk_ids: Annotated[str | None, typer.Option(help="The same of the validation data.")] = None,
    default_keyframe: Annotated[
        bool,
        typer.Option(
            "--default-keyframe/--event-times",
            help="Samples at 5.1 s, as the recipe has it, or at the times that the clip index tells.",
        ),
    ] = True,
    base: Annotated[Path | None, typer.Option(help="Folder of the released checkpoint.")] = None,
    stage1: Annotated[Path | None, typer.Option(help="Checkpoint of Stage 1 that Stage 2 starts from.")] = None,
    vlm: Annotated[Path | None, typer.Option(help="Folder with processor and vocabulary of the base model.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder that the training will write.")] = None,
    python: Annotated[Path | None, typer.Option(help="Interpreter of the recipe's environment.")] = None,
    nodes: Annotated[int, typer.Option(min=1, help="Machines.")] = 1,
    gpus: Annotated[int | None, typer.Option(min=1, help="Processes a machine; 8, and 1 for the toy.")] = None,
    gpu_memory: Annotated[float | None, typer.Option(help="GiB of each card; asks nvidia-smi by default.")] = None,
    batch: Annotated[int | None, typer.Option(min=1, help="Samples a device and pass.")] = None,
    accumulation: Annotated[int | None, typer.Option(min=1, help="Passes an optimizer step.")] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="Passes over the data.")] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Peak of the learning rate.")] = None,
    warmup_steps: Annotated[int | None, typer.Option(min=0, help="Optimizer steps of linear warm-up.")] = None,
    zero: Annotated[int | None, typer.Option(min=0, max=3, help="Stage of ZeRO; 0 is without DeepSpeed.")] = None,
    gradient_checkpointing: Annotated[
        bool | None, typer.Option(help="Whether activations are computed again for the backward pass.")
    ] = None,
    lora_rank: Annotated[int | None, typer.Option(min=1, help="Adapters of that rank in Stage 1.")] = None,
    lora_freezes_rest: Annotated[
        bool, typer.Option(help="Whether embeddings, head and image encoder are frozen beside adapters.")
    ] = True,
    save_steps: Annotated[int | None, typer.Option(min=1, help="Steps from checkpoint to checkpoint.")] = None,
    save_total_limit: Annotated[int | None, typer.Option(min=1, help="Checkpoints that are kept.")] = None,
    most_saturated: Annotated[
        float | None,
        typer.Option(min=0.0, max=1.0, help="Share of saturated trajectory tokens beyond which it fails; 0.01."),
    ] = None,
    clips: Annotated[int, typer.Option(min=1, help="Clips that are opened one by one, while time allows.")] = 64,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check data, checkpoints, versions, disk, memory and steps of a launch within seconds.

    What is not given takes the recipe's value, or is not checked and said so. Exit status 1 if a check failed.
    """
    from dataclasses import replace

    from olt_sft_recipes.preflight.check import check
    from olt_sft_recipes.preflight.plan import MOST_SATURATED, PreflightPlan, recipe_stages
    from olt_sft_recipes.preflight.table import print_report
    from olt_toolkit.runtime.console import print_json

    given = {
        "per_device_train_batch_size": batch,
        "gradient_accumulation_steps": accumulation,
        "num_train_epochs": epochs,
        "learning_rate": learning_rate,
        "warmup_steps": warmup_steps,
        "zero_stage": zero,
        "gradient_checkpointing": gradient_checkpointing,
        "save_steps": save_steps,
        "save_total_limit": save_total_limit,
    }
    changes = {key: value for key, value in given.items() if value is not None}
    stages = [replace(each, **changes) for each in recipe_stages(policy) if stage.value in (str(each.stage), "both")]
    if lora_rank is not None:
        adapters = {"lora_rank": lora_rank, "lora_freezes_rest": lora_freezes_rest}
        stages = [replace(each, **adapters) if each.stage == 1 else each for each in stages]
    plan = PreflightPlan(
        policy=policy.value,
        stages=tuple(stages),
        data=data,
        chunk_ids=chunk_ids,
        val_data=val_data,
        val_chunk_ids=val_chunk_ids,
        use_default_keyframe=default_keyframe,
        base=base,
        stage1=stage1,
        vlm=vlm,
        out=out,
        nodes=nodes,
        gpus=gpus or (1 if policy is PolicyName.TOY else 8),
        gpu_memory_gib=gpu_memory,
        python=python,
        most_saturated=MOST_SATURATED if most_saturated is None else most_saturated,
        clips=clips,
    )
    report = check(plan)
    print_json(report.to_dict()) if as_json else print_report(report)
    if report.failures:
        raise typer.Exit(1)
