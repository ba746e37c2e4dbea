"""`olt clip`: build four-camera clips from recordings, look into a store of them, and score them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from olt_toolkit.commands.clip_options import (
    AllFramesOption,
    BuildingOptions,
    CacheOption,
    DeviceOption,
    DurationOption,
    JsonOption,
    NoVerifyOption,
    StoreArgument,
    unpack_options,
)
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.commands.trajectory import trajectory
from olt_toolkit.rigs.names import MotionLabels
from olt_toolkit.runtime.workers import Engine

if TYPE_CHECKING:
    from collections.abc import Sequence

    from olt_generator.omissions import Omission
    from olt_toolkit.clips.build_job import BuildJob
    from olt_toolkit.clips.store import ClipStore

app = typer.Typer(add_completion=False, no_args_is_help=True, help="Build, inspect and score clips.")
app.command(help="Recover the motion of a recording, and hold it against the reference.")(unpack_options(trajectory))


@app.command(help="Build the clip of a recording, or of each drive in a folder, and add it to a store.")
@unpack_options
def build(
    recording: Annotated[
        Path, typer.Argument(metavar="INPUT", help="A video, a drive folder, a folder of them, or a data set.")
    ],
    out: Annotated[Path, typer.Option(help="Folder of the clip store; it is made if it is missing.")],
    building: BuildingOptions,
    name: Annotated[str | None, typer.Option(help="Name of the clip; that of the recording by default.")] = None,
    category: Annotated[str | None, typer.Option(help="Long-tail category, or nominal; unlabelled by default.")] = None,
    factor: Annotated[list[str] | None, typer.Option(help="A scene factor; repeat for more than one.")] = None,
    labels: Annotated[
        MotionLabels,
        typer.Option(
            help="With --poses reference: measured motion as it is, or as a car that does not slip drives it."
        ),
    ] = MotionLabels.AS_MEASURED,
    duration: DurationOption = 20.0,
    all_frames: AllFramesOption = False,
    seed: Annotated[int, typer.Option(help="Of what --backend draws by chance; goes into the clip's id.")] = 0,
    cache: CacheOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = Engine.LOCAL,
    keep_going: Annotated[bool, typer.Option("--keep-going", help="Go on after a recording that fails.")] = False,
    no_verify: NoVerifyOption = False,
    as_json: JsonOption = False,
) -> None:
    """Recording to trajectory, distance and views; then clips in the store and pictures beside them.

    A clip is in the split that its data set tells, and in train where it tells none.
    """
    from olt_generator.errors import InputError
    from olt_generator.files import make_folder
    from olt_toolkit.clips.build_job import BuildJob
    from olt_toolkit.clips.estimators import PoseEstimator
    from olt_toolkit.clips.views import BuildOptions
    from olt_toolkit.recordings.drives import WHOLE, find_drives, list_left_out
    from olt_toolkit.recordings.labels import UNLABELLED
    from olt_toolkit.recordings.recording import refuse_unused

    if name is not None and Path(name).name != name:
        raise InputError(f"--name {name!r}: pictures are named after the clip; give a name without slashes")
    estimators = building.estimators()
    if estimators.poses is not PoseEstimator.REFERENCE:
        why = "motion that is recovered is smoothed in any case; measured motion is taken with --poses reference"
        refuse_unused({"--labels": labels is not MotionLabels.AS_MEASURED}, why)
    options = BuildOptions(
        width=building.width,
        height=building.height,
        cameras=building.cameras,
        front=building.front,
        frames="all" if all_frames else "grid",
        name=name,
        category=category or UNLABELLED,
        factors=tuple(factor or ()),
        labels=labels,
        seed=seed,
    )
    store, opening = make_folder(out), building.opening(duration)
    jobs = [
        BuildJob(
            place,
            key,
            store,
            None,
            opening,
            options,
            estimators,
            building.backends(),
            keep_going=keep_going,
            verify=not no_verify,
        )
        for place, key in find_drives(recording, cache)
    ]
    if jobs[0].place.path == recording and jobs[0].key == WHOLE:
        _build_one(jobs[0], as_json)
    elif name is not None:
        raise InputError(f"--name {name!r}: clips of a folder take the names of their recordings; leave --name out")
    else:
        build_all(jobs, workers, engine, as_json, "recordings", list_left_out(recording, cache))


@app.command(help="Make single views of a recording, or further views of a stored clip, as video files.")
@unpack_options
def views(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="A recording, or a clip store.")],
    out: Annotated[Path, typer.Option(help="Folder for the videos, the pictures and plan.json.")],
    building: BuildingOptions,
    clip: Annotated[str | None, typer.Argument(help="Name or id of a clip, where INPUT is a store.")] = None,
    cameras: Annotated[
        str | None, typer.Option(help="Views, with commas: cross_left, rear_tele, ...; those of --rig by default.")
    ] = None,
    duration: DurationOption = 20.0,
    all_frames: AllFramesOption = False,
    cache: CacheOption = None,
    as_json: JsonOption = False,
) -> None:
    """Only the wanted views and those they are made from; the rest is named as left out."""
    from dataclasses import replace

    from olt_toolkit.clips.builder import build_clip
    from olt_toolkit.clips.store import ClipStore
    from olt_toolkit.clips.view_files import leave_out_motion, parse_cameras, reopen_clip, write_view_files
    from olt_toolkit.clips.views import BuildOptions
    from olt_toolkit.commands.clip_output import print_plan
    from olt_toolkit.recordings.drives import open_recording
    from olt_toolkit.recordings.recording import refuse_unused
    from olt_toolkit.runtime.console import print_json, show_progress

    wanted = building.cameras if cameras is None else parse_cameras(cameras)
    estimators = building.estimators()
    options = BuildOptions(
        width=building.width,
        height=building.height,
        cameras=wanted,
        front=building.front,
        frames="all" if all_frames else "grid",
        use_reference_motion=clip is not None,
    )
    if clip is None:
        recording = open_recording(source, building.opening(duration), cache)
    else:
        unused = building.given_of_recordings() | {"--duration": duration != 20.0, "--cache": cache is not None}
        refuse_unused(unused, "a stored clip has its lens, motion and duration")
        store = ClipStore(source)
        recording = reopen_clip(store, store.find(clip))
    options = replace(estimators.apply(options), backend=building.backends().open())
    options = leave_out_motion(recording, options)
    with show_progress("views") as (on_progress, on_step):
        built = build_clip(recording, options, on_progress, on_step)
        on_progress(1.0)  # steps that were left out count as done
    plan = write_view_files(out, built)
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


@app.command(help="Score the views of a clip: GeoKPM, coherence, and errors against a reference clip.")
def score(
    store: StoreArgument,
    clip: Annotated[str, typer.Argument(help="Name or id of the clip.")],
    reference: Annotated[str | None, typer.Option(help="Name or id of a clip with the true views.")] = None,
    reference_store: Annotated[Path | None, typer.Option(help="Store of the reference; STORE by default.")] = None,
    moments: Annotated[int, typer.Option(min=1, help="Moments that are looked at, spread evenly.")] = 41,
    loftr_weights: Annotated[Path | None, typer.Option(help="loftr_outdoor.ckpt; without it, SIFT matches.")] = None,
    lpips_weights: Annotated[
        Path | None, typer.Option(help="Folder with alexnet-owt-7be5be79.pth and alex.pth; without it, no LPIPS.")
    ] = None,
    device: DeviceOption = "cpu",
    as_json: JsonOption = False,
) -> None:
    """The matcher is named in the result, because numbers of two matchers do not compare."""
    from olt_generator.errors import InputError
    from olt_toolkit.clips.score import open_lpips, open_matcher, score_against, score_coherence, score_consistency
    from olt_toolkit.clips.store import ClipStore
    from olt_toolkit.commands.clip_output import print_scores
    from olt_toolkit.recordings.recording import refuse_unused
    from olt_toolkit.runtime.console import print_json, show_progress

    if reference is None and (reference_store is not None or lpips_weights is not None):
        raise InputError("--reference is missing: the true views are needed to compare with")
    learned = loftr_weights is not None or lpips_weights is not None
    refuse_unused({"--device": device != "cpu" and not learned}, "no learned model is run")
    opened, truth = ClipStore(store), ClipStore(reference_store or store)
    clip_id = opened.find(clip)
    reference_id = None if reference is None else truth.find(reference)
    matcher, lpips = open_matcher(loftr_weights, device), open_lpips(lpips_weights, device)
    with show_progress("GeoKPM") as (on_progress, _):
        consistency = score_consistency(opened, clip_id, matcher, moments, on_progress)
    with show_progress("coherence") as (on_progress, _):
        coherence = score_coherence(opened, clip_id, moments, on_progress)
    errors = None if reference_id is None else score_against(opened, clip_id, truth, reference_id, lpips)
    summary = {
        "store": str(store),
        "clip_id": clip_id,
        "geokpm": consistency,
        "coherence": coherence,
        "reference": errors,
    }
    print_json(summary) if as_json else print_scores(summary)


def _build_one(job: "BuildJob", as_json: bool) -> None:
    import time

    from olt_generator.errors import InputError
    from olt_toolkit.clips.feasibility import why_no_sample
    from olt_toolkit.clips.store import ClipStore
    from olt_toolkit.commands.clip_output import print_build
    from olt_toolkit.runtime.console import print_json, print_line, show_progress

    job, store = job.identify(), ClipStore(job.store)
    if job.clip_id in store:
        job.check_options(store.info(job.clip_id))
        known = store.info(job.clip_id).name
        raise InputError(
            f"{store.root}: already holds the clip {known!r} of this recording; give another --seed or --out"
        )
    recording = job.open()
    if not as_json and (reason := why_no_sample(recording)):
        print_line(f"the clip will give no policy sample: {reason}")
    with show_progress("clip") as (on_progress, on_step):
        summary = job.prepare(recording, on_progress, on_step)
        on_progress(1.0)
        on_step("store")
        start = time.perf_counter()
        store.commit([summary["clip"]["clip_id"]])
    summary["store_seconds"]["commit"] = time.perf_counter() - start
    print_json(summary) if as_json else print_build(summary)


def build_all(
    jobs: "list[BuildJob]",
    workers: int | None,
    engine: Engine,
    as_json: bool,
    what: str,
    left_out: "Sequence[Omission]" = (),
) -> None:
    """Build the clips of all jobs, which have one store, and print what became of them.

    `what` the jobs are made of, plural, is the key of the results in the JSON object; `left_out` is what was passed
    over beside it.

    Raises:
        InputError: something could not be used.
    """
    from dataclasses import asdict

    from olt_generator.errors import InputError
    from olt_generator.omissions import word_omission
    from olt_toolkit.clips.build_job import build_clips
    from olt_toolkit.commands.clip_output import print_results
    from olt_toolkit.runtime.console import print_json, print_line, show_progress
    from olt_toolkit.runtime.workers import default_workers

    store = jobs[0].store
    with show_progress("clips", len(jobs)) as (on_progress, _):
        results = build_clips(jobs, workers or default_workers(), on_progress, engine)
    if as_json:
        found = [asdict(each) | {"path": str(each.path)} for each in results]
        print_json({"store": str(store), what: found, "left_out": [each.to_dict() for each in left_out]})
    else:
        print_results(results, store)
        for omission in left_out:
            print_line(f"left out: {word_omission(omission)}")
    failed = sum(result.state == "failed" for result in results)
    if failed:
        raise InputError(f"{failed} of {len(results)} {what} could not be used; the others are in {store}")


def _draw_stored(store: "ClipStore", clip_id: str, folder: Path) -> dict[str, str]:
    from olt_toolkit.clips.pictures import picture_name, write_clip_pictures

    info = store.info(clip_id)
    times_us = {name: store.read_timestamps(clip_id, name) for name in info.views}
    shown_us = next(iter(times_us.values()))
    shown_us = shown_us[
        (shown_us >= max(times[0] for times in times_us.values()))
        & (shown_us <= min(times[-1] for times in times_us.values()))
    ]
    images = {name: store.read_frames(clip_id, name, shown_us)[0] for name in info.views}
    not_whole = [name for name, view in info.views.items() if not view.is_seen_whole]
    origins = {name: store.read_origin(clip_id, name, shown_us) for name in not_whole}
    return write_clip_pictures(folder, picture_name(info.name, clip_id), images, origins, shown_us)
