"""`olt generate clips`: clips whose missing views a backend makes, the learned one by default."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from olt_toolkit.commands.clip_options import (
    AllFramesOption,
    BuildingOptions,
    CacheOption,
    DurationOption,
    JsonOption,
    NoVerifyOption,
    unpack_options,
)
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.rigs.names import Backend
from olt_toolkit.runtime.workers import Engine


@unpack_options
def clips(
    recording: Annotated[
        Path, typer.Argument(metavar="INPUT", help="A video, a drive folder, a folder of them, or a data set.")
    ],
    out: Annotated[Path, typer.Option(help="Folder of the clip store; it is made if it is missing.")],
    building: BuildingOptions,
    views: Annotated[
        str | None, typer.Option(help="Views, with commas: cross_left, rear_tele, ...; those of --rig by default.")
    ] = None,
    duration: DurationOption = 20.0,
    all_frames: AllFramesOption = False,
    seed: Annotated[int, typer.Option(help="Of what --backend draws by chance; goes into the clips' ids.")] = 0,
    cache: CacheOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = Engine.LOCAL,
    keep_going: Annotated[bool, typer.Option("--keep-going", help="Go on after a recording that fails.")] = False,
    no_verify: NoVerifyOption = False,
    as_json: JsonOption = False,
) -> None:
    """Make the wanted views of each recording, those that they depend on, and no others; given again, it goes on.

    The front view is always in the clip. Views that were sampled before a run ended are not sampled again.
    """
    from olt_generator.files import make_folder
    from olt_toolkit.clips.build_job import BuildJob
    from olt_toolkit.clips.view_files import parse_cameras
    from olt_toolkit.clips.views import BuildOptions
    from olt_toolkit.commands.clip import build_all
    from olt_toolkit.recordings.drives import find_drives, list_left_out
    from olt_toolkit.rigs.rig import CAMERA_INDEX, FRONT_WIDE

    if building.generator_weights is not None:
        building = replace(building, backend=Backend.WAN_VACE)
    wanted = building.cameras if views is None else (*parse_cameras(views), FRONT_WIDE)
    options = BuildOptions(
        width=building.width,
        height=building.height,
        cameras=tuple(sorted(set(wanted), key=CAMERA_INDEX.__getitem__)),
        front=building.front,
        frames="all" if all_frames else "grid",
        seed=seed,
    )
    estimators, backends = building.estimators(), building.backends()
    backends.open()
    store, opening = make_folder(out), building.opening(duration)
    jobs = [
        BuildJob(
            *(place, key, store, None, opening, options, estimators, backends),
            keep_going=keep_going,
            verify=not no_verify,
        )
        for place, key in find_drives(recording, cache)
    ]
    build_all(jobs, workers, engine, as_json, "recordings", list_left_out(recording, cache))
