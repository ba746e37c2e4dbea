"""`olt data index`, `split` and `check`: tables of clips, before any is built."""

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from olt_datasets.commands.dataset_options import DEFAULT_CACHE, CacheOption, JsonOption, SourceOption
from olt_datasets.tables.choices import PAPER_FRAMES, PAPER_STRIDE, SampleChoice, SplitRule
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.runtime.workers import Engine

_SHOWN = 20


def index(
    root: Annotated[Path, typer.Argument(help="Folder of the data set.")],
    out: Annotated[Path, typer.Option(help="The table to write (.parquet); rows that still hold are kept.")],
    source: SourceOption = None,
    frames: Annotated[int, typer.Option(min=2, help="Front images in a window.")] = PAPER_FRAMES,
    stride: Annotated[int, typer.Option(min=1, help="Images from one window to the next.")] = PAPER_STRIDE,
    seconds: Annotated[float | None, typer.Option(help="Windows of this duration, in place of frames.")] = None,
    samples: Annotated[
        SampleChoice, typer.Option("--t0", help="Every 0.1 s, the moment nearest to 5.1 s, or the data set's events.")
    ] = SampleChoice.EVERY,
    cache: CacheOption = DEFAULT_CACHE,
    keep_going: Annotated[bool, typer.Option("--keep-going", help="Leave out damaged drives and list them.")] = False,
    workers: WorkersOption = None,
    engine: EngineOption = Engine.LOCAL,
    as_json: JsonOption = False,
) -> None:
    """List all clips that a data set can be cut into, without decoding an image.

    The table says of each clip at which times it will give a policy sample, or why at none. Exit status 1 if drives
    failed with --keep-going.
    """
    from dataclasses import asdict

    from olt_datasets.tables.cutting import Cutting
    from olt_datasets.tables.indexing import index_dataset
    from olt_generator.errors import InputError
    from olt_toolkit.recordings.drives import DatasetPlace
    from olt_toolkit.runtime.console import print_json, print_line, show_progress
    from olt_toolkit.runtime.workers import default_workers

    cutting = Cutting(frames, stride, seconds, samples)
    place = DatasetPlace(root, cache.expanduser(), source)
    with show_progress("drives") as (on_progress, _):
        summary = index_dataset(place, out, cutting, workers or default_workers(), on_progress, keep_going, engine)
    if as_json:
        print_json({"table": str(out), **asdict(summary)})
    else:
        print_line(f"{out}: {summary.clips} clips of {summary.drives} drives of {summary.source}")
        print_line(
            f"{summary.clips_with_samples} of them give {summary.samples} policy samples; the others say why not"
        )
        print_line(f"{summary.kept} rows were kept from the table as it was")
        example = "".join(f", as {key}" for key in summary.without_clips[:1])
        print_line(f"{len(summary.without_clips)} drives fill no window{example}")
        for key, message in summary.failed.items():
            print_line(f"failed: {key}: {message}")
    if summary.failed:
        raise InputError(f"{len(summary.failed)} of {summary.drives} drives could not be used; the others are in {out}")


def split(
    table: Annotated[Path, typer.Argument(help="A table of indexed clips (.parquet).")],
    rule: Annotated[SplitRule, typer.Option(help="How clips come into splits.")],
    out: Annotated[Path, typer.Option(help="The table to write; it may be the same one.")],
    source: Annotated[
        list[str] | None, typer.Option(help="Only for clips of this source; repeat for more than one.")
    ] = None,
    val: Annotated[float, typer.Option(help="Share of validation.")] = 0.0,
    test: Annotated[float, typer.Option(help="Share of test.")] = 0.2,
    gap: Annotated[float, typer.Option(help="Seconds between windows of different splits (seen).")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the choice of scenes (unseen).")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Put clips into splits by a rule.

    seen: the latest windows of every scene are test. unseen: whole scenes are. external: a whole source is, and is
    never trained on. own: the data set's own splits, which every clip must have.
    """
    from olt_datasets.tables.splits import Splitting, split_table
    from olt_toolkit.runtime.console import print_json, print_table

    counts = split_table(table, Splitting(rule, tuple(source or ()), val, test, gap, seed), out)
    if as_json:
        print_json({"table": str(out), "rule": rule.value, "clips": counts})
    else:
        print_table(f"Splits of {out} by rule {rule.value}", ("split", "clips"), list(counts.items()))


def check(
    tables: Annotated[list[Path], typer.Argument(metavar="TABLE|STORE...", help="Indexed tables and clip stores.")],
    held_out: Annotated[
        list[str] | None, typer.Option(help="A scene that is not trained on; repeat for more than one.")
    ] = None,
    external: Annotated[
        list[str] | None, typer.Option(help="A source that is not trained on; repeat for more than one.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List everything that leaks from one split into another. Exit status 1 if anything does.

    GT and Syn clips of the same moments, windows of a scene that overlap, clips of other scenes that look alike,
    held-out scenes and external sources in training.
    """
    from olt_datasets.tables.clip_frame import scan_clip_tables
    from olt_datasets.tables.leaks import find_table_leaks
    from olt_toolkit.runtime.console import print_json, print_line

    leaks = find_table_leaks(scan_clip_tables(tables), held_out or (), external or ())
    if as_json:
        print_json({"clean": not leaks, "leaks": [vars(leak) for leak in leaks]})
    else:
        counts = ", ".join(f"{count} {rule}" for rule, count in Counter(leak.rule for leak in leaks).items())
        print_line(f"{len(leaks)} leaks: {counts}" if leaks else "no leaks")
        for leak in leaks[:_SHOWN]:
            print_line(f"  {leak.rule}: {leak}")
        if len(leaks) > _SHOWN:
            print_line(f"  and {len(leaks) - _SHOWN} more; --json lists all")
    if leaks:
        raise typer.Exit(1)
