"""`olt clip trajectory`: the motion of a recording and how far it is from the truth."""

from pathlib import Path
from typing import Annotated, Any

import typer

from olt_toolkit.commands.clip_options import CacheOption, CameraOptions, DurationOption, JsonOption

# Head of each column, and where its number is found among those of a clip.
_COLUMNS = {
    "first frame": ("first_frame",),
    "frames": ("frames",),
    "length m": ("path_length_m",),
    "scale 1 sigma": ("scale_sigma",),
    "ATE m": ("errors", "metric", "ate_m"),
    "step %": ("errors", "metric", "step_translation_percent"),
    "rotation by step deg": ("errors", "metric", "step_rotation_deg"),
    "Sim(3) ATE m": ("errors", "sim3", "ate_m"),
    "jerk² factor": ("jerk_factor",),
    "acc. var. factor": ("acceleration_variance_factor",),
    "label acc. m/s2": ("label_noise", "actual", "acceleration"),
}


def trajectory(
    recording: Annotated[Path, typer.Argument(metavar="INPUT", help="A video or a drive folder.")],
    camera: CameraOptions,
    clip_frames: Annotated[int | None, typer.Option(min=2, help="Cut into clips of so many frames.")] = None,
    stride: Annotated[
        int | None, typer.Option(min=1, help="Frames from one clip to the next; by default a clip long.")
    ] = None,
    jitter_m: Annotated[
        float | None, typer.Option(min=0.0, help="Smooth the reference with so much noise instead, metres an axis.")
    ] = None,
    jitter_deg: Annotated[float, typer.Option(min=0.0, help="Noise of its rotation, degrees an axis.")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of that noise.")] = 0,
    picture: Annotated[Path | None, typer.Option(help="Draw path and acceleration into this PNG file.")] = None,
    duration: DurationOption = 20.0,
    cache: CacheOption = None,
    as_json: JsonOption = False,
) -> None:
    """Recover and smooth the motion, clip by clip, and hold it against the reference where one is known."""
    from math import radians

    from olt_toolkit.clips.trajectory_errors import Jitter, draw_motions, measure_clips, summarize_clips
    from olt_toolkit.recordings.drives import open_recording
    from olt_toolkit.recordings.recording import refuse_unused
    from olt_toolkit.runtime.console import print_json, show_progress

    if jitter_m is None:
        refuse_unused(
            {"--jitter-deg": jitter_deg != 0.0, "--seed": seed != 0}, "nothing is disturbed without --jitter-m"
        )
    if clip_frames is None:
        refuse_unused({"--stride": stride is not None}, "the recording is one clip without --clip-frames")
    opened = open_recording(recording, camera.opening(duration), cache)
    jitter = None if jitter_m is None else Jitter(jitter_m, radians(jitter_deg), seed)
    with show_progress("trajectory") as (on_progress, _):
        motions = measure_clips(opened, clip_frames, stride, jitter, on_progress=on_progress)
    result = {
        "recording": opened.name,
        "reference": opened.reference is not None,
        "clips": [motion.to_dict() for motion in motions],
        "summary": summarize_clips(motions),
        "assumptions": list(opened.assumptions),
    }
    if picture is not None:
        draw_motions(picture, {f"clip from frame {motion.first}": motion for motion in motions})
        result["picture"] = str(picture)
    if as_json:
        print_json(result)
    else:
        _print_result(result)


def _print_result(result: dict[str, Any]) -> None:
    from olt_toolkit.commands.clip_output import find_number
    from olt_toolkit.runtime.console import print_line, print_table

    rows = [[find_number(clip, *keys) for keys in _COLUMNS.values()] for clip in result["clips"]]
    print_table(f"Motion of {result['recording']}", list(_COLUMNS), rows)
    summary = result["summary"]
    if summary["mean_ate_m"] is not None:
        print_line(
            f"{summary['clips']} clips: ATE {summary['mean_ate_m']:.2f} m (worst {summary['worst_ate_m']:.2f} m), "
            f"translation by step {summary['mean_step_translation_percent']:.2f} %"
        )
    for assumption in result["assumptions"]:
        print_line(f"assumed: {assumption}")
    if "picture" in result:
        print_line(f"picture: {result['picture']}")
