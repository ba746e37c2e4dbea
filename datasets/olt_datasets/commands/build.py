"""`olt data build`: from a table of indexed clips to a clip store."""

from pathlib import Path
from typing import Annotated

import typer

from olt_datasets.commands.dataset_options import DEFAULT_CACHE, CacheOption, JsonOption, SourceOption
from olt_datasets.tables.choices import BuiltKind
from olt_toolkit.commands.clip import build_all
from olt_toolkit.commands.clip_options import BuildingOptions, unpack_options
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.runtime.workers import Engine


@unpack_options
def build(
    table: Annotated[Path, typer.Argument(help="A table of indexed clips (.parquet) that are in splits.")],
    root: Annotated[Path, typer.Option(help="Folder of the data set that was indexed.")],
    kind: Annotated[BuiltKind, typer.Option(help="True views of all cameras, or views synthesized from the front.")],
    out: Annotated[Path, typer.Option(help="Folder of the clip store; it is made if it is missing.")],
    building: BuildingOptions,
    source: SourceOption = None,
    cache: CacheOption = DEFAULT_CACHE,
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
    from olt_datasets.tables.building import build_row, find_buildable
    from olt_generator.files import make_folder
    from olt_toolkit import BuildOptions, DatasetPlace
    from olt_toolkit.clips.build_job import BuildJob
    from olt_toolkit.clips.table import read_clip_table

    job = BuildJob(
        place=DatasetPlace(root, cache.expanduser(), source),
        key="",
        store=out,
        opening=building.opening(),
        options=BuildOptions(width=building.width, height=building.height, seed=seed),
        estimators=building.estimators(),
        keep_going=keep_going,
    )
    rows = find_buildable(read_clip_table(table), kind)
    make_folder(out)
    build_all([build_row(row, kind, job) for row in rows], workers, engine, as_json, "clips")
