"""`olt bench leaks`: planted leaks of every kind, made by the commands, and how many of them are found."""

from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(add_completion=False)


@app.command()
def leaks(
    drives: Annotated[int, typer.Option(min=3, help="Drives in invented worlds.")] = 8,
    others: Annotated[int, typer.Option(min=0, help="Drives in other worlds, which leak nothing.")] = 4,
    recording: Annotated[
        list[Path] | None, typer.Option(help="A video whose beginning is one more drive; may be repeated.")
    ] = None,
    kinds: Annotated[str | None, typer.Option(help="Only these kinds, with commas between them.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Plant leaks of every kind in tables and stores that the commands make, and count those that are found."""
    import tempfile

    from olt_datasets.benchmarks.planted_leaks import KINDS, measure_planted, write_drives
    from olt_generator.errors import InputError
    from olt_toolkit.runtime.console import print_json
    from olt_toolkit.runtime.environment import describe_machine

    chosen = kinds.split(",") if kinds else list(KINDS)
    unknown = [kind for kind in chosen if kind not in KINDS]
    if unknown:
        raise InputError(f"kind {unknown[0]!r} is not one of {', '.join(KINDS)}")
    with tempfile.TemporaryDirectory() as folder:
        videos = write_drives(Path(folder) / "drives", drives + others, recording or [])
        # The others lie apart, so that training does not hold them.
        apart = Path(folder) / "others"
        apart.mkdir()
        clean = [video.rename(apart / video.name) for video in videos[drives : drives + others]]
        rows = measure_planted(videos[:drives] + videos[drives + others :], clean, Path(folder), chosen)
    result = {"benchmark": "leaks", "kinds": [row.to_dict() for row in rows], "machine": describe_machine()}
    if as_json:
        print_json(result)
    else:
        _print_result(result)


def _print_result(result: dict[str, Any]) -> None:
    from olt_toolkit.runtime.console import print_table

    rows = [
        (
            row["kind"],
            f"{row['found']} of {row['planted']}",
            "{:.0%} - {:.0%}".format(*row["found_interval"]),
            ", ".join(f"{rule} {count}" for rule, count in row["rules"].items()),
            f"{row['false_alarms']} of {row['pairs']:,} pairs",
        )
        for row in result["kinds"]
    ]
    print_table("Planted leaks", ("planted", "found", "95 %", "by rule", "false alarms"), rows)
