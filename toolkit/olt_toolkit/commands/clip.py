"""`olt clip`: build four-camera clips from recordings, and look into a store of them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from olt_toolkit.clip_builder import BuildOptions, BuiltClip
    from olt_toolkit.clip_store import ClipStore
    from olt_toolkit.recording import Recording

app = typer.Typer(add_completion=False, no_args_is_help=True, help="Build clips from recordings, and inspect them.")

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


@app.command(help="Build the clip of one recording and add it to a store.")
def build(
    recording: Annotated[Path, typer.Argument(metavar="INPUT", help="A video file or a drive folder.")],
    out: Annotated[Path, typer.Option(help="Folder of the clip store; it is made if it is missing.")],
    name: Annotated[str | None, typer.Option(help="Name of the clip; that of the recording by default.")] = None,
    fov: Annotated[float | None, typer.Option(help="Horizontal field of view in degrees, if not calibrated.")] = None,
    camera_height: Annotated[float | None, typer.Option(help="Height of the camera in metres, if unknown.")] = None,
    width: Annotated[int, typer.Option(min=32, help="Width of the views in pixels, even.")] = 576,
    height: Annotated[int, typer.Option(min=32, help="Height of the views in pixels, even.")] = 320,
    duration: Annotated[float, typer.Option(min=0.1, help="Use at most this many seconds.")] = 20.0,
    all_frames: Annotated[bool, typer.Option("--all-frames", help="Make frames that no sample shows too.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the clip.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Recording to trajectory, distance and four views; then one clip in the store and a contact sheet beside it."""
    from math import radians

    from olt_generator.errors import InputError
    from olt_generator.files import make_folder
    from olt_toolkit.clip_builder import BuildOptions
    from olt_toolkit.clip_store import ClipStore
    from olt_toolkit.clip_summary import summarize_build
    from olt_toolkit.console import print_json
    from olt_toolkit.recording import OpenOptions, open_recording

    if name is not None and Path(name).name != name:
        raise InputError(f"--name {name!r}: pictures are named after the clip; give a name without slashes")
    store = ClipStore(make_folder(out))
    field_of_view = None if fov is None else radians(fov)
    opened = open_recording(
        recording, OpenOptions(duration=duration, horizontal_fov=field_of_view, camera_height=camera_height)
    )
    options = BuildOptions(width=width, height=height, all_frames=all_frames, name=name, seed=seed)
    built, stored = _build_and_store(opened, options, store)
    summary = summarize_build(built) | stored
    if as_json:
        print_json(summary)
    else:
        _print_summary(summary)


@app.command(help="List the clips of a store, or show one of them.")
def inspect(
    store: Annotated[Path, typer.Argument(help="Folder of the clip store.")],
    clip_id: Annotated[str | None, typer.Argument(help="Clip to show; all are listed without it.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the clip table, or one clip with its motion and calibration as they are stored."""
    from olt_toolkit.clip_store import ClipStore
    from olt_toolkit.console import print_json

    opened = ClipStore(store)
    if clip_id is None:
        summary = _list_clips(opened)
        if as_json:
            print_json(summary)
        else:
            _print_clips(summary)
        return
    summary = _show_clip(opened, clip_id)
    if as_json:
        print_json(summary)
    else:
        _print_clip(summary)


def _build_and_store(
    recording: "Recording", options: "BuildOptions", store: "ClipStore"
) -> "tuple[BuiltClip, dict[str, Any]]":
    import time

    from olt_generator.errors import InputError
    from olt_toolkit.clip_builder import build_clip, clip_id_of
    from olt_toolkit.console import make_progress

    if clip_id_of(recording, options) in store:
        name = options.name or recording.name
        raise InputError(f"{store.root}: already holds the clip {name!r}; give another --name, --seed or --out")
    with make_progress() as progress:
        task = progress.add_task("clip", total=100)
        built = build_clip(
            recording,
            options,
            on_progress=lambda share: progress.update(task, completed=round(100 * share)),
            on_stage=lambda stage: progress.update(task, description=f"clip: {stage}"),
        )
        progress.update(task, description="clip: store")
        start = time.perf_counter()
        store.stage(built.clip)
        staged = time.perf_counter()
        # Pictures before the commit: whatever is interrupted, a second run then makes all of it.
        preview = _write_preview(built, store.root)
        before_commit = time.perf_counter()
        store.commit([built.clip.clip_id])
    seconds = {"stage": staged - start, "commit": time.perf_counter() - before_commit}
    return built, {"store_seconds": seconds, "preview": str(preview)}


def _write_preview(built: "BuiltClip", out: Path) -> Path:
    from olt_toolkit.pictures import contact_sheet, write_picture

    path = out / "previews" / f"{built.clip.name}.png"
    streams = built.clip.streams
    times = next(iter(streams.values())).timestamps_us
    images = {name: stream.frames for name, stream in streams.items()}
    write_picture(path, contact_sheet(images, built.observed, times))
    return path


def _print_summary(summary: dict[str, Any]) -> None:
    from olt_toolkit.console import print_line, print_table

    clip, trajectory = summary["clip"], summary["trajectory"]
    print_line(f"clip {clip['name']} ({clip['kind']}) {clip['clip_id']}")
    print_line(
        f"trajectory: {trajectory['length']:.1f} m in {trajectory['duration']:.1f} s, speed "
        f"{trajectory['lowest_speed']:.1f} to {trajectory['highest_speed']:.1f} m/s"
    )
    print_table(
        "Errors against the reference, and jerk", ["quantity", "before smoothing", "after"], _error_rows(summary)
    )
    print_table("Views", ["view", "kind", "observed", "invented", "PSNR dB", "PSNR dB, observed"], _view_rows(summary))
    seconds = summary["seconds"] | summary["store_seconds"]
    print_table("Run time", ["stage", "seconds"], list(seconds.items()))
    for part, reason in summary["left_out"].items():
        print_line(f"left out: {part}: {reason}")
    for assumption in summary["assumptions"]:
        print_line(f"assumed: {assumption}")
    print_line(_sample_line(clip))
    print_line(f"pictures: {summary['preview']}")


# Label, and where the number is found in the pose errors.
_POSE_ROWS = (
    ("ATE (m)", ("metric", "ate_m")),
    ("rotation to first pose (deg)", ("metric", "rotation_to_first_deg")),
    ("rotation by step (deg)", ("metric", "step_rotation_deg")),
    ("translation by step (%)", ("metric", "step_translation_percent")),
    ("drift at the end (%)", ("metric", "drift_percent")),
    ("ATE after Sim(3) alignment (m)", ("sim3", "ate_m")),
    ("scale of the Sim(3) alignment", ("sim3", "scale")),
)


def _error_rows(summary: dict[str, Any]) -> list[tuple[object, ...]]:
    before, after = summary["pose_errors_before_smoothing"], summary["pose_errors"]
    rows: list[tuple[object, ...]] = [(label, _find(before, keys), _find(after, keys)) for label, keys in _POSE_ROWS]
    before, after = summary["smoothness_before_smoothing"], summary["smoothness"]
    rows.append(("jerk, RMS (m/s3)", _find(before, ("jerk_rms_m_s3",)), _find(after, ("jerk_rms_m_s3",))))
    rows.append(("scale, 1 sigma relative", summary["scale_sigma"], ""))
    rows.append(("distance, median relative error", "", summary["distance_median_relative_error"]))
    return rows


def _find(numbers: dict[str, Any] | None, keys: tuple[str, ...]) -> object:
    """A number in nested dictionaries, None where a level of them is None."""
    found: Any = numbers
    for key in keys:
        found = None if found is None else found[key]
    return found


def _view_rows(summary: dict[str, Any]) -> list[tuple[object, ...]]:
    rows = []
    for name, view in summary["clip"]["views"].items():
        errors = summary["view_errors"].get(name, {}) if view["kind"] == "warped" else {"psnr": "", "psnr_observed": ""}
        shares = (f"{100 * view['observed_share']:.1f} %", f"{100 * view['invented_share']:.1f} %")
        rows.append((name, view["kind"], *shares, errors.get("psnr"), errors.get("psnr_observed")))
    return rows


def _sample_line(clip: dict[str, Any]) -> str:
    times = clip["sample_t0_us"]
    if not times:
        return f"no policy sample: {clip['no_sample_reason']}"
    return f"policy samples: {len(times)}, t0 = {times[0] / 1e6:.1f} to {times[-1] / 1e6:.1f} s"


def _list_clips(store: "ClipStore") -> dict[str, Any]:
    from olt_toolkit.clip_summary import summarize_info

    return {"store": str(store.root), "clips": [summarize_info(info) for info in store.clips()]}


def _show_clip(store: "ClipStore", clip_id: str) -> dict[str, Any]:
    from dataclasses import asdict

    from olt_toolkit.clip_summary import summarize_info, summarize_motion

    info = store.info(clip_id)
    cameras = {}
    for name in info.views:
        mounted, times = store.read_camera(clip_id, name), store.read_timestamps(clip_id, name)
        cameras[name] = {
            "size": [mounted.camera.width, mounted.camera.height],
            "position_rig": mounted.T_rig_camera[:3, 3].tolist(),
            "frames": len(times),
            "first_us": int(times[0]),
            "last_us": int(times[-1]),
        }
    return {
        "store": str(store.root),
        "clip": summarize_info(info),
        "trajectory": summarize_motion(store.read_ego_motion(clip_id)),
        "vehicle": asdict(store.read_vehicle(clip_id)),
        "cameras": cameras,
    }


def _print_clips(summary: dict[str, Any]) -> None:
    from olt_toolkit.console import print_table

    rows = [
        (clip["clip_id"], clip["name"], clip["kind"], clip["category"], clip["split"], _sample_line(clip))
        for clip in summary["clips"]
    ]
    print_table(f"Clips in {summary['store']}", ["clip", "name", "kind", "category", "split", "samples"], rows)


def _print_clip(summary: dict[str, Any]) -> None:
    from olt_toolkit.console import print_line, print_table

    clip, trajectory = summary["clip"], summary["trajectory"]
    print_line(f"clip {clip['name']} ({clip['kind']}, {clip['category']}, {clip['split']}) {clip['clip_id']}")
    print_line(f"trajectory: {trajectory['length']:.1f} m in {trajectory['duration']:.1f} s")
    print_line(_sample_line(clip))
    rows = [
        (
            name,
            clip["views"][name]["kind"],
            "x".join(str(side) for side in camera["size"]),
            camera["frames"],
            f"{camera['first_us'] / 1e6:.2f} to {camera['last_us'] / 1e6:.2f} s",
            f"{100 * clip['views'][name]['invented_share']:.1f} %",
        )
        for name, camera in summary["cameras"].items()
    ]
    print_table("Cameras", ["camera", "kind", "size", "frames", "times", "invented"], rows)
