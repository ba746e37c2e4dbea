"""`olt demo`: the main job, from one front-camera video to a closed-loop score."""

from pathlib import Path
from typing import Annotated

import typer

from olt_toolkit.commands.clip_options import CameraOptions, unpack_options

app = typer.Typer(add_completion=False)


@app.command(help="Run the main job: one front video to four views, two mixtures, two policies, closed-loop scores.")
@unpack_options
def demo(
    out: Annotated[Path, typer.Option(help="Folder of the run; an interrupted run there goes on.")] = Path("runs/demo"),
    video: Annotated[
        Path | None, typer.Option(help="A front-camera video; without it a drive of the synthetic world is taken.")
    ] = None,
    *,
    camera: CameraOptions,
    seed: Annotated[int, typer.Option(min=0, help="The one seed of the run.")] = 0,
    quick: Annotated[
        bool, typer.Option("--quick", help="A small run that shows every step; its scores tell nothing.")
    ] = False,
    workers: Annotated[int, typer.Option(min=0, help="Processes; 0 for one per core. Results are the same.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as one JSON object.")] = False,
) -> None:
    """Run the main job and print the score table and the path of the report."""
    from olt_generator.errors import InputError
    from olt_sft_recipes.demo.main_job import DemoSettings, run_demo
    from olt_sft_recipes.demo.report import REPORT, SCORE_COLUMNS, score_rows, word_verdict
    from olt_toolkit.runtime.console import print_json, print_line, print_table

    if video is None and camera != CameraOptions():
        names = ", ".join(name for name, is_given in camera.given().items() if is_given)
        raise InputError(f"olt demo: {names} tell of a --video; give one, or leave them out")
    opening = camera.opening()
    settings = DemoSettings(
        seed=seed,
        video_fov=opening.horizontal_fov,
        video_camera_height=opening.camera_height,
        video_rotate=opening.rotate,
        video_mirror=opening.mirror,
    )
    summary = run_demo(out, settings.quick() if quick else settings, video, workers)
    if as_json:
        print_json(summary)
        return
    print_line(word_verdict(summary))
    print_table("Closed-loop scores on held-out long-tail scenes", SCORE_COLUMNS, score_rows(summary))
    print_line(f"report: {out / REPORT}")
