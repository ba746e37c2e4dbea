"""Trains both stages on fabricated drives and writes the losses: one process, or one of those that torchrun starts."""

import json
import sys
from pathlib import Path

from olt_sft_recipes.training.processes import is_main_process
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.two_stages import train_two_stages
from olt_toolkit.policy.sample import SampleKey

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from conftest import TINY_CONFIG, make_sample

# Five samples a step do not divide by two processes, and the last step of an epoch has one sample for both.
SETTINGS = {"num_train_epochs": 3, "per_device_train_batch_size": 5, "learning_rate": 3e-3, "warmup_steps": 2}
AUGMENTED = {"mirror_probability": 0.5, "turn_degrees": 4.0, "move_metres": 0.5, "save_steps": 4}


def main(out: Path) -> None:
    keys = [SampleKey("store", f"clip{index:02d}", 2_000_000) for index in range(11)]
    drives = {key: make_sample(0.005 * (index - 5), 5.0 + index % 4) for index, key in enumerate(keys)}
    stages = (
        StageConfig(stage=1, hidden_token_probability=0.5, **SETTINGS, **AUGMENTED),
        StageConfig(stage=2, gradient_accumulation_steps=2, **SETTINGS, **AUGMENTED),
    )

    def batches(epoch: int, size: int) -> list[list[SampleKey]]:
        return [keys[start : start + size] for start in range(0, len(keys), size)]

    results = train_two_stages(stages, batches, lambda asked: [drives[key] for key in asked], out, TINY_CONFIG)
    if is_main_process():
        (out / "losses.json").write_text(json.dumps([result.losses for result in results]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
