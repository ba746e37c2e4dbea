"""What the checkpoint, tokens and environment of each Alpamayo must be (docs/formats/alpamayo.md, sft_recipes.md)."""

from dataclasses import dataclass

from olt_sft_recipes.preflight.names import PolicyName

FIRST_TRAJECTORY_ID = 151_669
"""Length of the vocabulary of Qwen3-VL, so the id of `<i0>`."""
SPECIAL_TOKENS, FEWEST_SPECIAL_TOKENS = 28, 6
"""Added after the trajectory tokens, with `add_special_tokens` and without."""
STAGE1_FIX = "9299254"
"""Commit of alpamayo-recipes before which Stage 2 silently trained on the base model."""

_PINS = {
    "torch": "==2.8.0",
    "transformers": "==4.57.1",
    "torchmetrics": "==1.8.2",
    "accelerate": ">=1.12.0",
    "torchvision": ">=0.23.0",
    "physical_ai_av": ">=0.2.0",
    "av": ">=16.0.1",
    "einops": ">=0.8.1",
    "hydra-core": ">=1.3.2",
    "hydra-colorlog": ">=1.2.0",
    "pandas": ">=2.3.3",
    "pillow": ">=12.0.0",
    "opencv-python": ">=4.10.0",
    "mediapy": ">=1.2.4",
    "rich": ">=14.3.3",
    "wandb": ">=0.25.0",
    "flash-attn": ">=2.8.3",
    "alpamayo_r1": "",
    "alpamayo-recipes": "",
}


@dataclass(frozen=True)
class Recipe:
    """A public SFT recipe: its package and what it pins (its pyproject at b790b8e)."""

    package: str
    pins: dict[str, str]
    python: str = "==3.12.*"


@dataclass(frozen=True)
class Profile:
    """One policy.

    Attributes:
        model_type: in the `config.json` that the recipe can read; None where no recipe exists.
        history_tokens, future_tokens: of one sample.
        history_bins, future_bins: of their tokenizers.
        history_first: whether the ids of the history come before those of the future.
        vlm: what processor and vocabulary are taken from.
        licences: reminders.
    """

    model_type: str | None
    history_tokens: int
    vlm: str
    licences: tuple[str, ...]
    history_first: bool = False
    recipe: Recipe | None = None
    future_tokens: int = 128
    history_bins: int = 1000
    future_bins: int = 3000
    min_pixels: int = 163_840
    max_pixels: int = 196_608

    @property
    def trajectory_vocabulary(self) -> int:
        """Trajectory tokens that are added to the vocabulary."""
        return self.history_bins + self.future_bins


_WEIGHTS = "weights of {}: gated, non-commercial licence of NVIDIA; accept it for your account, do not pass them on"
_DATA = (
    "PhysicalAI-AV data: gated, for development of automated driving with NVIDIA technology; views made from its "
    "frames count as derived data, which may not be passed on either"
)
_QWEN = "Qwen3-VL-8B-Instruct: Apache-2.0"

PROFILES: dict[str, Profile] = {
    PolicyName.ALPAMAYO_R1: Profile(
        "alpamayo_r1",
        48,
        "Qwen/Qwen3-VL-8B-Instruct",
        (_WEIGHTS.format("Alpamayo-R1-10B"), _DATA, _QWEN),
        recipe=Recipe("alpamayo1_sft", _PINS | {"deepspeed": "==0.18.2"}),
    ),
    # Its recipe reads a base that `convert_checkpoint.py to-a1` rewrote to the format of R1.
    PolicyName.ALPAMAYO_1_5: Profile(
        "alpamayo_r1",
        48,
        "Qwen/Qwen3-VL-8B-Instruct",
        (_WEIGHTS.format("Alpamayo-1.5-10B"), _DATA, _QWEN),
        recipe=Recipe("alpamayo1_5_sft", _PINS | {"deepspeed": "==0.19.1"}),
    ),
    PolicyName.ALPAMAYO_2: Profile(
        None,
        45,
        "the vision-language model that its config.json names",
        ("code of Alpamayo 2: Apache-2.0; its weights are gated, accept their licence for your account", _DATA),
        history_first=True,
    ),
}
