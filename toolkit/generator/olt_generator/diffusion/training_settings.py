"""How an engine is trained; the defaults are the paper's (table of fine-tuning) and the released generator's."""

from dataclasses import dataclass, field
from typing import Literal

from olt_generator.errors import InputError


@dataclass(frozen=True)
class OptimizerSettings:
    """AdamW and its schedule.

    Attributes:
        steps: optimizer steps.
        batch: samples of a step, over all processes.
        adapter_rate, new_rate: largest learning rates of the adapters, and of all else that is trained.
        weight_decay: of all but the adapters, which have none.
        warmup, least_ratio: steps over which the rate rises, and the share of it at the end of the cosine.
        clip: largest norm of the gradient.
        average: share of the running mean of the weights that a step keeps.
        save_every: steps between checkpoints.

    Raises:
        InputError: a number has no sense.
    """

    steps: int = 20_000
    batch: int = 32
    adapter_rate: float = 1e-5
    new_rate: float = 1e-5
    weight_decay: float = 0.1
    betas: tuple[float, float] = (0.9, 0.95)
    warmup: int = 500
    least_ratio: float = 0.1
    clip: float = 0.5
    average: float = 0.999
    save_every: int = 500

    def __post_init__(self) -> None:
        positive = {"steps": self.steps, "batch": self.batch, "clip": self.clip, "save_every": self.save_every}
        for name, value in positive.items():
            if not value > 0:
                raise InputError(f"{name}: {value} is not more than 0")
        if self.warmup < 0 or not 0.0 <= self.least_ratio <= 1.0 or not 0.0 <= self.average < 1.0:
            raise InputError("warmup, least_ratio, average: give 0 or more steps, and shares from 0 to 1")


@dataclass(frozen=True)
class FlowSettings:
    """What a training sample of the flow is made of.

    Attributes:
        rear_weight: lambda_rear, the weight of the loss of view 5 (the released scripts' value).
        text_drop: probability that a sample gets no prompt.
        shift: of the noise levels (`sampling.shift_sigma`).
        front_noise, neighbour_noise: probability that the front view, or another condition, is noised, and the lowest
            and highest noise level that it then gets.
        use_warp: False to train without the warp, to measure what it is worth.
        seen_weight: weight of the loss where a warp saw everything; it is 1 where none saw anything. The paper's is 1.
            Less helps a small engine, whose seen pixels are taken from the warp.

    Raises:
        InputError: a number has no sense.
    """

    rear_weight: float = 0.5
    text_drop: float = 0.1
    shift: float = 3.0
    front_noise: tuple[float, float, float] = (0.05, 0.005, 0.03)
    neighbour_noise: tuple[float, float, float] = (0.3, 0.02, 0.15)
    use_warp: bool = True
    seen_weight: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < self.seen_weight <= 1.0:
            raise InputError(f"seen_weight: {self.seen_weight} is not more than 0 and at most 1")


@dataclass(frozen=True)
class TrainingSettings:
    """Everything that a training run depends on beside its data.

    Attributes:
        width, height, frames: of the straight-lined videos, multiples of 16 pixels and 4 k + 1 frames.
        windows: most windows of a drive, spread over its length.
        seen, unseen: shares of the windows of training drives, and of the drives, that are kept for evaluation.
        precision: of the forward pass; trained weights are kept in single precision always.
        whole_backbone: train the backbone itself and its autoencoder, from random weights, and not adapters alone.
        autoencoder: how the autoencoder is trained, where it is.
        optimizer, flow: how the model is trained.
    """

    width: int = 832
    height: int = 480
    frames: int = 41
    windows: int = 3
    seen: float = 0.1
    unseen: float = 0.1
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    whole_backbone: bool = False
    autoencoder: OptimizerSettings = field(default_factory=OptimizerSettings)
    optimizer: OptimizerSettings = field(default_factory=OptimizerSettings)
    flow: FlowSettings = field(default_factory=FlowSettings)


TRAININGS: dict[str, TrainingSettings] = {
    "1.3B": TrainingSettings(),
    # Chosen so that drives, autoencoder and model take about a quarter of an hour of one processor.
    "tiny": TrainingSettings(
        width=80,
        height=48,
        frames=9,
        windows=3,
        precision="float32",
        whole_backbone=True,
        autoencoder=OptimizerSettings(
            steps=3000, batch=2, new_rate=4e-3, weight_decay=0.0, warmup=50, clip=1.0, average=0.99, save_every=500
        ),
        optimizer=OptimizerSettings(
            steps=2000, batch=8, adapter_rate=1e-3, new_rate=1e-3, weight_decay=0.01, warmup=100, clip=1.0,
            average=0.99, save_every=200,
        ),
        flow=FlowSettings(seen_weight=0.1),
    ),
}  # fmt: skip
