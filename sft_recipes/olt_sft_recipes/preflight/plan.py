"""What would be launched: the settings that preflight holds data, checkpoints and machines against.

Values are those of the public recipes (docs/formats/sft_recipes.md).
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.names import PolicyName
from olt_toolkit.rigs.contracts import CameraContract, find_contract
from olt_toolkit.rigs.names import ContractName

MOST_SATURATED = 0.01
"""Share of saturated future tokens up to which a launch goes on, where the user says nothing else."""


@dataclass(frozen=True)
class StagePlan:
    """One stage of training, in the keys of the recipes where they have them.

    Attributes:
        stage: 1 trains the vision-language model, 2 the action expert.
        zero_stage: of DeepSpeed, 0 to 3; 0 is without it.
        lora_rank: of adapters on the projections of the language model, in place of its weights; None without.
        lora_freezes_rest: whether embeddings, head and image encoder are frozen beside adapters. The community recipe
            leaves them trainable unless it is told otherwise.
    """

    stage: int
    per_device_train_batch_size: int = 1
    gradient_accumulation_steps: int = 1
    num_train_epochs: int = 3
    learning_rate: float = 1e-4
    min_lr: float = 1e-6
    warmup_steps: int = 100
    zero_stage: int = 0
    gradient_checkpointing: bool = False
    lora_rank: int | None = None
    lora_freezes_rest: bool = True
    save_steps: int = 500
    save_total_limit: int = 2

    def __post_init__(self) -> None:
        for name in ("per_device_train_batch_size", "gradient_accumulation_steps", "num_train_epochs", "save_steps"):
            if getattr(self, name) < 1:
                raise InputError(f"stage {self.stage}: {name} is {getattr(self, name)}; it is at least 1")
        if self.stage not in (1, 2) or self.zero_stage not in range(4):
            raise InputError(f"stage {self.stage} with zero_stage {self.zero_stage}; stages are 1 and 2, ZeRO 0 to 3")
        if not 0.0 <= self.min_lr <= self.learning_rate or self.warmup_steps < 0:
            raise InputError(
                f"stage {self.stage}: min_lr {self.min_lr:g}, learning_rate {self.learning_rate:g}, warmup_steps "
                f"{self.warmup_steps}; they are 0 or more, and min_lr is at most learning_rate"
            )

    def learning_rate_at(self, step: int, total: int) -> float:
        """Rate of one step, counted from 0 of `total`: linear warm-up, then cosine (docs/formats/sft_recipes.md)."""
        if step < self.warmup_steps:
            return self.learning_rate * (step + 1) / self.warmup_steps
        done = (step - self.warmup_steps + 1) / (total - self.warmup_steps)
        return self.min_lr + (self.learning_rate - self.min_lr) * 0.5 * (1.0 + math.cos(math.pi * done))


@dataclass(frozen=True)
class PreflightPlan:
    """Everything that a launch would use; what is None is not checked, and the report says so.

    Attributes:
        policy: of `PolicyName`.
        stages: those that will run.
        data, chunk_ids: `data.train_dataset.local_dir` and `.chunk_ids`; None takes all chunks. For the toy: a
            mixture, a clip store or an export.
        val_data, val_chunk_ids: the same of validation.
        use_default_keyframe: whether samples are taken at 5.1 s; else at the first time of `event_t0s`.
        base: folder of the released checkpoint.
        base_is_rewritten: whether the launch rewrites a base of Alpamayo 1.5 to the format of R1 first.
        stage1: folder of Stage 1's checkpoint, where Stage 2 starts from one that is there.
        vlm: local folder of the vision-language model whose processor and vocabulary are taken.
        out: folder that the training writes to; it need not be there yet.
        nodes, gpus: machines, and processes on each.
        gpu_memory_gib: of each card; None asks `nvidia-smi`.
        python: interpreter of the environment that would run the recipe.
        most_saturated: share of future tokens that may be cut off at the end of their range.
        clips: clips that are opened one by one; those that are spread most evenly over the selection.
        seconds: after so long no further clip is opened.
    """

    policy: str
    stages: tuple[StagePlan, ...]
    data: Path | None = None
    chunk_ids: str | None = None
    val_data: Path | None = None
    val_chunk_ids: str | None = None
    use_default_keyframe: bool = True
    base: Path | None = None
    base_is_rewritten: bool = False
    stage1: Path | None = None
    vlm: Path | None = None
    out: Path | None = None
    nodes: int = 1
    gpus: int = 8
    gpu_memory_gib: float | None = None
    python: Path | None = None
    most_saturated: float = MOST_SATURATED
    clips: int = 64
    seconds: float = 3.0

    def __post_init__(self) -> None:
        if self.policy not in [name.value for name in PolicyName]:
            raise InputError(f"no policy {self.policy!r}; choose from {', '.join(PolicyName)}")
        for name in ("nodes", "gpus", "clips"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; it is at least 1")
        if self.gpu_memory_gib is not None and not 0.0 < self.gpu_memory_gib < math.inf:
            raise InputError(f"gpu_memory_gib is {self.gpu_memory_gib:g}; it is more than 0")

    @property
    def devices(self) -> int:
        """Processes of all nodes together."""
        return self.nodes * self.gpus

    @property
    def contract(self) -> CameraContract:
        """The cameras of the policy; the toy takes those of Alpamayo-R1."""
        name = ContractName.ALPAMAYO_R1 if self.policy == PolicyName.TOY else self.policy
        return find_contract(name)


def recipe_stages(policy: str) -> tuple[StagePlan, StagePlan]:
    """Both stages as the public recipe of Alpamayo-R1 has them.

    The same values are taken for Alpamayo 1.5, whose recipe has them too, and 2, which has no recipe; the toy has the
    stages that come with the package.
    """
    if policy == PolicyName.TOY:
        return _toy_stage(1), _toy_stage(2)
    first = StagePlan(
        1,
        gradient_accumulation_steps=4,
        learning_rate=1e-5,
        warmup_steps=500,
        zero_stage=2,
        gradient_checkpointing=True,
    )
    return first, StagePlan(2)


def _toy_stage(stage: Literal[1, 2]) -> StagePlan:
    from olt_sft_recipes.training.stage_config import builtin_stage_config

    config = builtin_stage_config(stage)
    return StagePlan(
        stage,
        per_device_train_batch_size=config.per_device_train_batch_size,
        gradient_accumulation_steps=config.gradient_accumulation_steps,
        num_train_epochs=config.num_train_epochs,
        learning_rate=config.learning_rate,
        min_lr=config.min_lr,
        warmup_steps=config.warmup_steps,
    )
