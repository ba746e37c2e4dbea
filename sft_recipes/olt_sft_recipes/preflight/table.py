"""The preflight's table for people."""

from itertools import groupby
from operator import attrgetter

from olt_sft_recipes.preflight.rows import PreflightReport, Verdict
from olt_toolkit.runtime.console import print_line, print_table


def print_report(report: PreflightReport) -> None:
    """Print one table a group, each failure again in a line that is not wrapped, and how many checks passed."""
    for group, rows in groupby(report.rows, attrgetter("group")):
        cells = [
            (
                row.verdict.value,
                row.check,
                row.where,
                row.found,
                row.action,
            )
            for row in rows
        ]
        print_table(group, ("verdict", "check", "where", "found", "what to do"), cells)
    for row in report.failures:
        print_line(f"failed: {row.check}: {row.where}: {row.found}; {row.action}")
    counts = ", ".join(f"{report.count(verdict)} {verdict.value}" for verdict in Verdict)
    print_line(f"{counts}; {report.seconds:.1f} s")
