"""The learned engine as a backend of views."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Literal

import torch

from olt_generator.diffusion.engine_folder import Engine, digest_engine, load_engine, read_facts
from olt_generator.diffusion.generated_views import GeneratedViews
from olt_generator.diffusion.generation import GenerationSettings
from olt_generator.diffusion.view_graph import VIEWS, order_views
from olt_generator.views.backend import MadeKind, Target, ViewSource
from olt_generator.views.front_view import FrontView

Precision = Literal["float32", "bfloat16"]


@dataclass(frozen=True)
class WanVaceBackend:
    """See `views.backend.ViewBackend`; the engine is loaded when the first view is made.

    Attributes:
        folder, backbone, device: see `engine_folder.load_engine`.
        keep: see `generated_views.GeneratedViews`.
    """

    folder: Path
    backbone: Path | None = None
    settings: GenerationSettings = field(default_factory=GenerationSettings)
    device: str = "cpu"
    precision: Precision = "float32"
    keep: Path | None = None
    kind: MadeKind = "generated"
    name: str = "wan-vace"

    @property
    def engine(self) -> str:
        """The name with the digest of the weights."""
        return f"wan-vace {digest_engine(self.folder, self.backbone)}"

    def needed(self, wanted: Sequence[str]) -> tuple[str, ...]:
        """The wanted views and those that they are conditioned on, but for the front view."""
        most = self.settings.conditions if read_facts(self.folder).config.conditioning.memory else 0
        return tuple(VIEWS[view] for view in order_views(wanted, most=most).views)

    def start(self, front: FrontView, targets: Mapping[str, Target], indices: Sequence[int], seed: int) -> ViewSource:
        """See `ViewBackend.start`."""
        digest = digest_engine(self.folder, self.backbone)
        engine = _load(self.folder, self.backbone, self.device, self.precision, digest)
        return GeneratedViews(engine, self.settings, front, targets, indices, seed, self.keep)


@lru_cache(maxsize=1)  # a process makes many clips with one engine
def _load(folder: Path, backbone: Path | None, device: str, precision: Precision, digest: str) -> Engine:
    """The engine; the digest tells another one in the same place."""
    return load_engine(folder, backbone, device, getattr(torch, precision))
