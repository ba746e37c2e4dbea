"""`olt sft`: two-stage training of policies, and their open-loop errors."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from olt_datasets.commands.comparing import AllowUncomparedOption
from olt_generator.progress import silent
from olt_sft_recipes.commands import launch as launching
from olt_sft_recipes.commands.mixtures import choose_mixture
from olt_sft_recipes.commands.preflight import preflight
from olt_toolkit.rigs.names import ContractName

app = typer.Typer(add_completion=False, no_args_is_help=True, help="Train policies, and judge them in open loop.")
for _command in (preflight, launching.launch, launching.follow, launching.handoff, launching.differences):
    app.command()(_command)

Stores = Annotated[list[Path], typer.Option(help="Clip store; may be given several times.")]


class StageName(StrEnum):
    """Which stage is trained."""

    FIRST = "1"
    SECOND = "2"
    BOTH = "both"


class TrackerName(StrEnum):
    """Who is told of losses and errors while they come."""

    NONE = "none"
    TENSORBOARD = "tensorboard"
    WANDB = "wandb"


JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


@app.command(help="Train on a mixture; the same command goes on exactly with what was interrupted.")
def train(
    out: Annotated[Path, typer.Option(help="Folder of the training; OUT/policy is what drives.")],
    mixture: Annotated[Path | None, typer.Option(help="A mixture that `olt mix compose` wrote.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Instead of it: a recipe, composed here from --stores.")] = None,
    stores: Stores = [],  # noqa: B006 - typer reads the default, nobody changes it
    stage1: Annotated[Path | None, typer.Option(help="YAML of Stage 1; that of the toy by default.")] = None,
    stage2: Annotated[Path | None, typer.Option(help="YAML of Stage 2; that of the toy by default.")] = None,
    rig: Annotated[ContractName, typer.Option(help="Whose cameras the policy takes.")] = ContractName.ALPAMAYO_R1,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Seed of both stages, and of a mixture that is composed here; by default what their YAML says, and 0.",
        ),
    ] = None,
    stage: Annotated[StageName, typer.Option(help="Which stage; 2 goes on from the finished Stage 1 in OUT.")] = (
        StageName.BOTH
    ),
    judge_on: Annotated[
        list[Path], typer.Option(help="Clip store whose split val judges the stages while they train; several times.")
    ] = [],  # noqa: B006 - typer reads the default, nobody changes it
    judge_scene: Annotated[
        list[str], typer.Option(help="Scene that Stage 2 drives at each evaluation; the best goes on. Several times.")
    ] = [],  # noqa: B006 - typer reads the default, nobody changes it
    report_to: Annotated[TrackerName, typer.Option(help="Who is told of losses and errors.")] = TrackerName.NONE,
    allow_uncompared: AllowUncomparedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Train, and print the losses."""
    from olt_generator.errors import InputError
    from olt_sft_recipes.launch.toy import describe_evaluation, read_stages, validation_of
    from olt_sft_recipes.toy.config import ToyPolicyConfig
    from olt_sft_recipes.training.processes import check_tracker, is_main_process
    from olt_sft_recipes.training.two_stages import train_on_mixture
    from olt_toolkit.recordings.recording import refuse_unused
    from olt_toolkit.runtime.console import print_json, print_line, print_table, show_progress
    from olt_toolkit.runtime.threads import use_one_thread

    use_one_thread()
    check_tracker(report_to.value)
    refuse_unused({"--stores": bool(stores and mixture)}, "a mixture names its stores; --judge-on takes others")
    chosen = choose_mixture(mixture, recipe, stores, seed, allow_uncompared)
    stages, config = read_stages(stage1, stage2, report_to.value), ToyPolicyConfig(rig=rig.value)
    validation = validation_of(judge_on, config.contract, judge_scene)
    if judge_on and not validation.samples:
        raise InputError(
            f"--judge-on {', '.join(map(str, judge_on))}: no clip of split val gives a sample to judge by; give a "
            "store that has some, or leave it out"
        )
    with show_progress("training") as (on_progress, _):
        results = train_on_mixture(
            chosen,
            stages,
            seed,
            out,
            on_progress if is_main_process() else silent,
            config,
            validation,
            stage.value,
        )
    if not is_main_process():
        return
    policy = out / "policy" if stage is not StageName.FIRST else None
    if as_json:
        print_json({"policy": policy and str(policy), "stages": [vars(result) for result in results]})
        return
    columns = ("stage", "steps", "samples", "first loss", "last loss", "goes on", "seconds", "of them waiting for data")
    rows = [
        (
            *(result.stage, result.steps, result.samples, result.losses[0], result.final_loss, result.checkpoint),
            *(result.seconds, result.seconds_of.get("waiting for data", 0.0)),
        )
        for result in results
    ]
    print_table("Two-stage training", columns, rows)
    for result in results:
        for evaluation in result.evaluations:
            print_line(f"stage {result.stage}, {describe_evaluation(evaluation)}")
    if policy:
        print_line(f"policy: {policy}")


@app.command(help="How far a training is, how good, and whether it still runs.")
def status(
    folder: Annotated[Path, typer.Argument(help="The --out of a training, or the folder of one stage.")],
    as_json: JsonOption = False,
) -> None:
    """Print the status of each stage that was begun."""
    from olt_sft_recipes.launch.toy import describe_evaluation
    from olt_sft_recipes.training.status import read_statuses
    from olt_toolkit.runtime.console import print_json, print_line, print_table

    statuses = read_statuses(folder)
    if as_json:
        print_json({"stages": [{**vars(stage), "alive": stage.is_alive()} for stage in statuses]})
        return
    rows = [
        (
            *(stage.stage, f"{stage.step} of {stage.steps}", stage.loss, _words(stage.seconds_left)),
            *(None if stage.waiting_share is None else f"{stage.waiting_share:.0%}", stage.describe()),
        )
        for stage in statuses
    ]
    print_table(f"{folder}", ("stage", "step", "loss", "time left", "waiting for data", "state"), rows)
    for stage in statuses:
        if stage.best:
            print_line(f"stage {stage.stage}, best: {describe_evaluation(stage.best)}")


def _words(seconds: float | None) -> str | None:
    return None if seconds is None else f"{int(seconds) // 60} min {int(seconds) % 60} s"


@app.command(help="Open-loop errors of a policy on the samples of a clip store's validation split.")
def evaluate(
    policy: Annotated[str, typer.Option(help="NAME or NAME:PATH, for example toy:OUT/policy.")],
    stores: Stores,
    split: Annotated[str, typer.Option(help="Split whose clips are used.")] = "val",
    samples: Annotated[int, typer.Option(min=1, help="Samples a clip, spread over it.")] = 6,
    plans: Annotated[int, typer.Option(min=1, help="Plans drawn for each sample.")] = 6,
    withhold: Annotated[
        bool, typer.Option("--withhold", help="Also without each camera, earlier frames and the route in turn.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Print displacement errors."""
    from olt_closed_loop import make_policy
    from olt_generator.errors import InputError
    from olt_sft_recipes.open_loop import mean_errors, measure_open_loop, spread_keys
    from olt_sft_recipes.withheld_inputs import measure_withheld
    from olt_toolkit import ClipStore
    from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract
    from olt_toolkit.runtime.console import print_json, print_table, word_interval

    chosen = make_policy(policy)
    opened = [ClipStore(store) for store in stores]
    # A policy without cameras is shown those of the usual contract, and does not look.
    contract = CameraContract(policy, chosen.cameras) if chosen.cameras else DEFAULT_CONTRACT
    keys = {store: spread_keys(store, split, samples) for store in opened}
    loaded = [sample for store in opened for sample in store.load_samples(keys[store], contract=contract)]
    if not loaded:
        raise InputError(
            f"{', '.join(map(str, stores))}: no clip of split {split!r} gives a sample; choose another split"
        )
    measured = measure_open_loop(chosen, loaded, plans)
    errors = mean_errors(measured)
    withheld = measure_withheld(chosen, loaded, measured, plans) if withhold else ()
    if as_json:
        found = {"policy": policy, "samples": len(loaded), "plans_per_sample": plans, "errors_m": errors}
        print_json(found | ({"withheld": [vars(each) for each in withheld]} if withhold else {}))
        return
    print_table(f"{policy}: {len(loaded)} samples of split {split}", ("error", "m"), list(errors.items()))
    if withhold:
        rows = [(each.name, each.min_ade, each.increase, word_interval(each.increase_interval)) for each in withheld]
        print_table("min_ade without an input, as it was trained", ("withheld", "m", "more", "95 %"), rows)
