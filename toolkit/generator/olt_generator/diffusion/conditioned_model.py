"""The paper's network: Wan2.1-VACE, told of rays, warps and other views.

The forward pass is that of the backbone with three additions: the geometry encoding at both of its entries and in the
memory, and attention to the memory after some blocks. Until they are trained they add nothing, and the output is the
backbone's. (The released generator also joins the clean front view to the target's tokens; here, as in the paper's
text, the front view comes in through warp and memory, which halves the tokens.)
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from olt_generator.diffusion.adapters import add_adapter
from olt_generator.diffusion.backbone import TIME_SCALE, build_backbone
from olt_generator.diffusion.config import PATCH, EngineConfig
from olt_generator.diffusion.geometry_encoder import GeometryEncoder, Role
from olt_generator.diffusion.memory_bank import ConditionViews, Memory, MemoryAttention, MemoryBank

if TYPE_CHECKING:
    from diffusers.models.transformers.transformer_wan_vace import WanVACETransformer3DModel


@dataclass(frozen=True)
class Conditions:
    """All that a target view is conditioned on.

    Attributes:
        text: (b, l, text_dim) embedding of the prompt, or of the empty one.
        camera: (b,) int64 view ids.
        rays: (b, 6, t, h / 2, w / 2) of `views.plucker.plucker_rays`, one a token.
        motion: (b, t, 6) of `geometry_encoder.ego_motion_features`.
        control: (b, 96, t, h, w) of `warp_control.vace_control` or `no_warp`.
        views: what the memory is made of; None for no memory.
    """

    text: Tensor
    camera: Tensor
    rays: Tensor
    motion: Tensor
    control: Tensor
    views: ConditionViews | None


class ConditionedModel(nn.Module):
    """Predicts the velocity eps - z of a view's latents.

    Trainable are the adapters of the backbone and all other modules; the backbone itself is frozen.

    Args:
        backbone: as it comes from `backbone.load_backbone` or `build_backbone`, without adapters.
        config: sizes of everything but the backbone, which brings its own.
    """

    def __init__(self, backbone: "WanVACETransformer3DModel", config: EngineConfig) -> None:
        super().__init__()
        dim, heads, conditioning = config.backbone.dim, config.backbone.heads, config.conditioning
        self.config = config
        self.backbone = backbone.requires_grad_(False)
        add_adapter(self.backbone, config.lora)
        self.geometry = GeometryEncoder(dim, conditioning.hidden, conditioning.plucker)
        self.memory_bank = MemoryBank(dim, heads, conditioning) if conditioning.memory else None
        layers = conditioning.memory_layers if conditioning.memory else ()
        self.memory_attention = nn.ModuleDict(
            {str(layer): MemoryAttention(dim, heads, conditioning) for layer in layers}
        )
        # Recompute blocks in the backward pass instead of keeping what is inside of them.
        self.gradient_checkpointing = False

    def remember(self, views: ConditionViews, motion: Tensor) -> Memory | None:
        """The memory of these views, for all steps of a target; None where the configuration has none.

        Args:
            motion: (b, t, 6), as of `Conditions`.
        """
        if self.memory_bank is None:
            return None
        batch, slots = views.camera.shape
        tokens = _tokens(self.backbone.patch_embedding, views.latents.flatten(0, 1))
        encoding = self.geometry(
            views.rays.flatten(0, 1),
            views.camera.flatten(),
            Role.CONDITION,
            motion.repeat_interleave(slots, dim=0),
        )
        # (b s, t p, d) -> (b, s, t, p, d)
        by_frame = (tokens.to(encoding.dtype) + encoding).unflatten(1, (motion.shape[1], -1))
        return self.memory_bank(by_frame.unflatten(0, (batch, slots)), views.filled)

    def forward(self, latents: Tensor, sigma: Tensor, conditions: Conditions, memory: Memory | None = None) -> Tensor:
        """Velocities (b, 16, t, h, w) of noisy latents (b, 16, t, h, w), in their type.

        Args:
            sigma: (b,) noise levels from 0 to 1, each sample its own.
            memory: of `remember`, which spares making it again; made from `conditions.views` where None is given.
        """
        if memory is None and conditions.views is not None:
            memory = self.remember(conditions.views, conditions.motion)
        backbone = self.backbone
        run: Callable[..., Any] = partial(checkpoint, use_reentrant=False) if self._checkpoints else _call
        geometry = self.geometry(conditions.rays, conditions.camera, Role.TARGET, conditions.motion)
        rotary = backbone.rope(latents)
        entry = _tokens(backbone.patch_embedding, latents)
        entry = entry + geometry.to(entry.dtype)
        control = _tokens(backbone.vace_patch_embedding, conditions.control)
        control = control + geometry.to(control.dtype)
        time, modulation, text, _ = backbone.condition_embedder(
            TIME_SCALE * sigma, conditions.text.to(entry.dtype), None
        )
        modulation = modulation.unflatten(1, (6, -1))
        vace_blocks = iter(backbone.vace_blocks)
        hidden = entry
        for layer, block in enumerate(backbone.blocks):
            hidden = run(block, hidden, text, modulation, rotary)
            if layer in self.config.backbone.vace_layers:
                # A control block is run where its hint is due, so that no other hint waits in memory.
                hint, control = run(next(vace_blocks), entry, text, control, modulation, rotary)
                hidden = hidden + hint
            if memory is not None and str(layer) in self.memory_attention:
                hidden = hidden + run(self.memory_attention[str(layer)], hidden, memory, sigma)
        return self._read_out(hidden, time, latents)

    @property
    def _checkpoints(self) -> bool:
        return self.gradient_checkpointing and torch.is_grad_enabled()

    def _read_out(self, hidden: Tensor, time: Tensor, latents: Tensor) -> Tensor:
        """Tokens (b, t p, d) to velocities in the shape and type of the latents."""
        backbone = self.backbone
        shift, scale = (backbone.scale_shift_table + time[:, None]).chunk(2, dim=1)
        tokens = backbone.proj_out((backbone.norm_out(hidden.float()) * (1 + scale) + shift).type_as(hidden))
        batch, _, frames, height, width = latents.shape
        patches = tokens.reshape(batch, frames, height // PATCH, width // PATCH, PATCH, PATCH, -1)
        # (b, t, h, w, y, x, c) -> (b, c, t, h, y, w, x)
        return patches.permute(0, 6, 1, 2, 4, 3, 5).flatten(5, 6).flatten(3, 4).to(latents.dtype)


def build_model(config: EngineConfig, seed: int = 0) -> ConditionedModel:
    """A model with random weights, the same for the same seed, on torch's default device.

    Raises:
        InputError: diffusers or peft is not installed.
    """
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return ConditionedModel(build_backbone(config.backbone), config)


def cast(model: ConditionedModel, dtype: torch.dtype, trainable: bool = False) -> None:
    """Bring the frozen weights to a precision, and the trainable ones too if nothing is trained any more.

    What diffusers keeps in single precision, and the gates, stay so. Trainable weights in bfloat16 would lose most
    of their small updates.
    """
    kept = {*(model.backbone._keep_in_fp32_modules or ()), "gates"}
    for name, parameter in model.named_parameters():
        if (trainable or not parameter.requires_grad) and not kept & set(name.split(".")):
            parameter.data = parameter.data.to(dtype)


def _tokens(embedding: nn.Module, cells: Tensor) -> Tensor:
    """Tokens (b, n, d) of latents or control (b, c, t, h, w)."""
    weight: Any = embedding.weight
    # Layers round differently on tokens that do not lie one after the other.
    return embedding(cells.to(weight.dtype)).flatten(2).transpose(1, 2).contiguous()


def _call(module: nn.Module, *arguments: Any) -> Any:
    return module(*arguments)
