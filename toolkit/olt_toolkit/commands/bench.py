"""`olt bench`: error against run time of the registered components."""

from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

COMMANDS = "olt.benchmark_commands"
"""Entry points of benchmarks that have options of their own: each is a Typer app with one command."""


class _BenchGroup(TyperGroup):
    """A command for each benchmark: its own where it brings one, and the common one for all others."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all benchmarks, and `all` and `list`."""
        return [*_names(), "all", "list"]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a benchmark; the common one answers for names that there are not."""
        own = entry_points(group=COMMANDS, name=cmd_name)
        command = typer.main.get_command(next(iter(own)).load() if own else _common_app(cmd_name))
        command.name = cmd_name
        return command


app = typer.Typer(add_completion=False, cls=_BenchGroup, no_args_is_help=True)


@app.callback()
def bench() -> None:
    """Measure error against run time of a component, or of all."""


def _names() -> list[str]:
    from olt_toolkit.bench.runner import benchmark_names

    return sorted({*benchmark_names(), *(entry.name for entry in entry_points(group=COMMANDS))})


def _common_app(name: str) -> typer.Typer:
    """The app of a benchmark without options of its own."""
    common = typer.Typer(add_completion=False)

    @common.command()
    def measure(
        out: Annotated[Path, typer.Option(help="Folder for the JSON report and the plot.")] = Path("runs/bench"),
        repeats: Annotated[int, typer.Option(min=1, help="Timed runs per setting.")] = 7,
        as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    ) -> None:
        """Report per setting the error, median time and spread, peak memory, and draw the Pareto front."""
        _measure(name, out, repeats, as_json)

    return common


def _measure(name: str, out: Path, repeats: int, as_json: bool) -> None:
    from olt_toolkit.bench.runner import benchmark_names
    from olt_toolkit.runtime.console import print_json, print_line

    if name == "list":
        if as_json:
            print_json({"benchmarks": _names()})
        else:
            print_line("\n".join(_names()))
        return
    reports = [_run_one(each, out, repeats) for each in (benchmark_names() if name == "all" else [name])]
    if as_json:
        print_json(reports[0] if len(reports) == 1 else {"reports": reports})
        return
    for report in reports:
        _print_report(report, out)


def _run_one(name: str, out: Path, repeats: int) -> dict[str, Any]:
    import json

    from olt_generator.files import write_whole
    from olt_toolkit.bench.plot import plot_benchmark
    from olt_toolkit.bench.runner import load_benchmark, run_benchmark
    from olt_toolkit.runtime.console import make_progress, show_progress

    grid = load_benchmark(name).grid  # an unknown name fails before the bar is drawn
    with show_progress(f"bench {name}") as (on_progress, _):
        report = run_benchmark(name, repeats, on_progress)
    with write_whole(out / f"{name}.json") as path:
        path.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n")
    with write_whole(out / f"{name}.png") as path:
        plot_benchmark(report, path)
    if grid is not None:
        with make_progress() as progress:
            progress.add_task(f"bench {name}: extreme cases", total=None)
            cases = grid()
        report["grid"] = list(cases.summary)
        with write_whole(out / f"{name}_grid.json") as path:
            path.write_text(json.dumps(list(cases.rows), indent=1, allow_nan=False) + "\n")
    return report


def _print_report(report: dict[str, Any], out: Path) -> None:
    from olt_toolkit.runtime.console import print_line, print_table

    rows = [
        (
            row["setting"] + (" (default)" if row["default"] else ""),
            row["error"],
            *row["figures"].values(),
            f"{1e3 * row['median_s']:.3f}",
            f"{1e3 * row['first_quartile_s']:.3f} - {1e3 * row['third_quartile_s']:.3f}",
            row["peak_memory_mib"],
            "yes" if row["pareto"] else "",
        )
        for row in report["settings"]
    ]
    columns = (
        "setting",
        f"{report['error_name']} ({report['error_unit']})",
        *report["settings"][0]["figures"],
        "median (ms)",
        "quartiles (ms)",
        "peak memory (MiB)",
        "on the front",
    )
    print_table(report["title"], columns, rows)
    print_line(f"reference: {report['reference']}")
    print_line(f"machine: {report['machine']['processor']}, {report['machine']['cores']} cores")
    if "grid" in report:
        print_line("\n".join([*report["grid"], f"cases: {out / report['benchmark']}_grid.json"]))
    print_line(f"plot: {out / report['benchmark']}.png")
