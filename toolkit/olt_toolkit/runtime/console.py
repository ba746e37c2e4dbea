"""What commands print: tables and progress for people, one JSON object for machines."""

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import Progress as ProgressBar


def print_json(result: dict[str, Any]) -> None:
    """Write one JSON object to standard output; a number that is not finite is an error, never a NaN in the text."""
    sys.stdout.write(json.dumps(result, indent=2, allow_nan=False) + "\n")


def print_line(text: str) -> None:
    """Write one line for people to standard output."""
    sys.stdout.write(text + "\n")


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table; a cell that is None reads "not measured"."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column)
    for row in rows:
        table.add_row(*(escape(format_cell(cell)) for cell in row))
    # A pipe has no width; cells cut to 80 columns would lose numbers.
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def format_cell(value: object) -> str:
    """Text of a table cell: None is "not measured", floats keep four significant digits."""
    if value is None:
        return "not measured"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def word_interval(limits: Sequence[float] | None) -> str | None:
    """An interval for a cell of a table; None, "not measured", as it is."""
    return None if limits is None else f"{limits[0]:.3f} to {limits[1]:.3f}"


@contextmanager
def show_progress(label: str, total: int = 100) -> Iterator[tuple[Callable[[float], None], Callable[[str], None]]]:
    """Show a progress bar; yields what to tell the share that is done, of so many parts, and the step that is next."""
    with make_progress() as bar:
        task = bar.add_task(label, total=total)
        yield (
            lambda share: bar.update(task, completed=round(total * share)),
            lambda step: bar.update(task, description=f"{label}: {step}"),
        )


def make_progress() -> "ProgressBar":
    """A progress bar on standard error, so that standard output stays clean for results."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
    )
