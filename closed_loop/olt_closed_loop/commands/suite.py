"""`olt closed-loop suite`: the events of the long-tail suite, and suites as files."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from olt_closed_loop.commands.options import check_picture
from olt_toolkit.commands.parallel_options import WorkersOption

if TYPE_CHECKING:
    from olt_closed_loop.evaluation.suite_check import EventCheck, SuiteCheck
    from olt_closed_loop.suite.files import Suite

app = typer.Typer(no_args_is_help=True, help="The long-tail suite: list, make, check and picture its scenes.")

SuiteArgument = Annotated[str, typer.Argument(help="longtail, all, a category, or a suite's YAML file.")]
OnlyOption = Annotated[list[str] | None, typer.Option("--only", help="An event's name; several may be given.")]
TRAINING_SEEDS = 20
"""Seeds of each category of the training generator whose roads a check compares with."""


@app.command(name="list")
def list_events(
    suite: SuiteArgument = "longtail",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List the scenes of a suite with their categories, factors and weights, and what the factors mean."""
    from olt_closed_loop.suite.catalogue import FACTORS
    from olt_closed_loop.suite.files import built_in_suites
    from olt_toolkit.runtime.console import print_json, print_line, print_table

    found = _suite(suite, None)
    if as_json:
        rows = [vars(scene).copy() for scene in found.scenes]
        print_json({"suite": found.name, "scenes": rows, "factors": FACTORS, "suites": list(built_in_suites())})
        return
    rows = [
        (scene.source, scene.category or "the scene's own", scene.weight, ", ".join(scene.factors or ()))
        for scene in found.scenes
    ]
    print_table(f"Suite {found.name}: {len(rows)} scenes", ["scene", "category", "weight", "factors"], rows)
    print_table("Factors", ["factor", "meaning"], list(FACTORS.items()))
    print_line(f"suites without a file: {', '.join(built_in_suites())}")


@app.command()
def make(
    out: Annotated[Path, typer.Option(help="Folder for the scene files and suite.yaml.")],
    suite: SuiteArgument = "longtail",
    only: OnlyOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the events; 0 by default.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write the scenes of a suite as files, and a suite that names them; the same call writes the same bytes."""
    from dataclasses import replace

    from olt_closed_loop.evaluation.evaluation import load_scene
    from olt_closed_loop.scenes.scene_file import write_scene
    from olt_closed_loop.suite.files import Suite, write_suite
    from olt_closed_loop.suite.scenes import with_seed
    from olt_toolkit.runtime.console import make_progress, print_json, print_line

    found, written = _suite(suite, only), []
    out.mkdir(parents=True, exist_ok=True)
    with make_progress() as progress:
        for one in progress.track(found.scenes, description="scenes"):
            source = one.source if seed is None else with_seed(one.source, seed)
            scene = load_scene(source)
            path = write_scene(scene, out / f"{scene.name}.usdc")
            factors = scene.factors if one.factors is None else one.factors
            written.append(replace(one, source=str(path), category=one.category or scene.category, factors=factors))
    write_suite(Suite(found.name, tuple(written)), out / "suite.yaml")
    if as_json:
        print_json({"suite": str(out / "suite.yaml"), "scenes": [scene.source for scene in written]})
    else:
        print_line(f"{len(written)} scenes and {out / 'suite.yaml'}")


@app.command()
def check(
    suite: SuiteArgument = "longtail",
    only: OnlyOption = None,
    apart_from: Annotated[
        list[str] | None,
        typer.Option(help="Scenes that may share no road with these; by default 20 of each category of the generator."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds of each event to check: 0, 1, ...")] = 1,
    workers: WorkersOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check that each event can be driven by who sees everything, and that knowing nothing does not drive it.

    Exit status 1 if one cannot be driven, one is solved by all baselines, fewer than 80 % are failed by all of them, or
    a road is shared with scenes to be apart from.
    """
    from olt_closed_loop.evaluation.evaluation import find_scenes
    from olt_closed_loop.evaluation.suite_check import check_suite
    from olt_closed_loop.scenes.procedural import CATEGORIES
    from olt_closed_loop.suite.scenes import with_seed
    from olt_toolkit.runtime.console import make_progress, print_json
    from olt_toolkit.runtime.workers import default_workers

    every = (with_seed(source, seed) for source in _suite(suite, only).sources for seed in range(seeds))
    sources = list(dict.fromkeys(every))
    training = [f"{category}:{seed}" for category in CATEGORIES for seed in range(TRAINING_SEEDS)]
    others = [str(scene) for scene in find_scenes(apart_from)] if apart_from else training
    with make_progress() as progress:
        task = progress.add_task("check", total=len(sources))
        result = check_suite(
            sources,
            others,
            workers or default_workers(),
            lambda share: progress.update(task, completed=round(share * len(sources))),
        )
    if as_json:
        print_json(result.to_dict())
    else:
        _print_check(result)
    if not result.passed:
        raise typer.Exit(1)


@app.command()
def picture(
    out: Annotated[Path, typer.Option(help="Picture to write: .png, .svg or .pdf.")],
    suite: SuiteArgument = "longtail",
    only: OnlyOption = None,
) -> None:
    """Draw a contact sheet: each scene from above and as the front camera sees its event."""
    from olt_closed_loop.evaluation.evaluation import load_scene
    from olt_closed_loop.suite.picture import draw_suite
    from olt_toolkit.runtime.console import make_progress, print_line

    check_picture(out)
    with make_progress() as progress:
        sources = _suite(suite, only).sources
        scenes = [load_scene(source) for source in progress.track(sources, description="scenes")]
    draw_suite(out, scenes)
    print_line(str(out))


def _suite(name: str, only: list[str] | None) -> "Suite":
    from olt_closed_loop.suite.files import find_suite, suite_of

    return suite_of(only, name) if only else find_suite(name)


def _print_check(result: "SuiteCheck") -> None:
    from olt_toolkit.runtime.console import print_line, print_table

    columns = ["scene", "can be driven", "privileged AS", "solved by", "baselines AS"]
    print_table("Suite", columns, [_check_row(event) for event in result.events])
    count = len(result.events)
    print_line(f"{sum(event.solvable for event in result.events)} of {count} can be driven by who sees everything")
    print_line(f"{result.failed_by_all} of {count} are solved by no baseline")
    print_line(f"{sum(not event.scored_by for event in result.events)} of {count} give no baseline a score of 1")
    print_line(f"lanes shared with {result.apart_from} other scenes: {len(result.shared)}")
    for event in result.events:
        for line in event.gate:
            print_line(f"{event.source}: {line}")
    for line in result.shared:
        print_line(f"shared: {line}")


def _check_row(event: "EventCheck") -> list[str]:
    scores = sorted({"not measured" if score is None else f"{score:.3f}" for score in event.privileged.values()})
    beside = ", ".join(
        f"{name} {'not measured' if score is None else f'{score:.2f}'}" for name, (score, _) in event.baselines.items()
    )
    return [event.source, "yes" if event.solvable else "NO", ", ".join(scores), ", ".join(event.solved_by), beside]
