"""The toy VLA as one network."""

import torch
from torch import Tensor, nn

from olt_sft_recipes.action_expert import ActionExpert
from olt_sft_recipes.language_model import KeysValues, VisionLanguageModel
from olt_sft_recipes.toy_config import ToyPolicyConfig
from olt_sft_recipes.toy_inputs import PolicyInputs


class ToyModel(nn.Module):
    """The vision-language model that Stage 1 trains and the action expert that Stage 2 trains."""

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        self.config = config
        self.vlm = VisionLanguageModel(config)
        self.expert = ActionExpert(config)

    def say(self, inputs: PolicyInputs, words: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """States (n, 128, width) that say every future word after those not hidden, and actions (n, 64, 2)."""
        return self.vlm(inputs.images, inputs.history_tokens, inputs.motion, words, hidden)

    def look(self, inputs: PolicyInputs) -> Tensor:
        """Actions (n, 64, 2) as future-start sees them."""
        return self.vlm.look(inputs.images, inputs.history_tokens, inputs.motion)

    def cache(self, inputs: PolicyInputs) -> list[KeysValues]:
        """What the expert sees of the language model: keys and values up to future-start, without gradient."""
        with torch.no_grad():
            return self.vlm.prefix_cache(inputs.images, inputs.history_tokens, inputs.motion)
