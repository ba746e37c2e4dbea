"""A toy policy that is trained in under a minute on made-up curves, for a benchmark that is given no other."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from olt_generator.seeds import make_generator
from olt_sft_recipes.benchmarks.motions import drive
from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.toy.policy import ToyPolicy, load_toy
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.two_stages import train_two_stages
from olt_toolkit import PolicySample, SampleKey
from olt_toolkit.policy.contract import IMAGE_FRAMES

TRAINED, HELD_OUT, EPOCHS = 64, 24, 8
HEIGHT, WIDTH = 32, 64


def made_up_samples(count: int, seed: int) -> list[PolicySample]:
    """Curves at 4 to 10 m/s; where the road goes can be seen in the images alone, as a bright column."""
    draw, contract = make_generator("made-up samples", seed), ToyPolicyConfig().contract
    samples = []
    for number in range(count):
        bend, speed = draw.uniform(-0.03, 0.03), draw.uniform(4.0, 10.0)
        motion = drive(
            lambda times, speed=speed: np.full_like(times, speed),
            lambda times, bend=bend: np.where(times < 0.0, 0.0, bend),
        )
        history_xyz, history_rotation, future_xyz, future_rotation = (
            part.astype(np.float32) for part in motion.poses()
        )
        images = np.full((len(contract.cameras), IMAGE_FRAMES, 3, HEIGHT, WIDTH), 40, np.uint8)
        column = round(WIDTH / 2 - 0.45 * WIDTH * bend / 0.03)
        images[..., column : column + 2] = 250
        samples.append(
            PolicySample(
                image_frames=images,
                camera_indices=np.array(contract.indices, dtype=np.int64),
                ego_history_xyz=history_xyz,
                ego_history_rot=history_rotation,
                ego_future_xyz=future_xyz,
                ego_future_rot=future_rotation,
                relative_timestamps=np.zeros(images.shape[:2], np.float32),
                absolute_timestamps=np.zeros(images.shape[:2], np.int64),
                t0_us=2_000_000,
                clip_id=f"made up {number}",
            )
        )
    return samples


def train_quick_toy(out: Path) -> tuple[ToyPolicy, list[PolicySample]]:
    """Train both stages into `out`; the policy, and samples that it did not see."""
    samples = made_up_samples(TRAINED, 0)
    by_key = {SampleKey("made up", sample.clip_id, sample.t0_us): sample for sample in samples}
    keys = list(by_key)

    def batches(epoch: int, size: int) -> list[Sequence[SampleKey]]:
        order = make_generator("quick toy", epoch).permutation(len(keys))
        return [[keys[row] for row in order[start : start + size]] for start in range(0, len(keys), size)]

    shared: dict[str, Any] = {
        "num_train_epochs": EPOCHS,
        "per_device_train_batch_size": 8,
        "warmup_steps": 5,
        "seed": 0,
    }
    stages = (
        StageConfig(stage=1, seed=0, learning_rate=1e-3, regression_warmup_epochs=EPOCHS - 3, **shared),
        StageConfig(stage=2, seed=0, learning_rate=2e-3, **shared),
    )
    config = ToyPolicyConfig(image_height=HEIGHT, image_width=WIDTH, image_top=0, chooses_plan=False)
    train_two_stages(stages, batches, lambda wanted: [by_key[key] for key in wanted], out, config)
    return load_toy(str(out / "policy")), made_up_samples(HELD_OUT, 1)
