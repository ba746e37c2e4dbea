"""`olt mix align`: which sources a target slice asks for."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from olt_toolkit.commands.clip_options import JsonOption

if TYPE_CHECKING:
    from olt_datasets.mixtures.selection import ClipTable
    from olt_datasets.mixtures.source_alignment import Gap, SourceAlignment


def align(
    tables: Annotated[
        list[Path] | None, typer.Argument(metavar="TABLE...", help="Clip stores, or tables of indexed clips.")
    ] = None,
    target: Annotated[
        str | None, typer.Option(help="Filter of the target slice, as in recipes: '{category: [cyclists]}'.")
    ] = None,
    target_split: Annotated[str, typer.Option(help="Split that the target slice is taken from.")] = "test",
    target_weights: Annotated[
        str | None, typer.Option(help="Instead of a slice, the target by hand: FACTOR=WEIGHT,FACTOR=WEIGHT.")
    ] = None,
    where: Annotated[str, typer.Option(help="Filter of the clips that sources may give.")] = "{}",
    split: Annotated[str, typer.Option(help="Split that sources may give clips from.")] = "train",
    by: Annotated[str, typer.Option(help="What is compared: factors, category or country.")] = "factors",
    samples: Annotated[int | None, typer.Option(min=1, help="Clips to be taken, none of them twice.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the intervals.")] = 0,
    example: Annotated[bool, typer.Option("--example", help="Show the paper's counts instead of tables.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Compare how sources cover a target slice, and propose shares of them that come closest to it.

    `olt mix align --example` shows what the paper found: Waymo E2E has none of NV's human-guided traffic control.
    """
    from olt_datasets.mixtures.source_alignment import PAPER_COVERAGE, align_sources, measure_coverage
    from olt_datasets.tables.clip_frame import scan_clip_tables
    from olt_generator.errors import InputError
    from olt_toolkit.runtime.console import print_json

    if example:
        found = align_sources(PAPER_COVERAGE, PAPER_COVERAGE["nv"], samples=samples, seed=seed)
    else:
        if not tables or (target is None) == (target_weights is None):
            raise InputError("olt mix align: give TABLE and one of --target and --target-weights, or --example")
        if by not in ("factors", "category", "country"):
            raise InputError(f"--by is {by!r}; it must be factors, category or country")
        clips = scan_clip_tables(tables)
        coverage = measure_coverage(_slice(clips, split, where, "--where"), by)
        if target is not None:
            slices = measure_coverage(_slice(clips, target_split, target, "--target"), by)
            pooled = dict(sum(map(Counter, slices.values()), Counter()))
            found = align_sources(coverage, pooled, target_is_sample=True, samples=samples, seed=seed)
        else:
            found = align_sources(coverage, _read_weights(str(target_weights)), samples=samples, seed=seed)
    if as_json:
        print_json(asdict(found))
    else:
        _show(found)


def _slice(clips: "ClipTable", split: str, text: str, where: str) -> "ClipTable":
    import polars as pl

    from olt_datasets.mixtures.recipe import parse_filter
    from olt_datasets.mixtures.selection import matches

    return clips.lazy().filter((pl.col("split") == split) & matches(parse_filter(text, where)))


def _read_weights(text: str) -> dict[str, float]:
    import math

    from olt_generator.errors import InputError

    weights = {}
    for part in text.split(","):
        name, _, number = part.partition("=")
        try:
            weights[name.strip()] = float(number)
        except ValueError:
            weights[name.strip()] = math.nan
        if not name.strip() or not 0.0 <= weights[name.strip()] < math.inf:
            raise InputError(f"--target-weights: {part!r}: write FACTOR=WEIGHT with a weight that is not negative")
    return weights


def _show(found: "SourceAlignment") -> None:
    from olt_datasets.mixtures.source_alignment import word_missing_factor
    from olt_toolkit.runtime.console import print_line, print_table

    factors = list(found.target)
    rows: list[list[Any]] = [
        [source.name, *(f"{found.coverage[source.name][factor]:g}" for factor in factors)] for source in found.sources
    ]
    rows.append(["target", *(f"{share:.1%}" for share in found.target.values())])
    print_table("Clips by source", ("source", *factors), rows)
    gaps = [(source.name, f"{source.clips:g}", *_cells(source.gap), f"{source.share:.1%}") for source in found.sources]
    gaps.append(("all clips together", "", *_cells(found.pooled_gap), ""))
    gaps.append(("proposed shares", "", *_cells(found.proposed_gap), ""))
    print_table("Alignment gap", ("source", "clips", "gap", "95 %", "proposed share"), gaps)
    for missing in found.missing:
        print_line(word_missing_factor(missing))


def _cells(gap: "Gap") -> tuple[str, str]:
    return f"{gap.median:.3f}", f"{gap.low:.3f} - {gap.high:.3f}"
