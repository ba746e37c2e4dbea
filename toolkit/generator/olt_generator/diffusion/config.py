"""Sizes of the learned engine by name: `1.3B` is the paper's, `tiny` the same code small enough for a processor."""

from dataclasses import dataclass, field
from typing import Any

from olt_generator.errors import InputError

# Channels of a latent; of the control of VACE, inactive and reactive latents and the mask of 8 x 8 pixels a cell.
LATENT_CHANNELS = 16
MASK_CHANNELS = 64
CONTROL_CHANNELS = 2 * LATENT_CHANNELS + MASK_CHANNELS
# Pixels (rows, columns) of one latent cell.
CELL_PIXELS = 8
# Latent cells (rows, columns) of one token.
PATCH = 2


@dataclass(frozen=True)
class BackboneConfig:
    """Sizes of the transformer; the defaults are those of Wan2.1-VACE-1.3B.

    Attributes:
        heads, head_dim: attention heads and their width; tokens are `heads * head_dim` wide.
        ffn_dim: width of the feed-forward layers.
        layers: blocks of the DiT.
        vace_layers: blocks after which a block of the control branch adds what it has to say; the first is 0.
        text_dim: width of the text embeddings (UMT5-xxl).
        frequency_dim: sines and cosines that stand for a noise level.
        longest: most tokens along an axis of a video.
    """

    heads: int = 12
    head_dim: int = 128
    ffn_dim: int = 8960
    layers: int = 30
    vace_layers: tuple[int, ...] = tuple(range(0, 30, 2))
    text_dim: int = 4096
    frequency_dim: int = 256
    longest: int = 1024

    @property
    def dim(self) -> int:
        """Width of a token."""
        return self.heads * self.head_dim

    def to_diffusers(self) -> dict[str, Any]:
        """Arguments of `diffusers.WanVACETransformer3DModel`."""
        return {
            "patch_size": (1, PATCH, PATCH),
            "num_attention_heads": self.heads,
            "attention_head_dim": self.head_dim,
            "in_channels": LATENT_CHANNELS,
            "out_channels": LATENT_CHANNELS,
            "text_dim": self.text_dim,
            "freq_dim": self.frequency_dim,
            "ffn_dim": self.ffn_dim,
            "num_layers": self.layers,
            "rope_max_seq_len": self.longest,
            "vace_layers": list(self.vace_layers),
            "vace_in_channels": CONTROL_CHANNELS,
        }


@dataclass(frozen=True)
class AutoencoderConfig:
    """Sizes of the video autoencoder; the defaults are those of Wan 2.1.

    Attributes:
        base_dim, dim_multiples, residual_blocks: channels of the finest level, their multiples at the levels, each half
            as fine as the one before, and residual blocks of a level.
        patch: pixels (rows, columns) that become channels of the finest level; 2 needs a level less, and a third of
            the time.
        latents_mean, latents_std: of each latent channel over training videos, by which latents are normalised; None
            for those of Wan's weights.

    Raises:
        InputError: the levels do not make cells of 8 x 8 pixels and 4 frames.
    """

    base_dim: int = 96
    dim_multiples: tuple[int, ...] = (1, 2, 4, 4)
    residual_blocks: int = 2
    patch: int = 1
    latents_mean: tuple[float, ...] | None = None
    latents_std: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.patch not in (1, 2) or self.patch * 2 ** (len(self.dim_multiples) - 1) != CELL_PIXELS:
            raise InputError(
                f"autoencoder: patch {self.patch} and {len(self.dim_multiples)} dim_multiples do not make cells of "
                f"{CELL_PIXELS} pixels; give patch 1 and four of them, or patch 2 and three"
            )

    def to_diffusers(self) -> dict[str, Any]:
        """Arguments of `diffusers.AutoencoderKLWan`."""
        given = {"latents_mean": self.latents_mean, "latents_std": self.latents_std}
        channels = 3 * self.patch**2
        return {
            "base_dim": self.base_dim,
            "z_dim": LATENT_CHANNELS,
            "dim_mult": list(self.dim_multiples),
            "num_res_blocks": self.residual_blocks,
            # The last two levels halve the frames, too.
            "temperal_downsample": [False] * (len(self.dim_multiples) - 3) + [True, True],
            "patch_size": self.patch if self.patch > 1 else None,
            "in_channels": channels,
            "out_channels": channels,
        } | {name: list(values) for name, values in given.items() if values is not None}


@dataclass(frozen=True)
class ConditioningConfig:
    """Sizes of the modules that condition the backbone (paper, section Pose-Informed Extrapolative Synthesis).

    The paper states the layers, the queries and the bias; the released generator the window, the adapter blocks and the
    hidden widths of MLPs and gates (docs/formats/generator.md). The expansion of the adapter blocks is our choice.

    Attributes:
        plucker, memory: whether tokens get their rays, and whether other views are remembered; False to measure what
            each is worth. (The warp is left out by `warp_control.no_warp`.)
        fill: whether the warp shows what the geometric engine fills unseen parts with, and not black, as in the paper.
        hidden: hidden width of the MLPs of rays and ego motion.
        memory_layers: blocks of the DiT after which target tokens attend to the memory.
        adapter_blocks, adapter_expansion: residual blocks that make the dense memory, and the width of their hidden
            layer in multiples of the token's.
        queries: tokens a frame of the semantic memory.
        window: frames before and after its own whose memory a token sees.
        gate_hidden, gate_bias: hidden width of the gates' MLPs, and the bias of their last layer.
    """

    plucker: bool = True
    memory: bool = True
    fill: bool = False
    hidden: int = 256
    memory_layers: tuple[int, ...] = (4, 9, 14, 19, 24, 29)
    adapter_blocks: int = 2
    adapter_expansion: int = 2
    queries: int = 64
    window: int = 2
    gate_hidden: int = 16
    gate_bias: float = -1.4


@dataclass(frozen=True)
class LoraConfig:
    """Rank and alpha of the adapters on the self-attention of DiT and VACE blocks (paper, table of fine-tuning)."""

    rank: int = 32
    alpha: int = 16


@dataclass(frozen=True)
class EngineConfig:
    """Everything that fixes the shapes of an engine.

    Raises:
        InputError: the memory attends after a block that there is not.
    """

    backbone: BackboneConfig = field(default_factory=BackboneConfig)
    autoencoder: AutoencoderConfig = field(default_factory=AutoencoderConfig)
    conditioning: ConditioningConfig = field(default_factory=ConditioningConfig)
    lora: LoraConfig = field(default_factory=LoraConfig)

    def __post_init__(self) -> None:
        missing = [layer for layer in self.conditioning.memory_layers if not 0 <= layer < self.backbone.layers]
        if missing:
            raise InputError(
                f"memory_layers: {missing[0]} is none of the {self.backbone.layers} blocks; give layers from 0 to "
                f"{self.backbone.layers - 1}"
            )


CONFIGS: dict[str, EngineConfig] = {
    "1.3B": EngineConfig(),
    "tiny": EngineConfig(
        BackboneConfig(
            heads=4, head_dim=24, ffn_dim=256, layers=6, vace_layers=(0, 2, 4), text_dim=32, frequency_dim=64
        ),
        AutoencoderConfig(
            base_dim=16,
            dim_multiples=(1, 2, 2),
            residual_blocks=1,
            patch=2,
            latents_mean=(0.0,) * 16,
            latents_std=(1.0,) * 16,
        ),
        ConditioningConfig(fill=True, hidden=64, memory_layers=(1, 3, 5), queries=16, window=1),
        LoraConfig(rank=4, alpha=2),
    ),
}


def find_config(name: str) -> EngineConfig:
    """The configuration of this name.

    Raises:
        InputError: there is none.
    """
    if name not in CONFIGS:
        raise InputError(f"configuration {name!r}: no such engine; choose from {', '.join(CONFIGS)}")
    return CONFIGS[name]
