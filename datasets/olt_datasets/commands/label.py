"""`olt data label` and `fake`: what people know of clips into a table of them, and a table to try things on."""

from pathlib import Path
from typing import Annotated

import typer

from olt_datasets.commands.dataset_options import JsonOption


def label(
    table: Annotated[Path, typer.Argument(help="A table of indexed clips (.parquet).")],
    labels: Annotated[Path, typer.Option(help="CSV: scene_id or clip_id, and category, factors (a;b) or country.")],
    out: Annotated[Path, typer.Option(help="The table to write; it may be the same one.")],
    as_json: JsonOption = False,
) -> None:
    """Put categories, scene factors and countries into a table, from a file of labels.

    Recipes choose clips by them, and most data sets tell none.
    """
    from olt_datasets.tables.labels import label_table, read_labels
    from olt_toolkit.runtime.console import print_json, print_line

    labelled = label_table(table, read_labels(labels), out)
    if as_json:
        print_json({"table": str(out), "labelled": labelled})
    else:
        print_line(f"{out}: {labelled} clips labelled")


def fake(
    out: Annotated[Path, typer.Argument(help="The table to write (.parquet).")],
    clips: Annotated[int, typer.Option(min=1, help="Number of rows.")] = 100_000,
    as_json: JsonOption = False,
) -> None:
    """Write a fake table of clips, to try recipes, splits and checks on at any size; no clip can be built of it."""
    from olt_datasets.tables.clip_frame import TABLE_SUFFIX
    from olt_datasets.tables.fake_table import write_fake_table
    from olt_generator.errors import InputError
    from olt_generator.files import write_whole
    from olt_toolkit.runtime.console import print_json, print_line

    if out.suffix != TABLE_SUFFIX:
        raise InputError(f"{out}: a table of clips is written as Parquet; give a name that ends in {TABLE_SUFFIX}")
    with write_whole(out) as temporary:
        write_fake_table(temporary, clips)
    if as_json:
        print_json({"table": str(out), "clips": clips})
    else:
        print_line(f"{out}: {clips} fake clips")
