"""Steps and samples of a training run on a mixture (docs/formats/paper.md)."""

import math
import re
from dataclasses import dataclass

from olt_generator.errors import InputError


@dataclass(frozen=True)
class TrainingStage:
    """How one stage of training divides a mixture, written as DEVICESxBATCHxACCUMULATIONxEPOCHS.

    A device takes `per_device_batch` samples a forward pass, and `accumulation` of these passes an optimizer step.
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


def training_arithmetic(samples: int, stage: TrainingStage) -> dict[str, int]:
    """Steps of one stage on a mixture of so many samples, as Hugging Face's Trainer counts with `drop_last` off.

    `samples_per_epoch` is what the steps of an epoch have room for, `padded_samples` what the mixture does not fill.
    """
    steps = math.ceil(samples / stage.global_batch)
    room = steps * stage.global_batch
    return {
        "samples": samples,
        "global_batch": stage.global_batch,
        "steps_per_epoch": steps,
        "total_steps": stage.epochs * steps,
        "samples_per_epoch": room,
        "padded_samples": room - samples,
    }


def parse_stage(text: str) -> TrainingStage:
    """Read DEVICESxBATCHxACCUMULATIONxEPOCHS, such as 8x1x4x3; InputError where it is not four positive numbers."""
    match = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)x([1-9]\d*)x([1-9]\d*)", text)
    if match is None:
        raise InputError(
            f"stage {text!r}: write DEVICESxBATCHxACCUMULATIONxEPOCHS, four positive numbers such as {PAPER_STAGES[0]}"
        )
    return TrainingStage(*map(int, match.groups()))
