"""How many parameters each part of an Alpamayo has, from the headers of a checkpoint or from published sizes.

Names and shapes are those of Qwen3-VL in transformers (docs/formats/alpamayo.md, "Expert").
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.plan import StagePlan
from olt_sft_recipes.preflight.profiles import FIRST_TRAJECTORY_ID, SPECIAL_TOKENS
from olt_sft_recipes.preflight.safetensors_files import StoredTensor


@dataclass(frozen=True)
class TextShape:
    """A stack of Qwen3 decoder layers; sizes in values. `vocabulary` is 0 where it has neither embedding nor head."""

    width: int
    layers: int
    heads: int
    key_value_heads: int
    head_width: int
    perceptron_width: int
    vocabulary: int = 0

    @property
    def query_width(self) -> int:
        """Of all heads together."""
        return self.heads * self.head_width

    @property
    def key_width(self) -> int:
        """Of all key heads together, and of all value heads."""
        return self.key_value_heads * self.head_width

    @property
    def layer_parameters(self) -> int:
        """Of one layer: projections, perceptron, two norms of the stream and two of heads."""
        attention = 2 * self.width * (self.query_width + self.key_width)
        norms = 2 * self.width + 2 * self.head_width
        return attention + 3 * self.width * self.perceptron_width + norms


@dataclass(frozen=True)
class VisionShape:
    """The image encoder of Qwen3-VL."""

    width: int = 1152
    blocks: int = 27
    perceptron_width: int = 4304
    patch_values: int = 3 * 2 * 16 * 16
    positions: int = 2304
    merged: int = 4
    mergers_of_depth: int = 3

    def parameters(self, text_width: int) -> int:
        """Of patches, positions, blocks, and the mergers to the width of the language model."""
        w, inner = self.width, self.merged * self.width
        block = 4 * w + 4 * (w * w + w) + 2 * w * self.perceptron_width + self.perceptron_width + w
        merger = inner * inner + inner + inner * text_width + text_width
        norms = 2 * w + self.mergers_of_depth * 2 * inner
        patches = self.patch_values * w + w + self.positions * w
        return patches + self.blocks * block + (1 + self.mergers_of_depth) * merger + norms


@dataclass(frozen=True)
class ModelSizes:
    """Parameters by part, and the shapes that activations follow from; `source` tells where from.

    The parts are `visual`, `embedding`, `layers`, `head` of the language model, and `expert` with its projections.
    """

    parameters: Mapping[str, int]
    text: TextShape
    expert: TextShape
    vision: VisionShape
    source: str

    @property
    def total(self) -> int:
        """Of all parts."""
        return sum(self.parameters.values())

    @property
    def language_model(self) -> int:
        """Of the vision-language model."""
        return self.total - self.parameters["expert"]

    def trainable(self, stage: StagePlan) -> dict[str, int]:
        """Parameters that a stage trains, by part; adapters stand in place of the layers."""
        if stage.stage == 2:
            return {"expert": self.parameters["expert"]}
        parts = {name: count for name, count in self.parameters.items() if name != "expert"}
        if stage.lora_rank is None:
            return parts
        adapters = {"adapters": adapter_parameters(self.text, stage.lora_rank)}
        return adapters if stage.lora_freezes_rest else adapters | {k: v for k, v in parts.items() if k != "layers"}


def adapter_parameters(text: TextShape, rank: int) -> int:
    """Of LoRA on all seven projections of every layer: rank times inputs and outputs of each."""
    attention = 2 * (text.width + text.query_width) + 2 * (text.width + text.key_width)
    return rank * text.layers * (attention + 3 * (text.width + text.perceptron_width))


QWEN3_VL_8B = TextShape(4096, 36, 32, 8, 128, 12_288, FIRST_TRAJECTORY_ID + 4000 + SPECIAL_TOKENS)
EXPERT = TextShape(2048, 36, 16, 8, 128, 8256)
_ACTION_WIDTH, _ACTION_FEATURES = 512, 3 * 20


def published_sizes() -> ModelSizes:
    """Those of Alpamayo-R1 and 1.5: Qwen3-VL-8B with the trajectory tokens, and the expert of the released file."""
    width, text = _ACTION_WIDTH, QWEN3_VL_8B
    perceptron = _ACTION_FEATURES * width + width + 2 * width + width * width + width
    projections = perceptron + width * EXPERT.width + EXPERT.width + 2 * EXPERT.width + 2 * EXPERT.width + 2
    words = text.vocabulary * text.width
    parts = {
        "visual": VisionShape().parameters(text.width),
        "embedding": words,
        "layers": text.layers * text.layer_parameters + text.width,
        "head": words,
        "expert": EXPERT.layers * EXPERT.layer_parameters + EXPERT.width + projections,
    }
    return ModelSizes(parts, text, EXPERT, VisionShape(), "published sizes of Qwen3-VL-8B and the expert")


def sizes_of_checkpoint(tensors: Mapping[str, StoredTensor], source: str) -> ModelSizes:
    """Those that the headers of a released checkpoint tell.

    Raises:
        InputError: tensors that tell the shapes are not there.
    """
    parts: dict[str, int] = {"visual": 0, "embedding": 0, "layers": 0, "head": 0, "expert": 0}
    for name, tensor in tensors.items():
        parts[_part_of(name)] += tensor.count
    try:
        text, expert = _text_shape(tensors, "vlm."), _text_shape(tensors, "expert.")
        return ModelSizes(parts, text, expert, _vision_shape(tensors), source)
    except (LookupError, ValueError, ZeroDivisionError) as error:
        raise InputError(f"{source}: its tensors are not those of an Alpamayo ({error})") from error


def _part_of(name: str) -> str:
    if not name.startswith("vlm."):
        return "expert"
    marks = {".visual.": "visual", "embed_tokens": "embedding", "lm_head": "head"}
    return next((part for mark, part in marks.items() if mark in name), "layers")


def _text_shape(tensors: Mapping[str, StoredTensor], prefix: str) -> TextShape:
    shapes = {
        name: tensor.shape for name, tensor in tensors.items() if name.startswith(prefix) and ".visual." not in name
    }

    def shape(ending: str) -> tuple[int, ...]:
        found = next((value for name, value in shapes.items() if name.endswith(ending)), None)
        if found is None:
            raise LookupError(f"no {prefix}*{ending}")
        return found

    queries, width = shape("layers.0.self_attn.q_proj.weight")
    (head_width,) = shape("layers.0.self_attn.q_norm.weight")
    vocabulary = next((value[0] for name, value in shapes.items() if name.endswith("embed_tokens.weight")), 0)
    return TextShape(
        width=width,
        layers=sum(name.endswith("self_attn.q_proj.weight") for name in shapes),
        heads=queries // head_width,
        key_value_heads=shape("layers.0.self_attn.k_proj.weight")[0] // head_width,
        head_width=head_width,
        perceptron_width=shape("layers.0.mlp.gate_proj.weight")[0],
        vocabulary=vocabulary,
    )


def _vision_shape(tensors: Mapping[str, StoredTensor]) -> VisionShape:
    shapes = {name.partition(".visual.")[2]: tensor.shape for name, tensor in tensors.items() if ".visual." in name}
    perceptron_width, width = shapes["blocks.0.mlp.linear_fc1.weight"]
    return VisionShape(
        width=width,
        blocks=sum(name.startswith("blocks.") and name.endswith("norm1.weight") for name in shapes),
        perceptron_width=perceptron_width,
        patch_values=math.prod(shapes["patch_embed.proj.weight"][1:]),
        positions=shapes["pos_embed.weight"][0],
    )
