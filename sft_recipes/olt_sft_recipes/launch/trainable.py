"""What a stage really trains, by module."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from olt_sft_recipes.preflight.parameters import ModelSizes, published_sizes, sizes_of_checkpoint
from olt_sft_recipes.preflight.plan import StagePlan

if TYPE_CHECKING:
    from olt_sft_recipes.preflight.checkpoint_folder import CheckpointFolder

LORA_RANK, LORA_ALPHA = 16, 32
_NAMES = {
    "visual": "image encoder",
    "embedding": "token embedding",
    "layers": "language layers",
    "head": "output head",
    "expert": "action expert and projections",
    "adapters": "adapters of the language layers",
}


@dataclass(frozen=True)
class ModuleCount:
    """Parameters of one module, of which so many are trained."""

    module: str
    parameters: int
    trained: int


def model_sizes(base: "CheckpointFolder | None") -> ModelSizes:
    """Counted from the tensors of a released checkpoint, or from published sizes where there is none here."""
    return sizes_of_checkpoint(base.tensors, str(base.root)) if base else published_sizes()


def count_trained(sizes: ModelSizes, stage: StagePlan) -> list[ModuleCount]:
    """Parameters and trained ones of every module that a stage holds: Stage 1 has no expert."""
    trained = sizes.trainable(stage)
    held = {part: count for part, count in sizes.parameters.items() if stage.stage == 2 or part != "expert"}
    held |= {part: count for part, count in trained.items() if part not in held}
    return [ModuleCount(_NAMES[part], count, trained.get(part, 0)) for part, count in held.items()]
