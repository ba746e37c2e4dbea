"""`olt sft`: two-stage training of policies, and their open-loop errors."""

from pathlib import Path
from typing import Annotated

import typer

from olt_datasets.commands.comparing import AllowUncomparedOption
from olt_sft_recipes.commands import launch as launching
from olt_sft_recipes.commands.mixtures import choose_mixture
from olt_sft_recipes.commands.preflight import preflight
from olt_toolkit.rigs.names import ContractName

app = typer.Typer(add_completion=False, no_args_is_help=True, help="Train policies, and judge them in open loop.")
for _command in (preflight, launching.launch, launching.follow, launching.handoff, launching.differences):
    app.command()(_command)

Stores = Annotated[list[Path], typer.Option(help="Clip store; may be given several times.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


@app.command(help="Train both stages on a mixture; a stage that this code finished with equal settings is kept.")
def train(
    out: Annotated[Path, typer.Option(help="Folder of the training; OUT/policy is what drives.")],
    mixture: Annotated[Path | None, typer.Option(help="A mixture that `olt mix compose` wrote.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Instead of it: a recipe, composed here from --stores.")] = None,
    stores: Stores = [],  # noqa: B006 - typer reads the default, nobody changes it
    stage1: Annotated[Path | None, typer.Option(help="YAML of Stage 1; that of the toy by default.")] = None,
    stage2: Annotated[Path | None, typer.Option(help="YAML of Stage 2; that of the toy by default.")] = None,
    rig: Annotated[ContractName, typer.Option(help="Whose cameras the policy takes.")] = ContractName.ALPAMAYO_R1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the mixture and of both stages.")] = 0,
    allow_uncompared: AllowUncomparedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Train, and print the losses."""
    from olt_sft_recipes.toy.config import ToyPolicyConfig
    from olt_sft_recipes.training.stage_config import builtin_stage_config, read_stage_config
    from olt_sft_recipes.training.two_stages import train_on_mixture
    from olt_toolkit.runtime.console import make_progress, print_json, print_line, print_table
    from olt_toolkit.runtime.threads import use_one_thread

    use_one_thread()
    chosen = choose_mixture(mixture, recipe, stores, seed, allow_uncompared)
    stages = (
        read_stage_config(stage1) if stage1 else builtin_stage_config(1),
        read_stage_config(stage2) if stage2 else builtin_stage_config(2),
    )
    with make_progress() as progress:
        task = progress.add_task("training", total=100)
        results = train_on_mixture(
            chosen,
            stages,
            seed,
            out,
            lambda share: progress.update(task, completed=round(100 * share)),
            ToyPolicyConfig(rig=rig.value),
        )
    if as_json:
        print_json({"policy": str(out / "policy"), "stages": [vars(result) for result in results]})
        return
    rows = [(result.stage, result.steps, result.samples, result.losses[0], result.final_loss) for result in results]
    print_table("Two-stage training", ("stage", "steps", "samples", "first loss", "last loss"), rows)
    print_line(f"policy: {out / 'policy'}")


@app.command(help="Open-loop errors of a policy on the samples of a clip store's validation split.")
def evaluate(
    policy: Annotated[str, typer.Option(help="NAME or NAME:PATH, for example toy:OUT/policy.")],
    stores: Stores,
    split: Annotated[str, typer.Option(help="Split whose clips are used.")] = "val",
    samples: Annotated[int, typer.Option(min=1, help="Samples a clip, spread over it.")] = 6,
    plans: Annotated[int, typer.Option(min=1, help="Plans drawn for each sample.")] = 6,
    as_json: JsonOption = False,
) -> None:
    """Print displacement errors."""
    from olt_closed_loop import make_policy
    from olt_generator.errors import InputError
    from olt_sft_recipes.open_loop import evaluate_open_loop, spread_keys
    from olt_toolkit import ClipStore
    from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract
    from olt_toolkit.runtime.console import print_json, print_table

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
    errors = evaluate_open_loop(chosen, loaded, plans)
    if as_json:
        print_json({"policy": policy, "samples": len(loaded), "plans_per_sample": plans, "errors_m": errors})
    else:
        print_table(f"{policy}: {len(loaded)} samples of split {split}", ("error", "m"), list(errors.items()))
