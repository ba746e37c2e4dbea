"""Low-rank adapters (Hu et al., LoRA, 2022) on the backbone, and adapters of others in Wan's own names."""

import re
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from olt_generator.diffusion.config import LoraConfig
from olt_generator.errors import InputError
from olt_generator.metrics.weight_files import read_weights

if TYPE_CHECKING:
    from diffusers.models.transformers.transformer_wan_vace import WanVACETransformer3DModel

# Self-attention of DiT and VACE blocks.
SELF_ATTENTION = r"(blocks|vace_blocks)\.\d+\.attn1\.(to_q|to_k|to_v|to_out\.0)"

# Layers of a block: Wan's own name and that of diffusers.
_LAYERS = {
    **{
        f"{own}.{projection}": f"{diffusers}.{layer}"
        for own, diffusers in (("self_attn", "attn1"), ("cross_attn", "attn2"))
        for projection, layer in (("q", "to_q"), ("k", "to_k"), ("v", "to_v"), ("o", "to_out.0"))
    },
    "ffn.0": "ffn.net.0.proj",
    "ffn.2": "ffn.net.2",
}
_NAMES = "|".join(re.escape(name) for name in (*_LAYERS, *_LAYERS.values()))
# A prefix such as "diffusion_model." or "module.", the block, the layer, and which of the three tensors it is.
_KEY = re.compile(
    rf"(?:.*\.)?(?P<block>(?:vace_)?blocks\.\d+)\.(?P<layer>{_NAMES})\."
    r"(?:(?P<down>lora_[aA]|lora_down)|(?P<up>lora_[bB]|lora_up)|(?P<alpha>alpha))(?:\.default)?(?:\.weight)?"
)


def add_adapter(
    backbone: "WanVACETransformer3DModel", config: LoraConfig, layers: str | Collection[str] = SELF_ATTENTION
) -> None:
    """Put trainable adapters, which change nothing yet, on the layers of a pattern or of a list of names.

    Raises:
        InputError: peft is not installed.
    """
    try:
        import peft
    except ImportError as error:
        raise InputError("Adapters need peft; pip install 'olt-generator[learned]'") from error
    targets = layers if isinstance(layers, str) else sorted(layers)
    backbone.add_adapter(peft.LoraConfig(r=config.rank, lora_alpha=config.alpha, target_modules=targets))


def load_adapter(backbone: "WanVACETransformer3DModel", path: Path, alpha: int = LoraConfig.alpha) -> LoraConfig:
    """Put the adapter of a file on the backbone, in place of any that it has.

    Names are Wan's own (`blocks.0.self_attn.q.lora_a.weight`, as released) or those of diffusers, with lora_A and
    lora_B or lora_down and lora_up, and any prefix. Rank and layers are those of the file.

    Args:
        path: safetensors, or a state dictionary as saved by torch.
        alpha: by which over the rank the change is scaled, where the file does not tell it for each layer.

    Returns:
        Rank of the file, and the alpha with which it was put on.

    Raises:
        InputError: peft is not installed; a key is of no known layer or of none that this backbone has, a layer lacks
            one of its two tensors, or shapes do not fit.
    """
    pairs = _pair_tensors(path, read_weights(path))
    ranks = {len(pair["down"]) for pair in pairs.values()}
    if len(ranks) != 1:
        raise InputError(f"{path}: adapters of ranks {sorted(ranks)}; one rank is expected, and at least one layer")
    config = LoraConfig(ranks.pop(), alpha)
    for layer, pair in pairs.items():
        _check_shapes(path, backbone, layer, pair, config.rank)
    if getattr(backbone, "peft_config", None):
        backbone.delete_adapters(list(backbone.peft_config))
    add_adapter(backbone, config, pairs)
    for layer, pair in pairs.items():
        module: Any = backbone.get_submodule(layer)
        # Scales that the file tells go into one of the factors.
        scale = float(pair["alpha"]) / alpha if "alpha" in pair else 1.0
        _copy(module.lora_A["default"].weight, pair["down"])
        _copy(module.lora_B["default"].weight, scale * pair["up"])
    return config


def _pair_tensors(path: Path, tensors: dict[str, Tensor]) -> dict[str, dict[str, Tensor]]:
    """Tensors "down", "up" and perhaps "alpha" of each layer, by its name in diffusers."""
    pairs: dict[str, dict[str, Tensor]] = {}
    for key, tensor in tensors.items():
        match = _KEY.fullmatch(key)
        if match is None:
            raise InputError(
                f"{path}: {key!r} is no adapter of an attention or feed-forward layer of Wan2.1-VACE, and nothing is "
                "left out silently; take it out of the file, or give an adapter of this model"
            )
        layer = f"{match['block']}.{_LAYERS.get(match['layer'], match['layer'])}"
        kind = next(name for name in ("down", "up", "alpha") if match[name])
        if kind in pairs.setdefault(layer, {}):
            raise InputError(f"{path}: {key!r} is the second tensor for {layer}; give one adapter a file")
        pairs[layer][kind] = tensor
    for layer, pair in pairs.items():
        if not {"down", "up"} <= set(pair):
            raise InputError(f"{path}: {layer} has {' and '.join(sorted(pair))} alone; both factors are needed")
    return pairs


def _check_shapes(path: Path, backbone: nn.Module, layer: str, pair: dict[str, Tensor], rank: int) -> None:
    try:
        module: Any = backbone.get_submodule(layer)
    except AttributeError as error:
        raise InputError(f"{path}: {layer} is no layer of this backbone; give the adapter of its size") from error
    expected = {"down": (rank, module.in_features), "up": (module.out_features, rank)}
    for kind, shape in expected.items():
        if tuple(pair[kind].shape) != shape:
            raise InputError(
                f"{path}: {layer} {kind} is {tuple(pair[kind].shape)}, not {shape}; give the adapter of this backbone"
            )


@torch.no_grad()
def _copy(parameter: Tensor, values: Tensor) -> None:
    parameter.copy_(values)
