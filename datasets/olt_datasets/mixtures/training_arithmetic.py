"""Steps and samples of a training run on a mixture (docs/formats/paper.md)."""

import math
import re
from dataclasses import dataclass

from olt_generator.errors import InputError


@dataclass(frozen=True)
class TrainingStage:
    """How one stage of training divides a mixture, written as DEVICESxBATCHxACCUMULATIONxEPOCHS.

    Attributes:
        devices: number of processes that train.
        per_device_batch: samples per device and forward pass.
        accumulation: forward passes per optimizer step.
        epochs: passes over the mixture.
    """

    devices: int
    per_device_batch: int
    accumulation: int
    epochs: int

    def __str__(self) -> str:
        return f"{self.devices}x{self.per_device_batch}x{self.accumulation}x{self.epochs}"

    @property
    def global_batch(self) -> int:
        """Samples per optimizer step."""
        return self.devices * self.per_device_batch * self.accumulation


PAPER_STAGES = (TrainingStage(8, 1, 4, 3), TrainingStage(8, 1, 1, 3))
"""Stage 1 and Stage 2 of the paper, which are those of the public recipe."""


@dataclass(frozen=True)
class TrainingArithmetic:
    """Steps of a training run, counted as Hugging Face's Trainer does with `drop_last` off.

    Attributes:
        samples: samples of the mixture.
        global_batch: samples per optimizer step.
        steps_per_epoch, total_steps: optimizer steps.
        samples_per_epoch: samples that the steps of an epoch have room for.
        padded_samples: the part of that room which the mixture does not fill.
    """

    samples: int
    global_batch: int
    steps_per_epoch: int
    total_steps: int
    samples_per_epoch: int
    padded_samples: int


def training_arithmetic(samples: int, stage: TrainingStage) -> TrainingArithmetic:
    """Steps and samples of one stage of training on a mixture of so many samples."""
    steps = math.ceil(samples / stage.global_batch)
    room = steps * stage.global_batch
    return TrainingArithmetic(samples, stage.global_batch, steps, stage.epochs * steps, room, room - samples)


def parse_stage(text: str) -> TrainingStage:
    """Read DEVICESxBATCHxACCUMULATIONxEPOCHS, such as 8x1x4x3.

    Raises:
        InputError: it is not four positive numbers.
    """
    match = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)x([1-9]\d*)x([1-9]\d*)", text)
    if match is None:
        raise InputError(
            f"stage {text!r}: write DEVICESxBATCHxACCUMULATIONxEPOCHS, four positive numbers such as {PAPER_STAGES[0]}"
        )
    return TrainingStage(*map(int, match.groups()))
