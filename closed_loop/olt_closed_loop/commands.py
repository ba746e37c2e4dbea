"""`olt closed-loop`: drive scenes and score the drives."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from olt_closed_loop.score_table import ScoreRow, ScoreTable

app = typer.Typer(no_args_is_help=True, help="Drive policies through scenes and score them.")


@app.callback()
def _group() -> None:
    """Keeps `run` a command of its own while it is the only one."""


@app.command()
def run(
    scene: Annotated[list[str], typer.Option(help="A USD stage, or CATEGORY:SEED; may be given several times.")],
    policy: Annotated[str, typer.Option(help="NAME or NAME:PATH, for example route or toy:CHECKPOINT.")],
    rollouts: Annotated[int, typer.Option(help="Drives of each scene.")] = 2,
    seed: Annotated[int, typer.Option(help="Seed of the first drive; the next has the next number.")] = 0,
    workers: Annotated[int | None, typer.Option(help="Processes; by default one for each processor.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for rollouts.json and scores.json.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Drive scenes with a policy and print AS and CR by category."""
    from olt_closed_loop.evaluation import pass_gate, run_closed_loop, save_results
    from olt_closed_loop.score_table import summarize_scores
    from olt_toolkit.console import make_progress, print_json, print_line
    from olt_toolkit.workers import default_workers

    pass_gate(scene)
    with make_progress() as progress:
        total = len(scene) * rollouts
        task = progress.add_task("closed loop", total=total)
        results = run_closed_loop(
            scene,
            policy,
            rollouts,
            seed,
            workers=workers or default_workers(),
            on_progress=lambda share: progress.update(task, completed=round(share * total)),
        )
    scores = [score for _, score in results]
    table = summarize_scores(scores)
    if out:
        save_results(out, results)
    if as_json:
        print_json({"policy": policy, "table": table.to_dict(), "scores": [score.to_dict() for score in scores]})
    else:
        _print_scores(policy, table)
        failures = sorted({f"{score.scene}: not valid: {score.reason}" for score in scores if not score.valid})
        for line in failures + sorted({note for score in scores for note in score.left_out}):
            print_line(line)
    if table.overall.valid < table.overall.rollouts:
        raise typer.Exit(1)


def _print_scores(policy: str, table: "ScoreTable") -> None:
    from olt_toolkit.console import print_table

    columns = ["category", "valid / rollouts", "AS", "95 %", "CR", "95 %"]
    print_table(f"{policy}, definition {table.definition}", columns, [_cells(row) for row in table.rows])


def _cells(row: "ScoreRow") -> list[object]:
    def interval(limits: tuple[float, float] | None) -> str | None:
        return f"{limits[0]:.3f} to {limits[1]:.3f}" if limits else None

    return [
        row.category,
        f"{row.valid} / {row.rollouts}",
        row.alpasim_score,
        interval(row.alpasim_score_interval),
        row.collision_rate,
        interval(row.collision_rate_interval),
    ]
