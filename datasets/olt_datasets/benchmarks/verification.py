"""`olt bench verify`: how many planted faults are found, how often good clips are said to be bad, and at what cost."""

from typing import Annotated, Any

import typer

app = typer.Typer(add_completion=False)


@app.command()
def verify(
    stores: Annotated[int, typer.Option(min=1, help="Stores of two clips; each fault is planted into each.")] = 60,
    seed: Annotated[int, typer.Option(help="Seed of the clips; limits were chosen on seed 0.")] = 1,
    faults: Annotated[str | None, typer.Option(help="Only faults whose name holds this text.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; one for each processor by default.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Plant every kind of fault into good clips and count which are found, and count what is said of the good clips."""
    from olt_datasets.benchmarks.fault_rates import count_faults, measure_store
    from olt_datasets.benchmarks.planted_faults import FAULTS
    from olt_toolkit.clips.verification.verify import GROUPS
    from olt_toolkit.runtime.console import print_json

    result = count_faults("verify", measure_store, FAULTS, GROUPS, stores, seed, faults, workers)
    print_json(result) if as_json else print_result(result)


def print_result(result: dict[str, Any]) -> None:
    """Print what `fault_rates.summarize` gives as tables."""
    from olt_toolkit.runtime.console import print_line, print_table

    rows = [
        (row["fault"], row["n"], row["found"], row["not_compared"], row["missed"], _interval(row["interval"]))
        for row in result["faults"]
    ]
    columns = ("fault", "clips", "found", "not compared", "missed", "found of compared, 95 %")
    print_table("Planted faults", columns, rows)
    rows = [(row["looks_at"], row["ms_per_clip"], row["kinds_found"], row["kinds"]) for row in result["cost"]]
    columns = ("looks at", "processor ms a clip", "kinds of faults found (95 %)", "of")
    print_table("What is looked at, and what that finds", columns, rows)
    clean = result["clean"]
    print_line(
        f"clean clips: {clean['failed']} of {clean['compared']} results are false alarms "
        f"({_interval(clean['interval'])}), {clean['not_compared']} not compared"
    )
    for alarm in clean["false_alarms"]:
        print_line(f"false alarm: {alarm}")
    print_line(f"machine: {result['machine']['processor']}, {result['machine']['cores']} cores")


def _interval(bounds: list[float] | None) -> str:
    return "none compared" if bounds is None else f"{100 * bounds[0]:.3g} to {100 * bounds[1]:.3g} %"
