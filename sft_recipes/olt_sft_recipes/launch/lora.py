"""Adapters in place of full fine-tuning in Stage 1, where the recipe has them.

The recipes of NVlabs/alpamayo-recipes have none at b790b8e; forks add a group of configurations `lora`, whose defaults
leave embeddings, output head and image encoder trainable, 1.85 B parameters beside 43.6 M of adapters.
"""

from pathlib import Path
from typing import Any

from olt_generator.errors import InputError
from olt_sft_recipes.launch.trainable import LORA_ALPHA, LORA_RANK
from olt_toolkit.runtime.yaml_files import read_yaml_mapping

_FREEZES = "freeze_non_adapted"


def lora_groups(recipe: Path) -> tuple[dict[str, str], dict[str, Any]]:
    """The group that is added to Stage 1, and the values in it: everything but the adapters is frozen.

    Raises:
        InputError: the recipe has no adapters, or cannot freeze the rest.
    """
    path = recipe / "configs" / "lora" / "default.yaml"
    if not path.is_file():
        raise InputError(
            f"{recipe}: --lora: this recipe has no adapters (no configs/lora/default.yaml), as NVlabs/alpamayo-recipes "
            "at b790b8e; train the whole vision-language model, or give --recipes of a fork that has them"
        )
    content = read_yaml_mapping(path, "configuration of adapters", ("r", "alpha", _FREEZES))
    if _FREEZES not in content or "r" not in content or "alpha" not in content:
        raise InputError(
            f"{path}: --lora: it has no {_FREEZES}, r and alpha, so embedding, output head and image encoder would be "
            "trained beside the adapters (1.85 B parameters); use a fork that can freeze them"
        )
    values: dict[str, Any] = {f"lora.{_FREEZES}": True, "lora.r": LORA_RANK, "lora.alpha": LORA_ALPHA}
    # Adapters are trained at ten times the rate, and there is no image encoder left to train at a tenth.
    return {"lora@lora": "default"}, values | {"trainer.learning_rate": 1e-4, "trainer.lr_multiplier": None}
