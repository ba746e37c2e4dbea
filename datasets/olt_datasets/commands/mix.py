"""`olt mix`: compose training mixtures from clip tables by recipes."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from olt_datasets.commands.comparing import AllowUncomparedOption
from olt_datasets.mixtures.training_arithmetic import PAPER_STAGES, parse_stage, training_arithmetic
from olt_toolkit.commands.clip_options import JsonOption

if TYPE_CHECKING:
    from olt_datasets.mixtures.selection import ClipTable
    from olt_datasets.mixtures.source_alignment import Gap, SourceAlignment

app = typer.Typer(add_completion=False, no_args_is_help=True, help="Compose training mixtures from clips by recipes.")

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
def align(
    tables: Annotated[
        list[Path] | None, typer.Argument(metavar="TABLE...", help="Clip stores, or tables of indexed clips.")
    ] = None,
    target: Annotated[
        str | None, typer.Option(help="Filter of the target slice, as in recipes: '{category: [cyclists]}'.")
    ] = None,
    target_split: Annotated[str, typer.Option(help="Split that the target slice is taken from.")] = "test",
    target_weights: Annotated[
        str | None, typer.Option(help="Instead of a slice, the target by hand: FACTOR=WEIGHT,FACTOR=WEIGHT.")
    ] = None,
    where: Annotated[str, typer.Option(help="Filter of the clips that sources may give.")] = "{}",
    split: Annotated[str, typer.Option(help="Split that sources may give clips from.")] = "train",
    by: Annotated[str, typer.Option(help="What is compared: factors, category or country.")] = "factors",
    samples: Annotated[int | None, typer.Option(min=1, help="Clips to be taken, none of them twice.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the intervals.")] = 0,
    example: Annotated[bool, typer.Option("--example", help="Show the paper's counts instead of tables.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Compare how sources cover a target slice, and propose shares of them that come closest to it.

    `olt mix align --example` shows what the paper found: Waymo E2E has none of NV's human-guided traffic control.
    """
    from olt_datasets.mixtures.source_alignment import PAPER_COVERAGE, align_sources, measure_coverage
    from olt_datasets.tables.clip_frame import scan_clip_tables
    from olt_generator.errors import InputError
    from olt_toolkit.recordings.recording import refuse_unused
    from olt_toolkit.runtime.console import print_json

    unused = {"--where": where != "{}", "--split": split != "train", "--by": by != "factors"}
    unused |= {"TABLE": bool(tables), "--target": target is not None, "--target-weights": target_weights is not None}
    refuse_unused(unused if example else {}, "--example shows the paper's counts")
    if target is None:
        refuse_unused({"--target-split": target_split != "test"}, "only --target is taken from a split")
    if example:
        found = align_sources(PAPER_COVERAGE, PAPER_COVERAGE["nv"], samples=samples, seed=seed)
    else:
        if not tables or (target is None) == (target_weights is None):
            raise InputError("olt mix align: give TABLE and one of --target and --target-weights, or --example")
        if by not in ("factors", "category", "country"):
            raise InputError(f"--by is {by!r}; it must be factors, category or country")
        clips = scan_clip_tables(tables)
        coverage = measure_coverage(_slice(clips, split, where, "--where"), by)
        if target is not None:
            slices = measure_coverage(_slice(clips, target_split, target, "--target"), by)
            pooled = dict(sum(map(Counter, slices.values()), Counter()))
            found = align_sources(coverage, pooled, target_is_sample=True, samples=samples, seed=seed)
        else:
            found = align_sources(coverage, _read_weights(str(target_weights)), samples=samples, seed=seed)
    if as_json:
        print_json(asdict(found))
    else:
        _show_alignment(found)


@app.command()
def compose(
    recipe: RecipeArgument,
    stores: StoresOption,
    seed: SeedOption = 0,
    out: Annotated[Path | None, typer.Option(help="Where to write the mixture (.json or .parquet).")] = None,
    picture: Annotated[Path | None, typer.Option(help="Where to draw its shares (.png).")] = None,
    allow_uncompared: AllowUncomparedOption = False,
    stage: StageOption = BOTH_STAGES,
    as_json: JsonOption = False,
) -> None:
    """Choose the samples of a mixture; show what was asked for and what was got, and the steps of training on it.

    Refused if it leaks, or if clips that must not leak could not be compared with it.
    """
    from olt_datasets import find_recipe, scan_clip_tables, write_mixture
    from olt_datasets.mixtures.mixture import compose_and_check
    from olt_datasets.mixtures.picture import draw_mixture
    from olt_datasets.tables.leak_report import word_report
    from olt_toolkit.runtime.console import print_line

    chosen = find_recipe(recipe)
    training = _training(stage)
    mixture, leaks = compose_and_check(chosen, scan_clip_tables(stores), seed, allow_uncompared=allow_uncompared)
    if out is not None:
        write_mixture(mixture, out)
    if picture is not None:
        draw_mixture(mixture, picture)
    files = {"file": None if out is None else str(out), "picture": None if picture is None else str(picture)}
    summary = mixture.describe() | {"training": training(len(mixture))} | files
    _show_mixture(summary | ({"leak_check": leaks.to_dict()} if as_json else {}), as_json)
    if not as_json:
        for line in word_report(leaks, 0):
            print_line(line)


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
def check(
    recipe: RecipeArgument,
    stores: StoresOption,
    allow_uncompared: AllowUncomparedOption = False,
    as_json: JsonOption = False,
) -> None:
    """List everything that keeps a recipe from being composed, and what was compared to find leaks.

    Shortages, leaks, and clips that could not be compared. Exit status 1 if there is any.
    """
    from olt_datasets import check_recipe, find_recipe, scan_clip_tables
    from olt_datasets.mixtures.selection import word_shortage
    from olt_datasets.tables.leak_report import word_report
    from olt_toolkit.runtime.console import print_json, print_line

    findings = check_recipe(find_recipe(recipe), scan_clip_tables(stores))
    leaks = findings["leaks"]
    uncompared = bool(leaks.not_compared) and not allow_uncompared
    refused = bool(findings["shortages"] or leaks.leaks or uncompared)
    if as_json:
        records = {
            "shortages": [asdict(shortage) for shortage in findings["shortages"]],
            "leaks": leaks.to_dict()["leaks"],
            "leak_check": leaks.to_dict(),
            "absent": [value._asdict() for value in findings["absent"]],
        }
        print_json({"recipe": recipe, "accepted": not refused, **records})
    else:
        print_line(f"{recipe}: {'refused' if refused else 'accepted'}")
        for shortage in findings["shortages"]:
            print_line(f"  shortages: {word_shortage(shortage)}")
        for line in word_report(leaks, len(leaks.leaks)):
            print_line(f"  {line}")
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
        (name, *("not measured" if mean is None else f"{mean:.4g}" for mean in means))
        for name, means in summary["quality"].items()
        if means[0] != means[1]
    ]
    print_table("Means over items that differ", ("of", "first", "second"), rows)
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
    _show_quality(summary)
    columns = ("global_batch", "samples_per_epoch", "padded_samples", "steps_per_epoch", "total_steps")
    rows = [(stage, *(numbers[column] for column in columns)) for stage, numbers in summary["training"].items()]
    heads = ("devices x batch x accumulation x epochs", *(column.replace("_", " ") for column in columns))
    print_table("Steps of training", heads, rows)


def _show_quality(summary: dict[str, Any]) -> None:
    """Means over items of what was measured of their pixels and labels, and of how many items each is not known."""
    from olt_datasets.mixtures.quality import word_not_measured, word_quality
    from olt_toolkit.runtime.console import print_line, print_table

    parts = {part["name"]: part["quality"] for part in summary["components"]} | {"all": summary["quality"]}
    rows = [(name, *map(word_quality, quality, quality.values())) for name, quality in parts.items()]
    print_table("Pixels and labels of its items", ("component", *summary["quality"]), rows)
    for part in summary["components"]:
        if part["weights"] is not None:
            print_line(f"{part['name']}: weights chose {part['weights']}")
        if part["not_measured"]:
            print_line(f"{part['name']}: {word_not_measured(part['not_measured'], part['where'])}")


def _cell(value: object) -> object:
    # A field that a recipe leaves open is not a number that nobody measured.
    return "-" if value is None else str(value) if isinstance(value, dict | list) else value


def _slice(clips: "ClipTable", split: str, text: str, where: str) -> "ClipTable":
    import polars as pl

    from olt_datasets.mixtures.recipe import parse_filter
    from olt_datasets.mixtures.selection import matches

    return clips.lazy().filter((pl.col("split") == split) & matches(parse_filter(text, where)))


def _read_weights(text: str) -> dict[str, float]:
    from olt_generator.errors import InputError

    weights = {}
    for part in text.split(","):
        name, _, number = part.partition("=")
        try:
            weights[name.strip()] = float(number)
        except ValueError:
            weights[name.strip()] = math.nan
        if not name.strip() or not 0.0 <= weights[name.strip()] < math.inf:
            raise InputError(f"--target-weights: {part!r}: write FACTOR=WEIGHT with a weight that is not negative")
    return weights


def _show_alignment(found: "SourceAlignment") -> None:
    from olt_datasets.mixtures.source_alignment import word_missing_factor
    from olt_toolkit.runtime.console import print_line, print_table

    factors = list(found.target)
    rows: list[list[Any]] = [
        [source.name, *(f"{found.coverage[source.name][factor]:g}" for factor in factors)] for source in found.sources
    ]
    rows.append(["target", *(f"{share:.1%}" for share in found.target.values())])
    print_table("Clips by source", ("source", *factors), rows)
    gaps = [(source.name, f"{source.clips:g}", *_cells(source.gap), f"{source.share:.1%}") for source in found.sources]
    gaps.append(("all clips together", "", *_cells(found.pooled_gap), ""))
    gaps.append(("proposed shares", "", *_cells(found.proposed_gap), ""))
    print_table("Alignment gap", ("source", "clips", "gap", "95 %", "proposed share"), gaps)
    for missing in found.missing:
        print_line(word_missing_factor(missing))


def _cells(gap: "Gap") -> tuple[str, str]:
    return f"{gap.median:.3f}", f"{gap.low:.3f} - {gap.high:.3f}"
