"""`olt clip`: build four-camera clips from recordings, look into a store of them, and score them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from olt_toolkit.clips.estimators import DepthChoice, PoseChoice, SourceChoice
from olt_toolkit.commands.clip_options import (
    AllFramesOption,
    CameraHeightOption,
    DepthOption,
    DepthWeightsOption,
    DeviceOption,
    DurationOption,
    FovOption,
    HeightOption,
    JsonOption,
    MapAnythingOption,
    PosesOption,
    StoreArgument,
    WidthOption,
    make_open_options,
)
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.commands.trajectory import trajectory
from olt_toolkit.runtime.workers import Engine

if TYPE_CHECKING:
    from olt_toolkit.clips.build_job import BuildJob
    from olt_toolkit.clips.builder import BuiltClip
    from olt_toolkit.clips.store import ClipStore
    from olt_toolkit.clips.views import BuildOptions
    from olt_toolkit.recordings.recording import Recording

app = typer.Typer(add_completion=False, no_args_is_help=True, help="Build, inspect and score clips.")
app.command(help="Recover the motion of a recording, and hold it against the reference.")(trajectory)


@app.command(help="Build the clip of a recording, or of each recording in a folder, and add it to a store.")
def build(
    recording: Annotated[Path, typer.Argument(metavar="INPUT", help="A video, a drive folder, or a folder of them.")],
    out: Annotated[Path, typer.Option(help="Folder of the clip store; it is made if it is missing.")],
    name: Annotated[str | None, typer.Option(help="Name of the clip; that of the recording by default.")] = None,
    category: Annotated[str | None, typer.Option(help="Long-tail category, or nominal; unlabelled by default.")] = None,
    factor: Annotated[list[str] | None, typer.Option(help="A scene factor; repeat for more than one.")] = None,
    fov: FovOption = None,
    camera_height: CameraHeightOption = None,
    width: WidthOption = 576,
    height: HeightOption = 320,
    duration: DurationOption = 20.0,
    all_frames: AllFramesOption = False,
    poses: PosesOption = PoseChoice.ODOMETRY,
    mapanything_weights: MapAnythingOption = None,
    depth: DepthOption = DepthChoice.GEOMETRIC,
    depth_weights: DepthWeightsOption = None,
    device: DeviceOption = "cpu",
    seed: Annotated[int, typer.Option(help="Seed of the clip.")] = 0,
    workers: WorkersOption = None,
    engine: EngineOption = Engine.LOCAL,
    keep_going: Annotated[bool, typer.Option("--keep-going", help="Go on after a recording that fails.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Recording to trajectory, distance and views; then clips in the store and pictures beside them."""
    from olt_generator.errors import InputError
    from olt_generator.files import make_folder
    from olt_toolkit.clips.build_job import BuildJob, find_recordings
    from olt_toolkit.clips.views import BuildOptions
    from olt_toolkit.recordings.labels import UNLABELLED
    from olt_toolkit.recordings.recording import is_recording

    if name is not None and Path(name).name != name:
        raise InputError(f"--name {name!r}: pictures are named after the clip; give a name without slashes")
    sources = SourceChoice(poses, mapanything_weights, depth, depth_weights, device)
    options = BuildOptions(
        width=width,
        height=height,
        frames="all" if all_frames else "grid",
        name=name,
        category=category or UNLABELLED,
        factors=tuple(factor or ()),
        seed=seed,
    )
    opening = make_open_options(duration, fov, camera_height)
    job = BuildJob(recording, make_folder(out), opening, options, sources, keep_going)
    if is_recording(recording) or not recording.is_dir():
        _build_one(job, as_json)
    elif name is not None:
        raise InputError(f"--name {name!r}: clips of a folder take the names of their recordings; leave --name out")
    else:
        _build_all(job, find_recordings(recording), workers, engine, as_json)


@app.command(help="Make single views of a recording, or further views of a stored clip, as video files.")
def views(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="A recording, or a clip store.")],
    cameras: Annotated[str, typer.Option(help="Views, with commas: cross_left, front_tele, rear_tele, ...")],
    out: Annotated[Path, typer.Option(help="Folder for the videos, the pictures and plan.json.")],
    clip: Annotated[str | None, typer.Argument(help="Name or id of a clip, where INPUT is a store.")] = None,
    fov: FovOption = None,
    camera_height: CameraHeightOption = None,
    width: WidthOption = 576,
    height: HeightOption = 320,
    duration: DurationOption = 20.0,
    all_frames: AllFramesOption = False,
    poses: PosesOption = PoseChoice.ODOMETRY,
    mapanything_weights: MapAnythingOption = None,
    depth: DepthOption = DepthChoice.GEOMETRIC,
    depth_weights: DepthWeightsOption = None,
    device: DeviceOption = "cpu",
    as_json: JsonOption = False,
) -> None:
    """Only the wanted views and those they are made from; the rest is named as left out."""
    from olt_toolkit.clips.view_files import leave_out_motion, parse_cameras, write_view_files
    from olt_toolkit.clips.views import BuildOptions
    from olt_toolkit.commands.clip_output import print_plan
    from olt_toolkit.recordings.recording import open_recording
    from olt_toolkit.runtime.console import print_json

    wanted = parse_cameras(cameras)
    sources = SourceChoice(poses, mapanything_weights, depth, depth_weights, device)
    options = BuildOptions(
        width=width,
        height=height,
        cameras=wanted,
        frames="all" if all_frames else "grid",
        use_reference_motion=clip is not None,
    )
    opening = make_open_options(duration, fov, camera_height)
    recording = open_recording(source, opening) if clip is None else _stored_recording(source, clip)
    options = leave_out_motion(recording, sources.apply(options))
    plan = write_view_files(out, _build_with_progress(recording, options))
    if as_json:
        print_json(plan)
    else:
        print_plan(plan, out)


@app.command(help="List the clips of a store, or show one of them.")
def inspect(
    store: StoreArgument,
    clip: Annotated[str | None, typer.Argument(help="Name or id of a clip; all are listed without it.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for a contact sheet and an animated preview.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the clip table, or one clip with its motion and calibration as they are stored."""
    from olt_generator.errors import InputError
    from olt_toolkit.clips.store import ClipStore
    from olt_toolkit.clips.summary import summarize_info, summarize_stored
    from olt_toolkit.commands.clip_output import print_clip, print_clips
    from olt_toolkit.runtime.console import print_json

    opened = ClipStore(store)
    if clip is None and pictures is not None:
        raise InputError("--pictures: name the clip to draw")
    if clip is None:
        summary: dict[str, Any] = {"store": str(store), "clips": [summarize_info(info) for info in opened.clips()]}
        print_json(summary) if as_json else print_clips(summary)
        return
    clip_id = opened.find(clip)
    summary = summarize_stored(opened, clip_id)
    if pictures is not None:
        summary["pictures"] = _draw_stored(opened, clip_id, pictures)
    print_json(summary) if as_json else print_clip(summary)


@app.command(help="Score the views of a clip: GeoKPM, and errors against a reference clip.")
def score(
    store: StoreArgument,
    clip: Annotated[str, typer.Argument(help="Name or id of the clip.")],
    reference: Annotated[str | None, typer.Option(help="Name or id of a clip with the true views.")] = None,
    reference_store: Annotated[Path | None, typer.Option(help="Store of the reference; STORE by default.")] = None,
    moments: Annotated[int, typer.Option(min=1, help="Moments that GeoKPM looks at, spread evenly.")] = 41,
    loftr_weights: Annotated[Path | None, typer.Option(help="loftr_outdoor.ckpt; without it, SIFT matches.")] = None,
    lpips_weights: Annotated[
        Path | None, typer.Option(help="Folder with alexnet-owt-7be5be79.pth and alex.pth; without it, no LPIPS.")
    ] = None,
    device: DeviceOption = "cpu",
    as_json: JsonOption = False,
) -> None:
    """The matcher is named in the result, because numbers of two matchers do not compare."""
    from olt_generator.errors import InputError
    from olt_toolkit.clips.score import open_lpips, open_matcher, score_against, score_consistency
    from olt_toolkit.clips.store import ClipStore
    from olt_toolkit.commands.clip_output import print_scores
    from olt_toolkit.runtime.console import make_progress, print_json

    if reference is None and (reference_store is not None or lpips_weights is not None):
        raise InputError("--reference is missing: the true views are needed to compare with")
    opened, truth = ClipStore(store), ClipStore(reference_store or store)
    clip_id = opened.find(clip)
    reference_id = None if reference is None else truth.find(reference)
    matcher, lpips = open_matcher(loftr_weights, device), open_lpips(lpips_weights, device)
    with make_progress() as progress:
        task = progress.add_task("GeoKPM", total=100)
        consistency = score_consistency(
            opened, clip_id, matcher, moments, lambda share: progress.update(task, completed=round(100 * share))
        )
    errors = None if reference_id is None else score_against(opened, clip_id, truth, reference_id, lpips)
    summary = {"store": str(store), "clip_id": clip_id, "geokpm": consistency, "reference": errors}
    print_json(summary) if as_json else print_scores(summary)


def _build_one(job: "BuildJob", as_json: bool) -> None:
    import time

    from olt_generator.errors import InputError
    from olt_toolkit.clips.build_job import prepare_clip
    from olt_toolkit.clips.builder import clip_id_of
    from olt_toolkit.clips.store import ClipStore
    from olt_toolkit.commands.clip_output import print_build
    from olt_toolkit.recordings.recording import open_recording
    from olt_toolkit.runtime.console import make_progress, print_json

    recording, store = open_recording(job.path, job.opening), ClipStore(job.store)
    if clip_id_of(recording, job.options) in store:
        name = job.options.name or recording.name
        raise InputError(f"{store.root}: already holds the clip {name!r}; give another --name, --seed or --out")
    with make_progress() as progress:
        task = progress.add_task("clip", total=100)
        summary = prepare_clip(
            job,
            recording,
            lambda share: progress.update(task, completed=round(100 * share)),
            lambda step: progress.update(task, description=f"clip: {step}"),
        )
        progress.update(task, completed=100, description="clip: store")
        start = time.perf_counter()
        store.commit([summary["clip"]["clip_id"]])
    summary["store_seconds"]["commit"] = time.perf_counter() - start
    print_json(summary) if as_json else print_build(summary)


def _build_all(job: "BuildJob", recordings: list[Path], workers: int | None, engine: Engine, as_json: bool) -> None:
    from dataclasses import asdict, replace

    from olt_generator.errors import InputError
    from olt_toolkit.clips.build_job import build_clips
    from olt_toolkit.commands.clip_output import print_outcomes
    from olt_toolkit.runtime.console import make_progress, print_json
    from olt_toolkit.runtime.workers import default_workers

    jobs = [replace(job, path=path) for path in recordings]
    with make_progress() as progress:
        task = progress.add_task("clips", total=len(jobs))
        outcomes = build_clips(
            jobs,
            workers or default_workers(),
            lambda share: progress.update(task, completed=round(share * len(jobs))),
            engine,
        )
    if as_json:
        print_json(
            {"store": str(job.store), "recordings": [asdict(each) | {"path": str(each.path)} for each in outcomes]}
        )
    else:
        print_outcomes(outcomes, job.store)
    failed = sum(outcome.state == "failed" for outcome in outcomes)
    if failed:
        raise InputError(f"{failed} of {len(outcomes)} recordings could not be used; the others are in {job.store}")


def _build_with_progress(recording: "Recording", options: "BuildOptions") -> "BuiltClip":
    from olt_toolkit.clips.builder import build_clip
    from olt_toolkit.runtime.console import make_progress

    with make_progress() as progress:
        task = progress.add_task("views", total=100)
        built = build_clip(
            recording,
            options,
            on_progress=lambda share: progress.update(task, completed=round(100 * share)),
            on_step=lambda step: progress.update(task, description=f"views: {step}"),
        )
        progress.update(task, completed=100)  # stages that were left out count as done
    return built


def _stored_recording(root: Path, clip: str) -> "Recording":
    from olt_toolkit.clips.store import ClipStore
    from olt_toolkit.clips.view_files import reopen_clip

    store = ClipStore(root)
    return reopen_clip(store, store.find(clip))


def _draw_stored(store: "ClipStore", clip_id: str, folder: Path) -> dict[str, str]:
    from olt_toolkit.clips.pictures import write_clip_pictures

    info = store.info(clip_id)
    times_us = {name: store.read_timestamps(clip_id, name) for name in info.views}
    shown_us = next(iter(times_us.values()))
    shown_us = shown_us[
        (shown_us >= max(times[0] for times in times_us.values()))
        & (shown_us <= min(times[-1] for times in times_us.values()))
    ]
    images = {name: store.read_frames(clip_id, name, shown_us)[0] for name in info.views}
    return write_clip_pictures(folder, info.name, images, {}, shown_us)
