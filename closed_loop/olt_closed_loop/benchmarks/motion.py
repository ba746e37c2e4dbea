"""`olt bench motion`: how wrong, and how sure, the motion of hard clips and of given recordings is."""

from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(add_completion=False)

THUMBNAIL_WIDTH = 160
_COLUMNS = {
    "kind": "kind",
    "clips": "clips",
    "marked": "marked",
    "refused": "refused",
    "scale z": "scale_z_rms",
    "ATE z": "ate_z_rms",
    "ATE m": "ate_m_median",
    "worst m": "ate_m_worst",
    "z > 4": "beyond_limit_unmarked",
    "worst clip": "worst_clip",
    "its z": "worst_clip_z",
    "ms": "ms_per_frame",
}


@app.command()
def motion(
    count: Annotated[int, typer.Option(min=0, help="Hard clips, the kinds in turn; 0: recordings alone.")] = 200,
    seed: Annotated[int, typer.Option(help="Seed of the list of clips.")] = 0,
    kinds: Annotated[str | None, typer.Option(help="Only these kinds, with commas between them.")] = None,
    recording: Annotated[
        list[Path] | None, typer.Option(help="A video or a drive folder to measure as well; may be repeated.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; one for each processor by default.")] = None,
    cache: Annotated[Path | None, typer.Option(help="Folder that keeps filmed clips for the next time.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw error over sigma against kind into this PNG file.")] = None,
    sheet: Annotated[Path | None, typer.Option(help="Put frames of every clip into this PNG file.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Recover the motion of hard clips and hold its error against what it says of its own error, kind by kind."""
    from functools import partial

    from olt_closed_loop.benchmarks.motion_errors import measure_clip
    from olt_closed_loop.benchmarks.motion_tables import count_reasons, draw_scale_errors, summarize, write_sheet
    from olt_closed_loop.hard_clips.kinds import list_hard_clips
    from olt_generator.errors import InputError
    from olt_toolkit.runtime.console import print_json, show_progress
    from olt_toolkit.runtime.environment import describe_machine
    from olt_toolkit.runtime.workers import default_workers, map_parallel

    chosen = tuple(kinds.split(",")) if kinds else None
    sources = [*(list_hard_clips(count, seed, chosen) if count else []), *(recording or [])]
    if not sources:
        raise InputError("motion: nothing to measure; give --count above 0 or a --recording")
    measure = partial(measure_clip, cache=cache, thumbnail_width=THUMBNAIL_WIDTH if sheet else 0)
    with show_progress("bench motion", len(sources)) as (on_progress, _):
        measured = map_parallel(measure, sources, workers or default_workers(), on_progress)
    clips = [each.errors for each in measured]
    result = {
        "benchmark": "motion",
        "count": count,
        "seed": seed,
        "kinds": summarize(clips),
        "reasons": count_reasons(clips),
        "clips": [clip.to_dict() for clip in clips],
        "machine": describe_machine(),
    }
    if picture is not None:
        draw_scale_errors(picture, clips)
        result["picture"] = str(picture)
    if sheet is not None:
        write_sheet(sheet, measured)
        result["sheet"] = str(sheet)
    if as_json:
        print_json(result)
    else:
        _print_result(result)


def _print_result(result: dict[str, Any]) -> None:
    from olt_toolkit.runtime.console import print_line, print_table

    rows = [
        [
            "backwards" if key == "worst_clip_z" and row["worst_clip_backwards"] else row[key]
            for key in _COLUMNS.values()
        ]
        for row in result["kinds"]
    ]
    print_table("Motion of hard clips", list(_COLUMNS), rows)
    print_line(
        "z: error over stated sigma, root mean square of the clips that are not marked; z > 4: how many of those are "
        "beyond 4, or go backwards; ATE m: median; ms: processor time of a frame"
    )
    for outcome, reasons in result["reasons"].items():
        for reason, times in reasons.items():
            print_line(f"{outcome} {times}: {reason}")
    print_line(f"machine: {result['machine']['processor']}, {result['machine']['cores']} cores")
    for key in ("picture", "sheet"):
        if key in result:
            print_line(f"{key}: {result[key]}")
