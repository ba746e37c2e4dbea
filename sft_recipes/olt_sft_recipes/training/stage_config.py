"""Settings of one training stage, read strictly from YAML; the keys are those of the real recipe where it has them."""

import math
from importlib.resources import files
from pathlib import Path
from typing import Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    model_validator,
)

from olt_generator.errors import InputError
from olt_toolkit.runtime.yaml_files import read_yaml_mapping

Tracker = Literal["none", "tensorboard", "wandb"]

# What does not change the weights that a training ends with.
_BOOKKEEPING = {"save_steps", "save_total_limit", "eval_steps", "report_to"}


class StageConfig(BaseModel):
    """One stage of training the toy policy.

    Attributes:
        stage: 1 trains the vision-language model on trajectory tokens, 2 the action expert by flow matching.
        num_train_epochs: passes over the mixture.
        per_device_train_batch_size: samples whose gradient is computed at once.
        gradient_accumulation_steps: such batches per optimizer step.
        learning_rate, min_lr: at the end of the warmup and at the end of training.
        warmup_steps: optimizer steps of linear warmup.
        weight_decay: of AdamW.
        max_grad_norm: gradients are scaled down to this norm.
        seed: of initial weights and of all random draws.
        mirror_probability: share of batches that are mirrored, left for right. Toy only.
        move_metres, turn_degrees: samples are perturbed by up to this much, off the path and in heading
            (`DrivingSamples.perturbed`). Toy only.
        regression_warmup_epochs: of the epochs of Stage 1, the first so many train regression and sight alone. They
            stand in for the pre-training that the real model brings along, and cost a fraction. Toy only.
        hidden_token_probability: share of future tokens that are hidden from later ones in Stage 1. Toy only.
        invented_pixel_weight: how much an invented pixel of a sample's images counts, between nothing and as much as
            one that a camera saw. A sample counts in the loss by the mean over its pixels (`DrivingSamples.weights`),
            and the weights of an optimizer step are divided by their sum. 1, the default: all samples alike, as in the
            real recipe. Toy only.
        sight_weight: of the loss of what is where (`training.auxiliary`) in Stage 1. Toy only.
        save_steps: a checkpoint is written after every so many optimizer steps, and at the end; also before each
            evaluation.
        save_total_limit: so many of the newest checkpoints are kept, and the best besides.
        eval_steps: where there is something to judge by, the model is judged after every so many steps and at the end;
            below 1 a share of all steps, so that 0.25 judges it four times.
        report_to: who is told of losses and errors while they come: "none", "tensorboard" or "wandb".
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    stage: Literal[1, 2]
    num_train_epochs: PositiveInt = 3
    per_device_train_batch_size: PositiveInt = 1
    gradient_accumulation_steps: PositiveInt = 1
    learning_rate: PositiveFloat = 1e-4
    min_lr: NonNegativeFloat = 1e-6
    warmup_steps: NonNegativeInt = 100
    weight_decay: NonNegativeFloat = 0.0
    max_grad_norm: PositiveFloat = 1.0
    seed: NonNegativeInt = 42
    mirror_probability: float = Field(default=0.0, ge=0.0, le=1.0)
    move_metres: NonNegativeFloat = 0.0
    turn_degrees: NonNegativeFloat = 0.0
    regression_warmup_epochs: NonNegativeInt = 0
    hidden_token_probability: float = Field(default=0.0, ge=0.0, le=1.0)
    invented_pixel_weight: float = Field(default=1.0, ge=0.0, le=1.0)
    sight_weight: NonNegativeFloat = 1.0
    save_steps: PositiveInt = 500
    save_total_limit: PositiveInt = 2
    eval_steps: PositiveFloat = 0.25
    report_to: Tracker = "none"

    @model_validator(mode="after")
    def _consistent(self) -> "StageConfig":
        if self.eval_steps > 1.0 and self.eval_steps % 1.0:
            raise ValueError(f"eval_steps {self.eval_steps} is neither a share below 1 nor a number of steps")
        if self.min_lr > self.learning_rate:
            raise ValueError(f"min_lr {self.min_lr} is above learning_rate {self.learning_rate}")
        if self.stage == 2 and (self.hidden_token_probability or self.regression_warmup_epochs):
            raise ValueError("hidden_token_probability and regression_warmup_epochs are for stage 1 only")
        if self.regression_warmup_epochs >= self.num_train_epochs:
            raise ValueError(
                f"regression_warmup_epochs {self.regression_warmup_epochs} is not below "
                f"num_train_epochs {self.num_train_epochs}"
            )
        return self

    def learning_rate_at(self, step: int, total_steps: int) -> float:
        """Learning rate of one step, counted from 0: linear warmup, then cosine down to `min_lr`.

        The factor is (s + 1) / W below W, then with m = min_lr / learning_rate and p = (s - W + 1) / (S - W) it is
        m + (1 - m) (1 + cos(pi p)) / 2 (docs/formats/sft_recipes.md).
        """
        if step < self.warmup_steps:
            return self.learning_rate * (step + 1) / self.warmup_steps
        done = (step - self.warmup_steps + 1) / (total_steps - self.warmup_steps)
        return self.min_lr + (self.learning_rate - self.min_lr) * 0.5 * (1.0 + math.cos(math.pi * done))

    def evaluation_interval(self, total_steps: int) -> int:
        """Optimizer steps from one evaluation to the next."""
        steps = self.eval_steps if self.eval_steps >= 1.0 else self.eval_steps * total_steps
        return max(1, math.ceil(steps))

    def decides_weights(self) -> str:
        """Every setting on which the trained weights depend, as one line of JSON."""
        return self.model_dump_json(exclude=_BOOKKEEPING)

    @property
    def samples_per_step(self) -> int:
        """Samples of one optimizer step."""
        return self.per_device_train_batch_size * self.gradient_accumulation_steps


def read_stage_config(path: Path) -> StageConfig:
    """Read the settings of a stage from a YAML file.

    Raises:
        InputError: the file cannot be read, is not YAML or not a mapping, or holds unknown keys or values out of range.
    """
    settings = read_yaml_mapping(path, "stage configuration", StageConfig.model_fields)
    unknown = [str(key) for key in settings if key not in StageConfig.model_fields]
    if unknown:
        known = ", ".join(StageConfig.model_fields)
        raise InputError(f"{path}: unknown key {', '.join(unknown)}; known keys are {known}")
    try:
        return StageConfig.model_validate(settings)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"])) or "settings"
        raise InputError(f"{path}: {field}: {first['msg']}") from error


def builtin_stage_config(stage: Literal[1, 2]) -> StageConfig:
    """The settings of a stage that come with the package."""
    return read_stage_config(Path(str(files("olt_sft_recipes.training"))) / "stages" / f"toy_stage{stage}.yaml")
