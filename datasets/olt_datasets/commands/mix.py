"""`olt mix`: compose training mixtures from clip stores by recipes."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from olt_datasets.recipe import Recipe

app = typer.Typer(add_completion=False, no_args_is_help=True, help="Compose training mixtures from clips by recipes.")

RecipeArgument = Annotated[str, typer.Argument(metavar="RECIPE", help="A YAML file or the name of a built-in recipe.")]
StoresOption = Annotated[list[Path], typer.Option("--stores", help="Folder of a clip store; repeat for more than one.")]
SeedOption = Annotated[int, typer.Option(help="Seed of the choice and order of samples.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


@app.command()
def compose(
    recipe: RecipeArgument,
    stores: StoresOption,
    seed: SeedOption = 0,
    out: Annotated[Path | None, typer.Option(help="Where to write the mixture (.json).")] = None,
    as_json: JsonOption = False,
) -> None:
    """Choose the samples of a mixture; show what was asked for and what was got."""
    from olt_datasets.clip_table import read_clip_tables
    from olt_datasets.mixture import compose_mixture
    from olt_datasets.plan import write_plan
    from olt_datasets.recipe import find_recipe

    mixture = compose_mixture(find_recipe(recipe), read_clip_tables(stores), seed)
    if out is not None:
        write_plan(mixture, out)
    _show_mixture(mixture.describe() | {"file": None if out is None else str(out)}, as_json)


@app.command()
def show(
    mixture: Annotated[str, typer.Argument(metavar="MIXTURE|RECIPE", help="A composed mixture (.json) or a recipe.")],
    as_json: JsonOption = False,
) -> None:
    """Show a composed mixture, or what a recipe asks for."""
    from olt_datasets.plan import PLAN_SUFFIX, read_plan
    from olt_datasets.recipe import find_recipe

    if mixture.endswith(PLAN_SUFFIX):
        _show_mixture(read_plan(Path(mixture)).describe() | {"file": mixture}, as_json)
    else:
        _show_recipe(find_recipe(mixture), as_json)


@app.command()
def check(recipe: RecipeArgument, stores: StoresOption, as_json: JsonOption = False) -> None:
    """List everything that keeps a recipe from being composed: shortages and leaks. Exit status 1 if there is any."""
    from olt_datasets.clip_table import read_clip_tables
    from olt_datasets.mixture import check_recipe
    from olt_datasets.recipe import find_recipe
    from olt_toolkit.console import print_json, print_line

    findings = check_recipe(find_recipe(recipe), read_clip_tables(stores))
    refused = bool(findings["shortages"] or findings["leaks"])
    if as_json:
        print_json({"recipe": recipe, "accepted": not refused, **findings})
    else:
        print_line(f"{recipe}: {'refused' if refused else 'accepted'}")
        for topic, lines in findings.items():
            for line in lines:
                print_line(f"  {topic}: {line}")
    if refused:
        raise typer.Exit(1)


def _show_mixture(summary: dict[str, Any], as_json: bool) -> None:
    from olt_datasets.mixture import GROUPS
    from olt_toolkit.console import print_json, print_table

    if as_json:
        print_json(summary)
        return
    columns = ("name", "share", "asked", "got", "distinct", "available", "repeats")
    title = f"{summary['recipe']}: {summary['samples_per_epoch']} samples per epoch, seed {summary['seed']}"
    parts = [part | {"asked": f"{part['asked']:.12g}"} for part in summary["components"]]
    print_table(title, columns, [[_cell(part[column]) for column in columns] for part in parts])
    rows = [
        (group, value, numbers["got"], numbers["distinct"])
        for group in GROUPS
        for value, numbers in summary[f"by_{group}"].items()
    ]
    print_table("What is in it", ("by", "value", "got", "distinct"), rows)


def _show_recipe(recipe: "Recipe", as_json: bool) -> None:
    from olt_toolkit.console import print_json, print_table

    if as_json:
        print_json(recipe.model_dump(mode="json"))
        return
    rows = [
        (part.name, str(part.where), _cell(part.share), _cell(part.count), part.repeats, _cell(part.prefer))
        for part in recipe.components
    ]
    title = f"{recipe.name}, split {recipe.split}: {recipe.description}"
    print_table(title, ("component", "where", "share", "count", "repeats", "prefer"), rows)


def _cell(value: object) -> object:
    # A field that a recipe leaves open is not a number that nobody measured.
    return "-" if value is None else value
