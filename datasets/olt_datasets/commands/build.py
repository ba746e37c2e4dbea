"""`olt data build`: from a table of indexed clips to a clip store."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from olt_datasets.commands.dataset_options import DEFAULT_CACHE, CacheOption, JsonOption, SourceOption
from olt_datasets.tables.choices import BuiltKind
from olt_toolkit.clips.estimators import DepthChoice, PoseChoice, SourceChoice
from olt_toolkit.commands.clip_options import (
    CameraHeightOption,
    DepthOption,
    DepthWeightsOption,
    DeviceOption,
    FovOption,
    HeightOption,
    MapAnythingOption,
    PosesOption,
    WidthOption,
    make_open_options,
)
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.runtime.workers import Engine

if TYPE_CHECKING:
    from olt_datasets.tables.building import RowJob
    from olt_toolkit.clips.build_job import Outcome


def build(
    table: Annotated[Path, typer.Argument(help="A table of indexed clips (.parquet) that are in splits.")],
    root: Annotated[Path, typer.Option(help="Folder of the data set that was indexed.")],
    kind: Annotated[BuiltKind, typer.Option(help="True views of all cameras, or views synthesized from the front.")],
    out: Annotated[Path, typer.Option(help="Folder of the clip store; it is made if it is missing.")],
    source: SourceOption = None,
    cache: CacheOption = DEFAULT_CACHE,
    fov: FovOption = None,
    camera_height: CameraHeightOption = None,
    width: WidthOption = 576,
    height: HeightOption = 320,
    poses: PosesOption = PoseChoice.ODOMETRY,
    mapanything_weights: MapAnythingOption = None,
    depth: DepthOption = DepthChoice.GEOMETRIC,
    depth_weights: DepthWeightsOption = None,
    device: DeviceOption = "cpu",
    seed: Annotated[int, typer.Option(help="Seed of the clips.")] = 0,
    workers: WorkersOption = None,
    engine: EngineOption = Engine.LOCAL,
    keep_going: Annotated[bool, typer.Option("--keep-going", help="Go on after a window that fails.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Build the clips of an indexed table and add them to a store, with split, category and origin of their rows.

    Motion that the data set measured is taken as it is, else --poses recovers it. Given again, an interrupted build
    goes on. Exit status 1 if windows failed with --keep-going.
    """
    from olt_datasets.tables.building import RowJob, find_buildable
    from olt_datasets.tables.indexing import DatasetPlace
    from olt_generator.files import make_folder
    from olt_toolkit.clips.table import read_clip_table
    from olt_toolkit.clips.views import BuildOptions

    place = DatasetPlace(root, cache.expanduser(), source)
    choice = SourceChoice(poses, mapanything_weights, depth, depth_weights, device)
    opening = make_open_options(float("inf"), fov, camera_height)
    options = BuildOptions(width=width, height=height, seed=seed)
    rows = find_buildable(read_clip_table(table), kind)
    store = make_folder(out)
    jobs = [RowJob(row, place, store, kind, opening, options, choice, keep_going) for row in rows]
    _show(_build(jobs, workers, engine), out, as_json)


def _build(jobs: "list[RowJob]", workers: int | None, engine: Engine) -> "list[Outcome]":
    from olt_toolkit.clips.build_job import build_clips
    from olt_toolkit.runtime.console import make_progress
    from olt_toolkit.runtime.workers import default_workers

    with make_progress() as progress:
        task = progress.add_task("clips", total=len(jobs))
        return build_clips(
            jobs,
            workers or default_workers(),
            lambda share: progress.update(task, completed=round(share * len(jobs))),
            engine,
        )


def _show(outcomes: "list[Outcome]", store: Path, as_json: bool) -> None:
    from dataclasses import asdict

    from olt_generator.errors import InputError
    from olt_toolkit.commands.clip_output import print_outcomes
    from olt_toolkit.runtime.console import print_json

    if as_json:
        print_json({"store": str(store), "clips": [asdict(each) | {"path": str(each.path)} for each in outcomes]})
    else:
        print_outcomes(outcomes, store)
    failed = sum(outcome.state == "failed" for outcome in outcomes)
    if failed:
        raise InputError(f"{failed} of {len(outcomes)} windows could not be used; the others are in {store}")
