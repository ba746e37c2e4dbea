"""`olt data verify`: look at what was made before it is trained on."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from olt_toolkit.commands.clip_options import JsonOption
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.runtime.workers import Engine

if TYPE_CHECKING:
    from olt_toolkit.clips.verification.report import Report

_SHOWN = 50


def verify(
    target: Annotated[
        Path, typer.Argument(metavar="STORE|MIXTURE|EXPORT", help="A clip store, a composed mixture, or an export.")
    ],
    checks: Annotated[
        str | None,
        typer.Option(help="Only these groups, with commas: tables, files, times, motion, calibration, videos, images."),
    ] = None,
    workers: WorkersOption = None,
    engine: EngineOption = Engine.LOCAL,
    as_json: JsonOption = False,
) -> None:
    """Look at every clip: its files, clocks, motion, calibration, videos and what they show.

    Every check says that it passed, failed, or could not be made and why. Exit status 1 if one failed, or if none of a
    group that --checks names could be made.
    """
    from olt_datasets.verification.targets import verify as verify_target
    from olt_toolkit.clips.verification.findings import Verdict
    from olt_toolkit.clips.verification.verify import GROUPS, check_groups
    from olt_toolkit.runtime.console import print_json, show_progress
    from olt_toolkit.runtime.workers import default_workers

    groups = GROUPS if checks is None else check_groups([name.strip() for name in checks.split(",")])
    with show_progress("clips") as (on_progress, _):
        report = verify_target(target, groups, workers or default_workers(), on_progress, engine)
        on_progress(1.0)
    if as_json:
        print_json({"target": str(target), "checks": list(groups), **report.to_dict()})
    else:
        show_report(report, f"{target}: {report.clips} clips")
    looked = report.count(Verdict.PASSED) + report.count(Verdict.FAILED)
    if report.failures or (checks is not None and not looked):
        raise typer.Exit(1)


def show_report(report: "Report", title: str) -> None:
    """Print the tallies of all checks, why some could not be made, and each failure."""
    from olt_toolkit.clips.verification.findings import Verdict
    from olt_toolkit.runtime.console import print_line, print_table

    rows = []
    for check, tally in report.tallies.items():
        counts = [tally.counts[verdict] for verdict in (Verdict.PASSED, Verdict.FAILED, Verdict.NOT_COMPARED)]
        worst = tally.worst
        numbers = ("", "") if worst is None or worst.limit is None else (worst.measured, worst.limit)
        rows.append((check, *counts, *numbers))
    print_table(title, ("check", "passed", "failed", "not compared", "worst", "limit"), rows)
    for check, tally in report.tallies.items():
        times = tally.counts[Verdict.NOT_COMPARED]
        for finding in tally.not_compared[:1]:
            print_line(f"not compared: {check}, {times} times, as {finding.where}: {finding.detail}")
    for finding in report.failures[:_SHOWN]:
        number = "" if finding.measured is None else f"{finding.measured:.4g} "
        limit = "" if finding.limit is None else f" (at most {finding.limit:.4g})"
        print_line(f"failed: {finding.check}: {finding.where}: {number}{finding.detail}{limit}")
    if len(report.failures) > _SHOWN:
        print_line(f"and {len(report.failures) - _SHOWN} more failures; --json lists all")
    counts = {verdict.value: report.count(verdict) for verdict in Verdict}
    print_line(", ".join(f"{count} {word}" for word, count in counts.items()))
