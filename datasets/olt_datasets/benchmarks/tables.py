"""`olt bench tables`: time and memory of indexing, splitting, checking and composing, by the number of rows."""

from typing import Annotated

import typer

app = typer.Typer(add_completion=False)

_COLUMNS = {
    "step": "step",
    "rows": "rows",
    "s": "seconds",
    "processor s": "processor_seconds",
    "rows/s": "rows_per_processor_second",
    "peak MiB": "peak_memory_mib",
}


@app.command()
def tables(
    rows: Annotated[int, typer.Option(min=1000, help="Clips of the tables.")] = 1_000_000,
    index_rows: Annotated[
        int | None, typer.Option(min=0, help="Clips to index, which takes longest; as many by default, 0 for none.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Index a data set of invented drives, split an invented table, check and compose; each in a process of its own."""
    from olt_datasets.benchmarks.table_steps import measure_steps
    from olt_toolkit.runtime.console import print_json, print_table, show_progress
    from olt_toolkit.runtime.environment import describe_machine

    with show_progress("bench tables") as (on_progress, _):
        steps = measure_steps(rows, rows if index_rows is None else index_rows, on_progress)
    if as_json:
        print_json({"benchmark": "tables", "steps": steps, "machine": describe_machine()})
        return
    print_table("Tables", list(_COLUMNS), [[step[name] for name in _COLUMNS.values()] for step in steps])
