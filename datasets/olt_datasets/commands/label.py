"""`olt data label`: what people know of clips, into a table of them."""

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
