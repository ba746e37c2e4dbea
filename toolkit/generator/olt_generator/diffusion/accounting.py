"""What an engine costs without building it: parameters, operations and memory, counted on tensors without content.

Operations and memory are those of the code itself, run with torch's fake tensors of the size asked for.
"""

import re
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor, nn
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import FlopCounterMode

from olt_generator.diffusion.backbone import build_autoencoder
from olt_generator.diffusion.conditioned_model import ConditionedModel, Conditions, build_model, cast
from olt_generator.diffusion.config import CELL_PIXELS, CONTROL_CHANNELS, LATENT_CHANNELS, PATCH, EngineConfig
from olt_generator.diffusion.latents import latent_frames
from olt_generator.diffusion.memory_bank import ConditionViews
from olt_generator.diffusion.view_graph import CONDITIONS
from olt_generator.errors import InputError

# Parts of the conditioned model, and what the names of their parameters begin with.
_PARTS = {
    "DiT": r"backbone\.(?!vace)(?!.*lora_)",
    "VACE branch": r"backbone\.vace(?!.*lora_)",
    "LoRA, self-attention of DiT": r"backbone\.blocks.*lora_",
    "LoRA, self-attention of VACE": r"backbone\.vace_blocks.*lora_",
    "geometry encoder, rays": r"geometry\.rays",
    "geometry encoder, camera and role": r"geometry\.(camera|role)",
    "geometry encoder, ego motion": r"geometry\.motion",
    "memory bank, adapter blocks": r"memory_bank\.(adapters|norm)",
    "memory bank, resampler": r"memory_bank\.resampler",
    "memory, dense attention": r"memory_attention\.\d+\.(dense|norm)",
    "memory, semantic attention": r"memory_attention\.\d+\.semantic",
    "memory, gates": r"memory_attention\.\d+\.gates",
}


@dataclass(frozen=True)
class PartSize:
    """Parameters of one part of an engine, and whether they are trained."""

    name: str
    parameters: int
    trainable: bool


@dataclass(frozen=True)
class Cost:
    """What one call costs.

    Attributes:
        flops: floating point operations of matrix products, convolutions and attention; a multiplication and an
            addition are two.
        peak_bytes: most bytes that tensors made in the call hold at once, beside weights and inputs.
    """

    flops: int
    peak_bytes: int


@dataclass(frozen=True)
class ViewCost:
    """What sampling one view costs, beside the autoencoder's work.

    Attributes:
        conditions: views that it is conditioned on.
        step: one pass of the network.
        remember: making the memory, once a view.
        flops: of all passes and of the memory.
    """

    conditions: int
    step: Cost
    remember: Cost
    flops: int


@dataclass(frozen=True)
class ClipCost:
    """What the views of a clip cost.

    Attributes:
        views: by id.
        encode, decode: one video through the autoencoder, in single precision.
        flops: of all views, of the front video and each warp encoded, and of each view decoded.
    """

    views: dict[int, ViewCost]
    encode: Cost
    decode: Cost
    flops: int


def weight_bytes(config: EngineConfig, dtype: torch.dtype) -> int:
    """Bytes of transformer and conditioning modules, brought to a precision as by `cast` for inference."""
    return sum(parameter.numel() * parameter.element_size() for parameter in _outline(config, dtype).parameters())


def describe_parts(config: EngineConfig) -> tuple[PartSize, ...]:
    """Parameters of all parts, frozen ones first."""
    with torch.device("meta"):
        autoencoder = build_autoencoder(config.autoencoder)
    parts = [PartSize("video autoencoder", sum(parameter.numel() for parameter in autoencoder.parameters()), False)]
    named = dict(_outline(config, torch.float32).named_parameters())
    for part, pattern in _PARTS.items():
        of_part = [parameter for name, parameter in named.items() if re.match(pattern, name)]
        trainable = all(parameter.requires_grad for parameter in of_part)
        parts.append(PartSize(part, sum(parameter.numel() for parameter in of_part), trainable))
    return tuple(parts)


def cost_of_view(
    config: EngineConfig,
    size: tuple[int, int, int],
    conditions: int,
    passes: int,
    dtype: torch.dtype = torch.bfloat16,
    text_tokens: int = 256,
) -> ViewCost:
    """What it costs to sample a view.

    Args:
        size: frames, rows and columns of the video in pixels.
        conditions: views that it is conditioned on.
        passes: of the network: steps, times two where there is guidance.
        dtype: precision of weights and activations.
        text_tokens: length of the prompt.

    Raises:
        InputError: frames that are not 4 k + 1, or an image that does not fill tokens.
    """
    model = _outline(config, dtype)
    with FakeTensorMode() as fake:
        weights = _empty_weights(model, fake)
        latents, conditioned = make_inputs(config, size, conditions, text_tokens)
        sigma = torch.zeros(1)
        views = conditioned.views
        memory, remembering = None, Cost(0, 0)
        if views is not None:
            remembering = cost_of(lambda: _call(model, weights, "remember", views, conditioned.motion))
            with torch.no_grad():
                memory = _call(model, weights, "remember", views, conditioned.motion)
        step = cost_of(lambda: _call(model, weights, "forward", latents, sigma, conditioned, memory))
    return ViewCost(conditions, step, remembering, passes * step.flops + remembering.flops)


def cost_of_clip(
    config: EngineConfig, size: tuple[int, int, int], views: Sequence[int], passes: int, dtype: torch.dtype
) -> ClipCost:
    """What it costs to generate the views of a clip by their ids; arguments and errors are those of `cost_of_view`."""
    counts = {len(CONDITIONS[view]) for view in views}
    by_count = {count: cost_of_view(config, size, count, passes, dtype) for count in sorted(counts)}
    costs = {view: by_count[len(CONDITIONS[view])] for view in views}
    encode, decode = cost_of_autoencoder(config, size)
    coding = encode.flops + len(views) * (encode.flops + decode.flops)
    return ClipCost(costs, encode, decode, coding + sum(cost.flops for cost in costs.values()))


def cost_of_autoencoder(config: EngineConfig, size: tuple[int, int, int]) -> tuple[Cost, Cost]:
    """What it costs to encode a video of so many frames, rows and columns, and to decode its latents."""
    frames, height, width = size
    with torch.device("meta"):
        autoencoder: Any = build_autoencoder(config.autoencoder)
    with FakeTensorMode() as fake:
        weights = _empty_weights(autoencoder, fake)
        video = torch.zeros(1, 3, frames, height, width)
        latents = torch.zeros(1, LATENT_CHANNELS, *_latent_size(size))
        return (
            cost_of(lambda: _call(autoencoder, weights, "_encode", video)),
            cost_of(lambda: _call(autoencoder, weights, "_decode", latents)),
        )


def cost_of(call: Callable[[], Any]) -> Cost:
    """What a call costs, whether its tensors have content or not; gradients are not computed."""
    peak = _PeakMemory()
    with torch.no_grad(), FlopCounterMode(display=False) as counter, peak:
        call()
    return Cost(counter.get_total_flops(), peak.most)


def make_inputs(
    config: EngineConfig, size: tuple[int, int, int], conditions: int, text_tokens: int = 256
) -> tuple[Tensor, Conditions]:
    """Latents and conditions of one view of zeros, to measure with.

    Raises:
        InputError: frames that are not 4 k + 1, or an image that does not fill tokens.
    """
    frames, rows, columns = _latent_size(size)
    tokens = (frames, rows // PATCH, columns // PATCH)
    views = None
    if conditions and config.conditioning.memory:
        views = ConditionViews(
            torch.zeros(1, conditions, LATENT_CHANNELS, frames, rows, columns),
            torch.zeros(1, conditions, dtype=torch.long),
            torch.zeros(1, conditions, 6, *tokens),
        )
    given = Conditions(
        text=torch.zeros(1, text_tokens, config.backbone.text_dim),
        camera=torch.zeros(1, dtype=torch.long),
        rays=torch.zeros(1, 6, *tokens),
        motion=torch.zeros(1, frames, 6),
        control=torch.zeros(1, CONTROL_CHANNELS, frames, rows, columns),
        views=views,
    )
    return torch.zeros(1, LATENT_CHANNELS, frames, rows, columns), given


def compare_with_paper(config: EngineConfig) -> tuple[tuple[str, str, str], ...]:
    """Rows (item, paper, here) of the paper's table of fine-tuning that sizes can be held against.

    The paper counts no parameters.
    """
    backbone, conditioning, lora = config.backbone, config.conditioning, config.lora
    frames, rows, columns = _latent_size((41, 480, 832))
    return (
        ("latents of 41 frames of 480 x 832", "11 x 60 x 104", f"{frames} x {rows} x {columns}"),
        ("target views", "5", str(len(CONDITIONS) - 1)),
        ("LoRA rank / alpha", "32 / 16", f"{lora.rank} / {lora.alpha:g}"),
        ("DiT layers", "30", str(backbone.layers)),
        ("memory layers", "4, 9, 14, 19, 24, 29", ", ".join(map(str, conditioning.memory_layers))),
        ("semantic queries", "64", str(conditioning.queries)),
        ("gate bias", "-1.4", f"{conditioning.gate_bias:g}"),
        ("trained parameters", "not stated", f"{sum(p.parameters for p in describe_parts(config) if p.trainable):,}"),
    )


def _latent_size(size: tuple[int, int, int]) -> tuple[int, int, int]:
    frames, height, width = size
    token = PATCH * CELL_PIXELS
    if height % token or width % token:
        raise InputError(f"{width} x {height} pixels do not fill tokens of {token} x {token}; give 832 x 480 or so")
    return latent_frames(frames), height // CELL_PIXELS, width // CELL_PIXELS


@lru_cache(maxsize=2)
def _outline(config: EngineConfig, dtype: torch.dtype) -> ConditionedModel:
    """The model without weights, in a precision."""
    with torch.device("meta"):
        model = build_model(config)
    cast(model, dtype, trainable=True)
    return model


def _empty_weights(model: nn.Module, fake: FakeTensorMode) -> dict[str, Tensor]:
    """Parameters and buffers on the processor, without content."""
    with fake:
        return {
            name: torch.empty(tensor.shape, dtype=tensor.dtype)
            for name, tensor in (*model.named_parameters(), *model.named_buffers())
        }


class _Method(nn.Module):
    """A method of a module as a module of its own, because only those can be called with other weights."""

    def __init__(self, module: nn.Module, method: str) -> None:
        super().__init__()
        self.module, self._method = module, method

    def forward(self, *arguments: Any) -> Any:
        return getattr(self.module, self._method)(*arguments)


def _call(module: nn.Module, weights: dict[str, Tensor], method: str, *arguments: Any) -> Any:
    prefixed = {f"module.{name}": tensor for name, tensor in weights.items()}
    return torch.func.functional_call(_Method(module, method), prefixed, arguments)


class _PeakMemory(TorchDispatchMode):
    """Follows the bytes of the storages that operations make, until nothing refers to them."""

    def __init__(self) -> None:
        super().__init__()
        self.most = 0
        self._now = 0
        self._known: weakref.WeakSet[Any] = weakref.WeakSet()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        for tensor in _tensors(args):
            self._known.add(tensor.untyped_storage())
        result = func(*args, **(kwargs or {}))
        for tensor in _tensors(result):
            self._add(tensor.untyped_storage())
        return result

    def _add(self, storage: torch.UntypedStorage) -> None:
        if storage not in self._known:
            self._known.add(storage)
            self._now += storage.nbytes()
            self.most = max(self.most, self._now)
            weakref.finalize(storage, self._forget, storage.nbytes())

    def _forget(self, count: int) -> None:
        self._now -= count


def _tensors(tree: Any) -> list[Tensor]:
    return [leaf for leaf in tree_leaves(tree) if isinstance(leaf, Tensor)]
