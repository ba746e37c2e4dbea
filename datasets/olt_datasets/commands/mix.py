"""`olt mix`: compose training mixtures from clip tables by recipes."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from olt_datasets.commands.align import align
from olt_datasets.mixtures.training_arithmetic import PAPER_STAGES, parse_stage, training_arithmetic
from olt_toolkit.commands.clip_options import JsonOption

app = typer.Typer(add_completion=False, no_args_is_help=True, help="Compose training mixtures from clips by recipes.")
app.command()(align)

RecipeArgument = Annotated[str, typer.Argument(metavar="RECIPE", help="A YAML file or the name of a built-in recipe.")]
StoresOption = Annotated[
    list[Path], typer.Option("--stores", help="Clip store, or table of indexed clips; repeat for more than one.")
]
SeedOption = Annotated[int, typer.Option(help="Seed of the choice and order of samples.")]
StageOption = Annotated[
    list[str],
    typer.Option("--stage", help="DEVICESxBATCHxACCUMULATIONxEPOCHS to count steps for; repeat for more than one."),
]
BOTH_STAGES = [str(stage) for stage in PAPER_STAGES]


@app.command()
def compose(
    recipe: RecipeArgument,
    stores: StoresOption,
    seed: SeedOption = 0,
    out: Annotated[Path | None, typer.Option(help="Where to write the mixture (.json or .parquet).")] = None,
    picture: Annotated[Path | None, typer.Option(help="Where to draw its shares (.png).")] = None,
    stage: StageOption = BOTH_STAGES,
    as_json: JsonOption = False,
) -> None:
    """Choose the samples of a mixture; show what was asked for and what was got, and the steps of training on it."""
    from olt_datasets.mixtures.mixture import compose_mixture
    from olt_datasets.mixtures.mixture_file import write_mixture
    from olt_datasets.mixtures.picture import draw_mixture
    from olt_datasets.mixtures.recipe import find_recipe
    from olt_datasets.tables.clip_frame import scan_clip_tables

    chosen = find_recipe(recipe)
    training = _training(stage)
    mixture = compose_mixture(chosen, scan_clip_tables(stores), seed)
    if out is not None:
        write_mixture(mixture, out)
    if picture is not None:
        draw_mixture(mixture, picture)
    files = {"file": None if out is None else str(out), "picture": None if picture is None else str(picture)}
    _show_mixture(mixture.describe() | {"training": training(len(mixture))} | files, as_json)


@app.command()
def show(
    mixture: Annotated[str, typer.Argument(metavar="MIXTURE|RECIPE", help="A composed mixture, or a recipe.")],
    epoch: Annotated[int, typer.Option(min=0, help="Epoch of a curriculum.")] = 0,
    stage: StageOption = BOTH_STAGES,
    as_json: JsonOption = False,
) -> None:
    """Show a composed mixture, or what a recipe asks for."""
    from olt_datasets.mixtures.mixture_file import MIXTURE_SUFFIXES, read_mixture
    from olt_datasets.mixtures.recipe import Component, find_recipe
    from olt_toolkit.runtime.console import print_json, print_table

    if mixture.endswith(MIXTURE_SUFFIXES):
        training = _training(stage)
        composed = read_mixture(Path(mixture))
        _show_mixture(composed.describe(epoch) | {"training": training(len(composed)), "file": mixture}, as_json)
        return
    recipe = find_recipe(mixture)
    if as_json:
        print_json(recipe.model_dump(mode="json"))
        return
    columns = list(Component.model_fields)
    rows = [[_cell(getattr(part, column) or None) for column in columns] for part in recipe.components]
    print_table(f"{recipe.name}, split {recipe.split}: {recipe.description}", columns, rows)


@app.command()
def check(recipe: RecipeArgument, stores: StoresOption, as_json: JsonOption = False) -> None:
    """List everything that keeps a recipe from being composed: shortages and leaks. Exit status 1 if there is any."""
    from olt_datasets.mixtures.mixture import check_recipe
    from olt_datasets.mixtures.recipe import find_recipe
    from olt_datasets.mixtures.selection import word_shortage
    from olt_datasets.tables.clip_frame import scan_clip_tables
    from olt_toolkit.runtime.console import print_json, print_line

    findings = check_recipe(find_recipe(recipe), scan_clip_tables(stores))
    refused = bool(findings["shortages"] or findings["leaks"])
    if as_json:
        records = {
            "shortages": [asdict(shortage) for shortage in findings["shortages"]],
            "leaks": [asdict(leak) for leak in findings["leaks"]],
            "absent": [value._asdict() for value in findings["absent"]],
        }
        print_json({"recipe": recipe, "accepted": not refused, **records})
    else:
        print_line(f"{recipe}: {'refused' if refused else 'accepted'}")
        for shortage in findings["shortages"]:
            print_line(f"  shortages: {word_shortage(shortage)}")
        for leak in findings["leaks"]:
            print_line(f"  leaks: {leak}")
        for component, field, value in findings["absent"]:
            print_line(f"  absent: component {component!r}: where.{field}: no clip has {value!r}")
    if refused:
        raise typer.Exit(1)


@app.command()
def diff(
    first: Annotated[Path, typer.Argument(help="A composed mixture.")],
    second: Annotated[Path, typer.Argument(help="Another one.")],
    out: Annotated[Path | None, typer.Option(help="Where to write the samples of only one of them (.parquet).")] = None,
    as_json: JsonOption = False,
) -> None:
    """Show what differs between two composed mixtures: their recipes, samples and shares."""
    from olt_datasets.mixtures.comparison import compare_mixtures, differing_samples
    from olt_datasets.mixtures.mixture import GROUPS
    from olt_datasets.mixtures.mixture_file import read_mixture
    from olt_generator.files import write_whole
    from olt_toolkit.runtime.console import print_json, print_table

    mixtures = read_mixture(first), read_mixture(second)
    if out is not None:
        with write_whole(out) as temporary:
            differing_samples(*mixtures).write_parquet(temporary)
    summary = compare_mixtures(*mixtures)
    if as_json:
        print_json(summary | {"file": None if out is None else str(out)})
        return
    facts = {name: summary[name] for name in ("seeds", "samples_per_epoch")} | summary["recipe"]
    rows = [(name, _cell(before), _cell(after)) for name, (before, after) in facts.items() if before != after]
    heads = [f"{place}: {name}" for place, name in zip(("first", "second"), summary["recipes"], strict=True)]
    print_table("What was asked", ("", *heads), rows)
    samples = {"all": summary["samples"]} | summary["components"]
    columns = ("both", "only_first", "only_second")
    rows = [(name, *(numbers[column] for column in columns)) for name, numbers in samples.items()]
    print_table("Distinct samples", ("component", "in both", "first only", "second only"), rows)
    rows = [
        (group, value, f"{before:.2%}", f"{after:.2%}", f"{after - before:+.2%}")
        for group in GROUPS
        for value, (before, after) in summary[f"by_{group}"].items()
        if before != after
    ]
    print_table("Shares that differ", ("by", "value", "first", "second", "difference"), rows)


def _training(stages: Sequence[str]) -> Any:
    """A function that gives the arithmetic of each stage for a number of samples; texts are checked at once."""
    parsed = [parse_stage(text) for text in stages]
    return lambda samples: {str(stage): training_arithmetic(samples, stage) for stage in parsed}


def _show_mixture(summary: dict[str, Any], as_json: bool) -> None:
    from olt_datasets.mixtures.mixture import GROUPS
    from olt_toolkit.runtime.console import print_json, print_table

    if as_json:
        print_json(summary)
        return
    items = summary["samples_per_epoch"]
    columns = ("name", "share", "asked", "got", "distinct", "available", "repeats")
    title = f"{summary['recipe']}: {items} samples per epoch, epoch {summary['epoch']}, seed {summary['seed']}"
    parts = [part | {"asked": f"{part['asked']:.12g}"} for part in summary["components"]]
    print_table(title, columns, [[_cell(part[column]) for column in columns] for part in parts])
    if len(summary["items_by_epoch"]) > 1:
        names = [part["name"] for part in parts]
        print_table("Curriculum", ("epoch", *names), [(each, *row) for each, row in summary["items_by_epoch"].items()])
    rows = [
        (group, value, numbers["got"], f"{numbers['got'] / items:.2%}", numbers["distinct"])
        for group in GROUPS
        for value, numbers in summary[f"by_{group}"].items()
    ]
    print_table("What is in it", ("by", "value", "got", "share", "distinct"), rows)
    columns = ("global_batch", "samples_per_epoch", "padded_samples", "steps_per_epoch", "total_steps")
    rows = [(stage, *(numbers[column] for column in columns)) for stage, numbers in summary["training"].items()]
    heads = ("devices x batch x accumulation x epochs", *(column.replace("_", " ") for column in columns))
    print_table("Steps of training", heads, rows)


def _cell(value: object) -> object:
    # A field that a recipe leaves open is not a number that nobody measured.
    return "-" if value is None else str(value) if isinstance(value, dict | list) else value
