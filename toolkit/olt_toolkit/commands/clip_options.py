"""Options that the commands which open and build clips share.

A bundle is a dataclass with a field for each option. A command with a parameter of that type under `unpack_options` has
the options on its command line, and gets them as one value.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from olt_toolkit.clips.backends import Backends, Precision, Solver
from olt_toolkit.clips.estimators import DepthEstimator, Estimators, PoseEstimator
from olt_toolkit.rigs.names import Backend, ContractName, FrontLens

if TYPE_CHECKING:
    from olt_toolkit.recordings.recording import OpenOptions

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
DurationOption = Annotated[float, typer.Option(min=0.1, help="Use at most this many seconds.")]
AllFramesOption = Annotated[bool, typer.Option("--all-frames", help="Make frames that no sample shows too.")]
NoVerifyOption = Annotated[bool, typer.Option("--no-verify", help="Do not look at what was made before it is kept.")]
DeviceOption = Annotated[str, typer.Option(help="Where torch runs learned models.")]
CacheOption = Annotated[Path | None, typer.Option(help="Folder where readers keep what takes long to find again.")]
StoreArgument = Annotated[Path, typer.Argument(help="Folder of the clip store.")]


@dataclass(frozen=True)
class CameraOptions:
    """What is assumed of a camera of which nothing is known."""

    fov: Annotated[float | None, typer.Option(help="Horizontal field of view in degrees, if not calibrated.")] = None
    camera_height: Annotated[float | None, typer.Option(help="Height of the camera in metres, if unknown.")] = None
    rotate: Annotated[int, typer.Option(help="Turn a video clockwise by 0, 90, 180 or 270 degrees.")] = 0
    mirror: Annotated[bool, typer.Option("--mirror", help="Mirror a video left to right, after it is turned.")] = False

    def given(self) -> dict[str, bool]:
        """Which of these options were given, by name."""
        return {
            "--fov": self.fov is not None,
            "--camera-height": self.camera_height is not None,
            "--rotate": self.rotate != 0,
            "--mirror": self.mirror,
        }

    def opening(self, duration: float = float("inf")) -> "OpenOptions":
        """How a drive is opened, up to so many seconds where no window is asked for; InputError for odd values."""
        from math import radians

        from olt_generator.errors import InputError
        from olt_toolkit.recordings.recording import OpenOptions

        if self.rotate not in (0, 90, 180, 270):
            raise InputError(f"--rotate {self.rotate}: give 0, 90, 180 or 270 degrees")
        if self.camera_height is not None and not self.camera_height > 0.0:
            raise InputError(f"--camera-height {self.camera_height:g}: give metres above the road")
        return OpenOptions(
            duration=duration,
            horizontal_fov=None if self.fov is None else radians(self.fov),
            camera_height=self.camera_height,
            rotate=self.rotate,
            mirror=self.mirror,
        )


@dataclass(frozen=True)
class BuildingOptions(CameraOptions):
    """How clips are built: the size of their views, and what measures motion and distances."""

    rig: Annotated[ContractName, typer.Option(help="The policy whose cameras are made.")] = ContractName.ALPAMAYO_R1
    front: Annotated[
        FrontLens, typer.Option(help="The front view: its name's lens with black borders, or the source's own lens.")
    ] = FrontLens.AS_NAMED
    width: Annotated[int, typer.Option(min=32, help="Width of the views in pixels, even.")] = 576
    height: Annotated[int, typer.Option(min=32, help="Height of the views in pixels, even.")] = 320
    poses: Annotated[PoseEstimator, typer.Option(help="Where the motion of the vehicle comes from.")] = (
        PoseEstimator.ODOMETRY
    )
    mapanything_weights: Annotated[Path | None, typer.Option(help="Folder with the files of MapAnything.")] = None
    depth: Annotated[DepthEstimator, typer.Option(help="Where the distances come from.")] = DepthEstimator.GEOMETRIC
    depth_weights: Annotated[Path | None, typer.Option(help="Folder with the files of the depth network.")] = None
    backend: Annotated[Backend, typer.Option(help="What makes the views that no camera recorded.")] = Backend.GEOMETRIC
    generator_weights: Annotated[Path | None, typer.Option(help="Folder of the engine of --backend wan-vace.")] = None
    backbone_weights: Annotated[
        Path | None, typer.Option(help="Folder of Wan2.1-VACE, where the engine does not bring its own.")
    ] = None
    steps: Annotated[int, typer.Option(min=1, help="Steps in which wan-vace samples a view.")] = 50
    solver: Annotated[Solver, typer.Option(help="How wan-vace goes a step.")] = Solver.EULER
    guidance: Annotated[
        float | None, typer.Option(help="Of all wan-vace views, 1 for one pass a step; 3.5 and 7 (rear) by default.")
    ] = None
    tile: Annotated[int | None, typer.Option(help="Decode wan-vace videos in tiles of so many pixels.")] = None
    precision: Annotated[Precision, typer.Option(help="Of the weights of wan-vace.")] = Precision.FLOAT32
    invent_all: Annotated[
        bool, typer.Option("--invent-all", help="Show what wan-vace made of what the front camera saw, too.")
    ] = False
    device: DeviceOption = "cpu"

    def given_of_recordings(self) -> dict[str, bool]:
        """Which options were given that tell how a recording is read, and where its motion comes from."""
        return self.given() | {"--poses": self.poses is not PoseEstimator.ODOMETRY}

    def given_of_synthesis(self) -> dict[str, bool]:
        """Which options were given that tell how views are made, where they and the motion are not known."""
        return {
            "--front": self.front is not FrontLens.AS_NAMED,
            "--poses": self.poses is not PoseEstimator.ODOMETRY,
            "--depth": self.depth is not DepthEstimator.GEOMETRIC,
            "--backend": self.backend is not Backend.GEOMETRIC,
        }

    def opening(self, duration: float = float("inf")) -> "OpenOptions":
        """How a drive is opened, with the true views of the rig's cameras where they are known."""
        from dataclasses import replace

        return replace(super().opening(duration), views=self.cameras)

    @property
    def cameras(self) -> tuple[str, ...]:
        """The cameras of the rig."""
        from olt_toolkit.rigs.contracts import find_contract

        return find_contract(self.rig.value).cameras

    def estimators(self) -> Estimators:
        """What measures motion and distances; an `InputError` where weights are given without their estimator."""
        learned = self.backend is Backend.GEOMETRIC or self.mapanything_weights or self.depth_weights
        device = self.device if learned else "cpu"
        return Estimators(self.poses, self.mapanything_weights, self.depth, self.depth_weights, device)

    def backends(self) -> Backends:
        """What makes the views; an `InputError` where it lacks its weights, or is told what it does not use."""
        return Backends(
            self.backend,
            self.generator_weights,
            self.backbone_weights,
            self.steps,
            self.solver,
            self.guidance,
            self.tile,
            self.precision,
            not self.invent_all,
            "cpu" if self.backend is Backend.GEOMETRIC else self.device,
        )


def unpack_options(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the fields of its bundles as parameters of their own, as Typer reads them."""
    signature = inspect.signature(command)
    bundles: dict[str, Any] = {
        p.name: p.annotation for p in signature.parameters.values() if is_dataclass(p.annotation)
    }
    flat: list[inspect.Parameter] = []
    for parameter in signature.parameters.values():
        flat += [
            inspect.Parameter(each.name, inspect.Parameter.KEYWORD_ONLY, default=each.default, annotation=each.type)
            for each in (fields(parameter.annotation) if parameter.name in bundles else ())
        ] or [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)]

    def run(**given: Any) -> None:
        for name, bundle in bundles.items():
            given[name] = bundle(**{each.name: given.pop(each.name) for each in fields(bundle)})
        command(**given)

    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in flat}
    run.__signature__ = signature.replace(parameters=flat)  # pyright: ignore[reportFunctionMemberAccess]
    return run
