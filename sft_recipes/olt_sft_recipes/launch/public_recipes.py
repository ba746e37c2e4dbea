"""The public SFT recipes that can be launched (docs/formats/sft_recipes.md)."""

from dataclasses import dataclass
from typing import Literal

from olt_generator.errors import InputError

Stage = Literal[1, 2]


@dataclass(frozen=True)
class PublicRecipe:
    """One recipe of NVlabs/alpamayo-recipes.

    Attributes:
        policy: the policy that it trains; also its camera contract.
        package: its Python package, and its folder under `recipes/`.
        base: the released checkpoint on Hugging Face.
        shows_camera_names: the policy is told which camera and which frame each image is, as its `config.json` says.
        base_is_converted: the recipe reads its base only once `scripts/convert_checkpoint.py to-a1` rewrote its
            configuration.
    """

    policy: str
    package: str
    base: str
    shows_camera_names: bool
    base_is_converted: bool


PUBLIC_RECIPES = {
    recipe.policy: recipe
    for recipe in (
        PublicRecipe("alpamayo-r1", "alpamayo1_sft", "nvidia/Alpamayo-R1-10B", False, False),
        PublicRecipe("alpamayo-1.5", "alpamayo1_5_sft", "nvidia/Alpamayo-1.5-10B", True, True),
    )
}
VLM = "Qwen/Qwen3-VL-8B-Instruct"
"""Where both recipes take architecture, processor and vocabulary of the vision-language model from."""

MIN_PIXELS, MAX_PIXELS = 163_840, 196_608
"""The pixel budget of an image in a released `config.json`: 180 tokens, and not about 2,040."""


def find_public_recipe(policy: str) -> PublicRecipe:
    """The recipe of a policy; InputError where there is none."""
    if policy == "alpamayo-2":
        raise InputError(
            "alpamayo-2: there is no public SFT recipe of it, so nothing is launched; `olt data export MIXTURE --rig "
            "alpamayo-2` writes its data (six cameras) and `olt sft preflight --policy alpamayo-2` looks at them"
        )
    if policy not in PUBLIC_RECIPES:
        raise InputError(f"policy {policy!r}: no recipe; choose one of {', '.join(PUBLIC_RECIPES)}")
    return PUBLIC_RECIPES[policy]
