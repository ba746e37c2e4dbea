"""`olt sft launch`, and what goes with it: following a log, handing a policy to AlpaSim, differences."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from olt_datasets.commands.comparing import AllowUncomparedOption
from olt_sft_recipes.commands.mixtures import choose_mixture
from olt_sft_recipes.preflight.names import PolicyName, StageChoice

if TYPE_CHECKING:
    from olt_datasets import Mixture
    from olt_sft_recipes.launch.alpamayo import LaunchRequest, PreparedLaunch

Stores = Annotated[list[Path], typer.Option(help="Clip store; may be given several times.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Out = Annotated[Path, typer.Option(help="Folder of the launch; the same command goes on where it ended.")]


def launch(
    policy: Annotated[PolicyName, typer.Option(help="The policy that is trained.")],
    out: Out = Path("training"),
    recipe: Annotated[str | None, typer.Option(help="A recipe, composed here from --stores.")] = None,
    mixture: Annotated[Path | None, typer.Option(help="Instead of it: what `olt mix compose` wrote.")] = None,
    stores: Stores = [],  # noqa: B006 - typer reads the default, nobody changes it
    pai: Annotated[Path | None, typer.Option(help="Instead of both: what `olt data export` wrote. Alpamayo.")] = None,
    chunks: Annotated[
        str | None, typer.Option(metavar="FIRST-END", help="Chunks of --pai, END left out; all by default.")
    ] = None,
    validation: Annotated[
        Path | None, typer.Option(help="PhysicalAI-AV folder by which the recipe evaluates. Alpamayo.")
    ] = None,
    validation_chunks: Annotated[
        str | None, typer.Option(metavar="FIRST-END", help="Chunks of --validation; all by default.")
    ] = None,
    stage: Annotated[StageChoice, typer.Option(help="Which stages run.")] = StageChoice.BOTH,
    stage1: Annotated[Path | None, typer.Option(help="YAML of Stage 1; by default that of the paper's table.")] = None,
    stage2: Annotated[Path | None, typer.Option(help="YAML of Stage 2.")] = None,
    stage1_checkpoint: Annotated[
        Path | None, typer.Option(help="Stage 1's last checkpoint, for --stage 2 alone. Alpamayo.")
    ] = None,
    base: Annotated[Path | None, typer.Option(help="Folder of the released checkpoint. Alpamayo.")] = None,
    recipes: Annotated[Path | None, typer.Option(help="Clone of NVlabs/alpamayo-recipes. Alpamayo.")] = None,
    python: Annotated[Path | None, typer.Option(help="Interpreter of the recipe's environment. Alpamayo.")] = None,
    vlm: Annotated[
        Path | None, typer.Option(help="Local folder of Qwen/Qwen3-VL-8B-Instruct; from Hugging Face without.")
    ] = None,
    nodes: Annotated[int | None, typer.Option(min=1, help="Machines, 1 by default. Alpamayo.")] = None,
    gpus: Annotated[int | None, typer.Option(min=1, help="Processes on each, 8 by default. Alpamayo.")] = None,
    processes: Annotated[int | None, typer.Option(min=1, help="Processes of the toy, 1 by default.")] = None,
    head: Annotated[str | None, typer.Option(metavar="HOST[:PORT]", help="Where several machines meet.")] = None,
    gpu_memory: Annotated[float | None, typer.Option(help="GiB of each card, for preflight.")] = None,
    slurm: Annotated[bool, typer.Option("--slurm", help="Submit one batch file instead of running here.")] = False,
    slurm_option: Annotated[
        list[str], typer.Option(help="Further option of sbatch, such as --partition=h100; several times.")
    ] = [],  # noqa: B006
    lora: Annotated[bool, typer.Option("--lora", help="Adapters in Stage 1, where the recipe has them.")] = False,
    most_saturated: Annotated[
        float | None,
        typer.Option(min=0.0, max=1.0, help="Share of saturated trajectory tokens beyond which nothing runs; 0.01."),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Seed of a mixture that is composed here, and of both stages of the toy; by default 0, and what their "
            "YAML says.",
        ),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Look, print the commands, and write nothing.")] = False,
    allow_uncompared: AllowUncomparedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Train a policy on a mixture in two stages: the toy here, Alpamayo by its public recipe.

    Looks at everything first, and stops at faults that the recipe passes over in silence. What is finished is kept.
    """
    from olt_generator.errors import InputError
    from olt_toolkit.recordings.recording import refuse_unused

    of_alpamayo = {
        "--pai": pai is not None,
        "--chunks": chunks is not None,
        "--validation": validation is not None,
        "--validation-chunks": validation_chunks is not None,
        "--stage1-checkpoint": stage1_checkpoint is not None,
        "--base": base is not None,
        "--recipes": recipes is not None,
        "--python": python is not None,
        "--vlm": vlm is not None,
        "--nodes": nodes is not None,
        "--gpus": gpus is not None,
        "--head": head is not None,
        "--gpu-memory": gpu_memory is not None,
        "--slurm": slurm,
        "--slurm-option": bool(slurm_option),
        "--lora": lora,
        "--most-saturated": most_saturated is not None,
    }
    if policy is PolicyName.TOY:
        from olt_sft_recipes.launch.toy import HELD_OUT_SCENES

        refuse_unused(of_alpamayo, "it is of the public recipes; the toy is trained here")
        chosen = choose_mixture(mixture, recipe, stores, seed, allow_uncompared, HELD_OUT_SCENES)
        _launch_toy(chosen, out, stage, processes or 1, seed, stores, (stage1, stage2), dry_run, as_json)
        return
    from olt_sft_recipes.launch.alpamayo import MOST_SATURATED, LaunchRequest
    from olt_sft_recipes.launch.plan import Places
    from olt_sft_recipes.launch.public_recipes import find_public_recipe
    from olt_sft_recipes.launch.torchrun import Machines

    refuse_unused({"--processes": processes is not None}, "it is of the toy; give --nodes and --gpus")
    find_public_recipe(policy.value)
    if base is None or recipes is None:
        raise InputError(f"{policy.value}: give --base (the released checkpoint) and --recipes (a clone of them)")
    refuse_unused({"--stage1-checkpoint": stage1_checkpoint is not None and stage.value != "2"}, "it is for --stage 2")
    refuse_unused(
        {"--seed": seed is not None and recipe is None}, "it is for --recipe; those of training are the recipe's"
    )
    refuse_unused({"--slurm-option": bool(slurm_option) and not slurm}, "it is for --slurm")
    refuse_unused({"--chunks": chunks is not None and pai is None}, "it selects chunks of --pai")
    refuse_unused({"--validation-chunks": bool(validation_chunks and not validation)}, "it is for --validation")
    refuse_unused(
        {"--head": head is not None and (slurm or not nodes or nodes == 1)}, "machines meet there without --slurm"
    )
    interpreter = python or _find_python(recipes, policy.value)
    places = Places(out.resolve(), recipes.resolve(), base.resolve(), interpreter.absolute(), vlm and vlm.resolve())
    request = LaunchRequest(
        policy.value,
        places,
        Machines(nodes or 1, gpus or 8, head),
        None if pai is not None else choose_mixture(mixture, recipe, stores, seed, allow_uncompared),
        pai and pai.resolve(),
        chunks,
        validation and validation.resolve(),
        validation_chunks,
        stage.value,
        (stage1, stage2),
        stage1_checkpoint and stage1_checkpoint.resolve(),
        lora,
        MOST_SATURATED if most_saturated is None else most_saturated,
        gpu_memory,
        tuple(slurm_option) if slurm else None,
    )
    _launch_alpamayo(request, dry_run, as_json)


def _launch_toy(
    mixture: "Mixture",
    out: Path,
    stage: StageChoice,
    processes: int,
    seed: int | None,
    stores: list[Path],
    stage_files: tuple[Path | None, Path | None],
    dry_run: bool,
    as_json: bool,
) -> None:
    from olt_sft_recipes.launch.toy import describe_toy, launch_toy
    from olt_toolkit.runtime.console import print_json, print_line, show_progress
    from olt_toolkit.runtime.threads import use_one_thread

    use_one_thread()
    with show_progress("training") as (progress, _):
        result = launch_toy(
            mixture,
            out,
            stage=stage.value,
            processes=processes,
            seed=seed,
            stores=stores,
            stage1=stage_files[0],
            stage2=stage_files[1],
            dry_run=dry_run,
            on_progress=progress,
        )
    if as_json:
        print_json(result)
        return
    for line in describe_toy(result):
        print_line(line)


def _launch_alpamayo(request: "LaunchRequest", dry_run: bool, as_json: bool) -> None:
    from olt_sft_recipes.launch import alpamayo
    from olt_sft_recipes.preflight.table import print_report
    from olt_toolkit.runtime.console import print_json, print_line, show_progress
    from olt_toolkit.runtime.workers import default_workers

    with show_progress("looking at samples") as (progress, _):
        prepared = alpamayo.prepare_launch(request, progress)
    told: dict[str, Any] = prepared.to_dict() | {"dry_run": dry_run}
    if not as_json:
        _show(prepared)
    if not dry_run:
        alpamayo.refuse_saturated(prepared)
        alpamayo.refuse_before_export(prepared)
        alpamayo.write_launch(prepared)
        with show_progress("exporting") as (progress, _):
            alpamayo.export_data(prepared, default_workers(), progress)
    report = alpamayo.look_before(prepared)
    told |= {"preflight": report.to_dict()}
    if not as_json:
        print_report(report)
    if dry_run:
        if not as_json:
            print_line(told["batch"] or alpamayo.write_commands(prepared.plan))
    else:
        report.refuse()
        if request.slurm_options is not None:
            told |= {"submitted": alpamayo.submit(prepared.plan)}
        else:
            told |= {"results": _run(prepared)}
        if not as_json:
            _show_end(told)
    if as_json:
        print_json(told)


def _run(prepared: "PreparedLaunch") -> dict[str, Any]:
    from olt_generator.progress import Progress
    from olt_sft_recipes.launch.alpamayo import run_launch
    from olt_toolkit.runtime.console import make_progress

    with make_progress() as bar:

        def show(step: str) -> Progress:
            task = bar.add_task(step, total=100)
            return lambda share: bar.update(task, completed=round(100 * share))

        return run_launch(prepared, show)


def _show(prepared: "PreparedLaunch") -> None:
    from olt_toolkit.runtime.console import print_line, print_table

    plan = prepared.plan
    data = plan.train
    print_line(f"{plan.recipe.policy} on {data.clips} clips, chunks {data.chunk_ids} (END left out) of {data.folder}")
    for note in data.notes:
        print_line(f"note: {note}")
    counted = prepared.saturation
    if counted is None:
        print_line("saturated trajectory tokens: not counted because the folder has no clip table and sample times")
    else:
        print_line(
            f"saturated trajectory tokens: {counted.tokens} of {counted.samples} samples' ({counted.share:.3%}), "
            f"in {counted.samples_touched} samples"
            + (f", first in clip {counted.first_clip}" if counted.first_clip else "")
        )
    steps = [
        (each.stage, *(each.arithmetic[key] for key in ("samples", "global_batch", "steps_per_epoch", "total_steps")))
        for each in plan.stages
    ]
    print_table("Steps", ("stage", "samples", "samples a step", "steps an epoch", "steps"), steps)
    modules = [
        (each.stage, module.module, f"{module.parameters:,}", f"{module.trained:,}")
        for each in plan.stages
        for module in each.modules
    ]
    for each in plan.stages:
        total = sum(module.trained for module in each.modules)
        modules.append((each.stage, "all", f"{sum(m.parameters for m in each.modules):,}", f"{total:,}"))
    print_table("What is trained", ("stage", "module", "parameters", "trained"), modules)
    for each in plan.stages:
        show_differences(each.stage, each.differences)


def show_differences(stage: int, differences: Any) -> None:
    """Print a table of what a launch sets otherwise than the shipped recipe."""
    from olt_toolkit.runtime.console import print_table

    rows = [(each.key, each.shipped or "not in the table", each.launched, each.reason) for each in differences]
    print_table(f"Stage {stage}: otherwise than shipped", ("key", "shipped", "launched", "why"), rows)


def _show_end(told: dict[str, Any]) -> None:
    from olt_toolkit.runtime.console import print_line

    if "submitted" in told:
        print_line(told["submitted"])
        return
    for name, result in told["results"].items():
        if name == "evaluation":
            print_line(", ".join(f"{metric} {value:g}" for metric, value in result.items()))
        else:
            kept = " (kept from an earlier launch)" if result["kept"] else ""
            print_line(f"{name}: {result['checkpoint']}{kept}; {result['checked']}")
    for line in told["handoff"]:
        print_line(line)


def follow(
    out: Annotated[Path, typer.Argument(help="Folder of a launch.")],
    stage: Annotated[int, typer.Option(min=1, max=2, help="The stage whose log is on standard input.")],
    kept: Annotated[
        bool, typer.Option("--kept", help="Read no log: look whether what an earlier launch finished still fits.")
    ] = False,
) -> None:
    """Read the log of a stage, show how far it is, and stop at a silent failure; batch files pipe through this."""
    import sys

    from olt_generator.errors import InputError
    from olt_sft_recipes.launch.following import follow as follow_stage
    from olt_sft_recipes.launch.following import followed_of_launch, keep
    from olt_toolkit.runtime.console import print_line, show_progress

    followed = followed_of_launch(out.resolve(), 1 if stage == 1 else 2)
    if kept:
        if (result := keep(followed)) is None:
            raise InputError(f"{followed.folder}: Stage {stage} is not finished; leave --kept out, and pipe in its log")
        print_line(f"Stage {stage} is finished and kept: {result['checkpoint']}")
        return
    with show_progress(f"Stage {stage}") as (progress, _):
        result = follow_stage(followed, sys.stdin, progress)
    print_line(f"Stage {stage}: {result['checkpoint']}; {result['checked']}")


def handoff(
    checkpoint: Annotated[Path, typer.Argument(help="Last checkpoint of Stage 2 of Alpamayo 1.5.")],
    as_json: JsonOption = False,
) -> None:
    """Print the commands by which AlpaSim's own driver drives with a trained Alpamayo 1.5."""
    from olt_sft_recipes.launch.handoff import check_handoff
    from olt_toolkit.runtime.console import print_json, print_line

    lines = check_handoff(checkpoint)
    if as_json:
        print_json({"checkpoint": str(checkpoint), "commands": lines})
        return
    print_line("# in a clone of NVlabs/alpasim of August 2026 or later; its driver must see the folder")
    for line in lines:
        print_line(line)


def differences(
    policy: Annotated[PolicyName, typer.Argument(help="A policy with a public recipe.")], as_json: JsonOption = False
) -> None:
    """Print what the built-in stages set otherwise than the shipped recipe, and why."""
    from dataclasses import asdict

    from olt_sft_recipes.launch.public_recipes import find_public_recipe
    from olt_sft_recipes.launch.stage_settings import builtin_stage_settings, find_differences
    from olt_toolkit.runtime.console import print_json

    name = find_public_recipe(policy.value).policy
    found = {s: find_differences(name, s, builtin_stage_settings(name, s).values) for s in (1, 2)}
    if as_json:
        print_json({"policy": name} | {f"stage{stage}": [asdict(each) for each in of] for stage, of in found.items()})
        return
    for stage, of in found.items():
        show_differences(stage, of)


def _find_python(recipes: Path, policy: str) -> Path:
    """The interpreter of the environment that the recipe's README makes in its folder."""
    from olt_generator.errors import InputError
    from olt_sft_recipes.launch.public_recipes import find_public_recipe

    folder = recipes / "recipes" / find_public_recipe(policy).package
    found = sorted(folder.glob("*/bin/torchrun")) + sorted(folder.glob(".venv/bin/torchrun"))
    if len({path.resolve() for path in found}) != 1:
        raise InputError(f"{folder}: has {len(found)} environments with torchrun; give --python of the recipe's")
    return found[0].with_name("python")
