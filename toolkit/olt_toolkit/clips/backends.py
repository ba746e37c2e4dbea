"""Which backend makes the views that no camera recorded: names and paths, that can be sent to processes."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from olt_generator.errors import InputError
from olt_toolkit.rigs.names import Backend

if TYPE_CHECKING:
    from olt_generator.views.backend import ViewBackend


class Solver(StrEnum):
    """How a learned backend goes from one noise level to the next (`olt_generator.diffusion.sampling`)."""

    EULER = "euler"
    HEUN = "heun"
    UNIPC = "unipc"
    DPM = "dpm++"


class Precision(StrEnum):
    """Precision of the weights of a learned backend."""

    BFLOAT16 = "bfloat16"
    FLOAT32 = "float32"


@dataclass(frozen=True)
class Backends:
    """A backend by name, with the folders of its networks; what is not of the geometric one is refused with it.

    Attributes:
        weights: folder of the engine (`olt_generator.diffusion.engine_folder`).
        backbone_weights: folder of Wan2.1-VACE, where the engine does not bring its own.
        steps, solver, tile, keep_observed: see `olt_generator.diffusion.generation.GenerationSettings`.
        guidance: of all views; None for those of the released sampler.

    Raises:
        InputError: weights are given without their backend, or the other way round.
    """

    backend: Backend = Backend.GEOMETRIC
    weights: Path | None = None
    backbone_weights: Path | None = None
    steps: int = 50
    solver: Solver = Solver.EULER
    guidance: float | None = None
    tile: int | None = None
    precision: Precision = Precision.FLOAT32
    keep_observed: bool = True
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.backend is Backend.WAN_VACE:
            if self.weights is None:
                raise InputError("--backend wan-vace: needs --generator-weights, the folder of a trained engine")
            return
        plain = Backends.__dataclass_fields__
        for name, option in _OPTIONS.items():
            if getattr(self, name) != plain[name].default:
                raise InputError(f"{option} is of --backend wan-vace; leave it out, or give that backend")

    def open(self, keep: Path | None = None) -> "ViewBackend":
        """The backend; weights are read when the first view is made.

        Args:
            keep: folder for what a run that is taken up again need not make twice.

        Raises:
            InputError: the engine is not there, or a setting is out of its range.
        """
        from olt_generator.views.backend import GeometricBackend

        if self.weights is None:
            return GeometricBackend()
        from olt_generator.diffusion.backend import WanVaceBackend
        from olt_generator.diffusion.engine_folder import read_facts
        from olt_generator.diffusion.generation import GenerationSettings

        guidance = {} if self.guidance is None else dict.fromkeys(_GUIDANCES, self.guidance)
        settings = GenerationSettings(
            self.steps, self.solver.value, tile=self.tile, keep_observed=self.keep_observed, **guidance
        )
        read_facts(self.weights)
        return WanVaceBackend(self.weights, self.backbone_weights, settings, self.device, self.precision.value, keep)

    def describe(self) -> dict[str, Any]:
        """What of it changes a clip and is no part of the clip's id, by option; nothing of the geometric one."""
        if self.weights is None:
            return {}
        from olt_generator.diffusion.engine_folder import digest_engine

        return {
            "generator_weights": digest_engine(self.weights, self.backbone_weights),
            "steps": self.steps,
            "solver": self.solver.value,
            "guidance": self.guidance,
            "tile": self.tile,
            "precision": self.precision.value,
            "invent_all": not self.keep_observed,
        }


_GUIDANCES = ("cross_guidance", "rear_guidance")
_OPTIONS = {
    "weights": "--generator-weights",
    "backbone_weights": "--backbone-weights",
    "steps": "--steps",
    "solver": "--solver",
    "guidance": "--guidance",
    "tile": "--tile",
    "precision": "--precision",
    "keep_observed": "--invent-all",
}
