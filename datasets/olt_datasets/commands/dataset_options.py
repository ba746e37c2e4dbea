"""Options that several commands of `olt data` share."""

from pathlib import Path
from typing import Annotated

import typer

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
SourceOption = Annotated[str | None, typer.Option(help="The data set's reader; the first that knows the folder.")]
CacheOption = Annotated[Path, typer.Option(help="Folder where readers keep what takes long to find again.")]
DEFAULT_CACHE = Path("~/.cache/openlongtail")
