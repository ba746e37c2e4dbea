"""`olt data make-up`: a table to try recipes, splits and checks on."""

from pathlib import Path
from typing import Annotated

import typer

from olt_datasets.commands.dataset_options import JsonOption


def make_up(
    out: Annotated[Path, typer.Argument(help="The table to write (.parquet).")],
    clips: Annotated[int, typer.Option(min=1, help="Number of rows.")] = 100_000,
    as_json: JsonOption = False,
) -> None:
    """Write a table of made-up clips, to try recipes, splits and checks on at any size; no clip can be built of it."""
    from olt_datasets.benchmarks.mixture_tables import write_made_up_table
    from olt_datasets.tables.clip_table import TABLE_SUFFIX
    from olt_generator.errors import InputError
    from olt_generator.files import write_whole
    from olt_toolkit.runtime.console import print_json, print_line

    if out.suffix != TABLE_SUFFIX:
        raise InputError(f"{out}: a table of clips is written as Parquet; give a name that ends in {TABLE_SUFFIX}")
    with write_whole(out) as temporary:
        write_made_up_table(temporary, clips)
    if as_json:
        print_json({"table": str(out), "clips": clips})
    else:
        print_line(f"{out}: {clips} made-up clips")
