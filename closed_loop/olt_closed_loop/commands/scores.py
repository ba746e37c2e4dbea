"""Look at what was driven: rollouts of a run, policies beside each other, one recorded rollout."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from olt_closed_loop.commands.options import Definition
from olt_closed_loop.commands.score_output import print_comparison

if TYPE_CHECKING:
    from olt_closed_loop.scoring.collisions import Collision

LISTED = {
    "rollout": "rollout",
    "scene": "scene",
    "seed": "seed",
    "score": "score",
    "reason": "reason",
    "plans_asked": "plans",
    "plans_refused": "refused",
    "plans_out_of_reach": "out of reach",
    "solves": "solves",
    "solves_failed": "failed",
    "solves_late": "late",
    "saturations": "saturated",
    "plan_deviation_max": "off the plan (m)",
}
"""Columns of the list of rollouts."""


def show(
    run: Annotated[Path, typer.Argument(help="Folder of `olt closed-loop run --out`.")],
    rollout: Annotated[str | None, typer.Argument(help="Its number or SCENE:SEED; without, all are listed.")] = None,
    draw_all: Annotated[bool, typer.Option("--all", help="Draw every rollout.")] = False,
    video: Annotated[bool, typer.Option(help="Make an mp4 too.")] = True,
    scene: Annotated[str | None, typer.Option(help="The scene, if the run's own is not where it was.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for pictures and videos; by default RUN/shown.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List the finished rollouts of a run, or draw one: from above, over time, and as a video."""
    from olt_closed_loop.evaluation.show import find_rollouts, show_rollouts, summarize_rollout
    from olt_toolkit.runtime.console import make_progress, print_json, print_line, print_table

    if rollout is not None and draw_all:
        raise typer.BadParameter("give either a rollout or --all")
    found = find_rollouts(run, rollout)
    shown = []
    if rollout is not None or draw_all:
        with make_progress() as progress:
            task = progress.add_task("show", total=len(found))
            for one in found:
                shown += show_rollouts([one], out or run / "shown", scene, video)
                progress.advance(task)
    rows = [summarize_rollout(one) for one in found]
    files = [str(path) for one in shown for path in (one.picture, one.video) if path]
    if as_json:
        print_json({"rollouts": rows, "files": files})
        return
    if rollout is not None:
        print_table(f"rollout {rows[0]['rollout']}", ["figure", "value"], list(rows[0].items()))
    else:
        print_table(str(run), list(LISTED.values()), [[row[name] for name in LISTED] for row in rows])
    for file in files:
        print_line(file)


def compare(
    runs: Annotated[list[Path], typer.Argument(help="Folders that `olt closed-loop run --out` wrote, two or more.")],
    out: Annotated[Path | None, typer.Option(help="Folder for comparison.json and comparison.png.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare policies on the scenes that all of them drove: differences paired by scene, with intervals."""
    from olt_closed_loop.evaluation.comparison import compare_scores, name_runs, read_scores
    from olt_closed_loop.evaluation.comparison_report import save_comparison
    from olt_toolkit.runtime.console import print_json, print_line

    if len(set(runs)) < 2:
        raise typer.BadParameter("give two or more folders of runs")
    scores = [read_scores(folder) for folder in runs]
    comparison = compare_scores(dict(zip(name_runs(runs, scores), scores, strict=True)))
    if out:
        save_comparison(out, comparison)
    if as_json:
        print_json(comparison.to_dict())
        return
    print_comparison("Scenes that all of them drove", comparison)
    if comparison.not_compared:
        print_line(f"not compared: {len(comparison.not_compared)} scenes that only some of them drove")


def score_rollout(
    file: Annotated[Path, typer.Argument(help="One rollout as JSON (olt_closed_loop.rollouts.rollout_files).")],
    definition: Annotated[Definition, typer.Option(help="How the score is defined.")] = "strict",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Score one recorded rollout."""
    from olt_closed_loop import read_rollout_file, score_record
    from olt_closed_loop.scoring.alpasim.scores import score_as_alpasim
    from olt_closed_loop.scoring.definitions import alpasim_rows, alpasim_version, full_definition
    from olt_generator.omissions import word_omission
    from olt_toolkit.runtime.console import print_json, print_line, print_table

    record, definition = read_rollout_file(file), full_definition(definition)
    version = alpasim_version(definition)
    score = score_record(record, definition)
    if version:
        (row,) = alpasim_rows([score])
        result = {"definition": definition, **score_as_alpasim(record, version).to_dict(), "summary_row": row}
        if score.failed:  # whose metrics AlpaSim never looks at
            result |= {"final": {}, "scene": {name: row[name] for name in ("score", "failure_reason", "passed")}}
        figures = {"status": row["status"], **result["scene"], **result["final"]}
    else:
        result = score.to_dict()
        figures = {name: value for name, value in result.items() if name not in ("metrics", "collisions", "left_out")}
        figures |= score.metrics | {f"hits {c.agent_id}": word_collision(c) for c in score.collisions}
    if as_json:
        print_json(result)
    else:
        print_table(f"{file.name}, definition {definition}", ["figure", "value"], list(figures.items()))
        for omission in score.left_out:
            print_line(f"left out: {word_omission(omission)}")


def word_collision(collision: "Collision") -> str:
    """When, where, whose fault, and why."""
    whose = "at fault" if collision.at_fault else "not at fault"
    return f"{collision.side} at {collision.time_us} us, {whose}: {collision.rule} ({collision.reason})"
