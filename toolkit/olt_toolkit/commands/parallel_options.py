"""Options of commands that work on many items at the same time."""

from typing import Annotated

import typer

from olt_toolkit.runtime.workers import Engine

WorkersOption = Annotated[int | None, typer.Option(min=1, help="Items at the same time; one for each processor.")]
EngineOption = Annotated[
    Engine, typer.Option(help="Processes of this machine, or tasks on a Ray cluster (RAY_ADDRESS).")
]
