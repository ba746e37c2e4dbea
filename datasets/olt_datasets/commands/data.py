"""`olt data`: index data sets, label and split them, check them for leaks, build their clips and export them."""

import typer

from olt_datasets.commands.build import build
from olt_datasets.commands.export import export
from olt_datasets.commands.index import check, index, split
from olt_datasets.commands.label import fake, label

app = typer.Typer(
    add_completion=False, no_args_is_help=True, help="Index, label, split, check, build and export driving data sets."
)


@app.command()
def sources() -> None:
    """List the data sets that can be read, with licence and access."""
    from olt_toolkit.recordings.drives import readers
    from olt_toolkit.runtime.console import print_table

    rows = [(name, reader.licence.name, reader.licence.access) for name, reader in readers().items()]
    print_table("Data sets", ("source", "licence", "access"), rows)


for command in (index, label, split, check, build, export, fake):
    app.command()(command)
