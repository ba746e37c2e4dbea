"""Options that several commands of `olt clip` share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from olt_toolkit.clips.estimators import DepthChoice, PoseChoice

if TYPE_CHECKING:
    from olt_toolkit.recordings.recording import OpenOptions

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
FovOption = Annotated[float | None, typer.Option(help="Horizontal field of view in degrees, if not calibrated.")]
CameraHeightOption = Annotated[float | None, typer.Option(help="Height of the camera in metres, if unknown.")]
WidthOption = Annotated[int, typer.Option(min=32, help="Width of the views in pixels, even.")]
HeightOption = Annotated[int, typer.Option(min=32, help="Height of the views in pixels, even.")]
DurationOption = Annotated[float, typer.Option(min=0.1, help="Use at most this many seconds.")]
AllFramesOption = Annotated[bool, typer.Option("--all-frames", help="Make frames that no sample shows too.")]
PosesOption = Annotated[PoseChoice, typer.Option(help="Where the motion of the vehicle comes from.")]
MapAnythingOption = Annotated[Path | None, typer.Option(help="Folder with the files of MapAnything.")]
DepthOption = Annotated[DepthChoice, typer.Option(help="Where the distances come from.")]
DepthWeightsOption = Annotated[Path | None, typer.Option(help="Folder with the files of the depth network.")]
DeviceOption = Annotated[str, typer.Option(help="Where torch runs learned models.")]
StoreArgument = Annotated[Path, typer.Argument(help="Folder of the clip store.")]


def make_open_options(duration: float, fov: float | None, camera_height: float | None) -> "OpenOptions":
    """How a recording is opened; the field of view is in degrees."""
    from math import radians

    from olt_toolkit.recordings.recording import OpenOptions

    field_of_view = None if fov is None else radians(fov)
    return OpenOptions(duration=duration, horizontal_fov=field_of_view, camera_height=camera_height)
