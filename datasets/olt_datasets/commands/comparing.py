"""The option that commands share which look for leaks."""

from typing import Annotated

import typer

AllowUncomparedOption = Annotated[
    bool, typer.Option("--allow-uncompared", help="Take clips that could not be compared for clips that do not leak.")
]
