"""`olt closed-loop`: drive scenes and score the drives."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from olt_closed_loop.score_table import ScoreRow, ScoreTable

app = typer.Typer(no_args_is_help=True, help="Drive policies through scenes and score them.")


class ScoreDefinition(StrEnum):
    """The definitions of a score (`olt_closed_loop.scoring`)."""

    strict = "strict"
    alpasim = "alpasim"


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


@app.command()
def score_rollout(
    file: Annotated[Path, typer.Argument(help="One rollout as JSON (olt_closed_loop.rollout_files).")],
    definition: Annotated[ScoreDefinition, typer.Option(help="How the score is defined.")] = ScoreDefinition.strict,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Score one recorded rollout."""
    from olt_closed_loop.alpasim.scores import score_as_alpasim
    from olt_closed_loop.rollout_files import read_rollout_file
    from olt_closed_loop.scoring import score_record
    from olt_toolkit.console import print_json, print_table

    record = read_rollout_file(file)
    if definition is ScoreDefinition.alpasim:
        scores = score_as_alpasim(record)
        result = {"definition": definition.value, **scores.to_dict()}
        figures = {**vars(scores.scene), **scores.final}
    else:
        strict = score_record(record)
        result = strict.to_dict()
        figures = {name: value for name, value in result.items() if name not in ("metrics", "collisions", "left_out")}
        figures |= strict.metrics | {f"hits {c.agent_id}": f"{c.side} at {c.time_us} us" for c in strict.collisions}
    if as_json:
        print_json(result)
    else:
        print_table(f"{file.name}, definition {definition.value}", ["figure", "value"], list(figures.items()))


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
