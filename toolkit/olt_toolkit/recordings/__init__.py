"""What clips are built from: recordings, and the data sets that they are drives of.

`open_recording(path)` opens a video or a drive folder; `open_dataset(path)` any data set with a reader.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from olt_toolkit.recordings.drives import (
        Dataset,
        DatasetPlace,
        DatasetReader,
        Drive,
        Licence,
        open_dataset,
        open_recording,
        readers,
    )
    from olt_toolkit.recordings.recording import OpenOptions, Recording

__all__ = [
    "Dataset",
    "DatasetPlace",
    "DatasetReader",
    "Drive",
    "Licence",
    "OpenOptions",
    "Recording",
    "open_dataset",
    "open_recording",
    "readers",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "recording" if name in ("OpenOptions", "Recording") else "drives"
    return getattr(import_module(f"{__name__}.{module}"), name)
