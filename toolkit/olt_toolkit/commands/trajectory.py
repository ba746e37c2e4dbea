"""`olt clip trajectory`: the motion of a recording, how well it is known, and how far it is from the truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from olt_toolkit.clips.pose_choices import PoseFormat, PoseOf
from olt_toolkit.commands.clip_options import CacheOption, CameraOptions, DurationOption, JsonOption

if TYPE_CHECKING:
    from olt_toolkit.clips.trajectory_errors import ClipMotion

# Head of each column, and where its number is found among those of a clip; what is not known says so.
_CLIP = {"first frame": ("first_frame",)}
_ERRORS = _CLIP | {
    "frames": ("frames",),
    "length m": ("path_length_m",),
    "ATE m": ("errors", "metric", "ate_m"),
    "sigma m": ("ate_sigma_m",),
    "z": ("ate_z",),
    "scale error": ("scale_error",),
    "sigma": ("scale_sigma",),
    "z ": ("scale_z",),
    "Sim(3) ATE m": ("errors", "sim3", "ate_m"),
    "step %": ("errors", "metric", "step_translation_percent"),
    "rotation by step deg": ("errors", "metric", "step_rotation_deg"),
}
_SMOOTHING = _CLIP | {
    "jerk² factor": ("jerk_factor",),
    "acc. var. factor": ("acceleration_variance_factor",),
    "acc. var. m2/s4": ("smoothness", "acceleration_variance_m2_s4"),
    "truth smoothed alike": ("smoothness_of_reference_smoothed", "acceleration_variance_m2_s4"),
    "truth": ("smoothness_of_reference", "acceleration_variance_m2_s4"),
}
_LABELS = _CLIP | {
    f"{head} {label}": ("label_noise", part, key)
    for label, key in (("acc. m/s2", "acceleration"), ("curv. 1/m", "curvature"))
    for head, part in (("expected", "expected"), ("actual", "actual"))
}


def trajectory(
    recording: Annotated[Path, typer.Argument(metavar="INPUT", help="A video or a drive folder.")],
    camera: CameraOptions,
    clip_frames: Annotated[int | None, typer.Option(min=2, help="Cut into clips of so many frames.")] = None,
    stride: Annotated[
        int | None, typer.Option(min=1, help="Frames from one clip to the next; by default a clip long.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write the smoothed poses here; of clips, each into a file of its own.")
    ] = None,
    format_: Annotated[
        PoseFormat | None, typer.Option("--format", help="Of that file; by default what its extension says.")
    ] = None,
    of: Annotated[
        PoseOf | None, typer.Option(help="Whose poses; by default the camera's for KITTI's format, else the rig's.")
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
    """Recover and smooth the motion, clip by clip, say how far it may be off, and hold it against the reference."""
    from math import radians

    from olt_toolkit.clips.pose_choices import choose_format, choose_poses
    from olt_toolkit.clips.trajectory_errors import Jitter, draw_motions, measure_clips, summarize_clips
    from olt_toolkit.recordings.drives import open_recording
    from olt_toolkit.recordings.recording import refuse_unused
    from olt_toolkit.runtime.console import print_json, show_progress

    if out is None:
        refuse_unused({"--format": format_ is not None, "--of": of is not None}, "no poses are written without --out")
    format_ = None if out is None else choose_format(out, format_)
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
    if out is not None and format_ is not None:
        whose = choose_poses(format_, of)
        files = _write_files(out, format_, whose, motions, opened.name, cut=clip_frames is not None)
        result["poses"] = {"files": files, "format": format_.value, "of": whose.value}
    if as_json:
        print_json(result)
    else:
        _print_result(result)


def _write_files(
    out: Path, format_: PoseFormat, of: PoseOf, motions: "list[ClipMotion]", recording: str, cut: bool
) -> list[str]:
    """Write a file for each motion, named after its first frame where a recording was cut into clips."""
    from olt_toolkit.clips.trajectory_files import describe_poses, write_poses

    files = []
    for motion in motions:
        path = out.with_name(f"{out.stem}_{motion.first:06d}{out.suffix}") if cut else out
        write_poses(path, format_, describe_poses(motion, of, recording))
        files.append(str(path))
    return files


def _print_result(result: dict[str, Any]) -> None:
    from olt_toolkit.commands.clip_output import word_scale
    from olt_toolkit.runtime.console import print_line

    clips = result["clips"]
    _print_numbers(f"Motion of {result['recording']}", clips, _ERRORS)
    _print_numbers("Smoothing", clips, _SMOOTHING)
    _print_numbers("Noise of the policy's labels, RMS", clips, _LABELS)
    summary = result["summary"]
    if summary["mean_ate_m"] is not None:
        print_line(
            f"clips: {summary['clips']}, ATE {summary['mean_ate_m']:.2f} m (worst {summary['worst_ate_m']:.2f} m), "
            f"translation by step {summary['mean_step_translation_percent']:.2f} %"
        )
    for clip in clips:
        print_line(f"scale of the clip from frame {clip['first_frame']}: {word_scale(clip['scale_sigma_parts'])}")
        for doubt in clip["doubts"]:
            print_line(f"in doubt, clip from frame {clip['first_frame']}: {doubt['what']}: {doubt['why']}")
    if not any(clip["doubts"] for clip in clips):
        print_line("nothing is in doubt")
    for assumption in result["assumptions"]:
        print_line(f"assumed: {assumption}")
    if "picture" in result:
        print_line(f"picture: {result['picture']}")
    if "poses" in result:
        poses = result["poses"]
        known = any(clip["ate_sigma_m"] is not None for clip in clips)
        covariance = "with covariance" if known else "covariance is not known"
        if poses["format"] != PoseFormat.PARQUET:
            covariance = "without covariance, which only Parquet holds"
        print_line(f"poses of the {poses['of']} as {poses['format']}, {covariance}: {', '.join(poses['files'])}")


def _print_numbers(title: str, clips: list[dict[str, Any]], columns: dict[str, tuple[str, ...]]) -> None:
    from olt_toolkit.commands.clip_output import find_number
    from olt_toolkit.runtime.console import print_table

    rows = []
    for clip in clips:
        cells = [find_number(clip, *keys) for keys in columns.values()]
        rows.append(["not known" if cell is None else cell for cell in cells])
    print_table(title, list(columns), rows)
