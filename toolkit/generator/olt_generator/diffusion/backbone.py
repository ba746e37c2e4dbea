"""Wan2.1-VACE and its autoencoder through diffusers: from a configuration, or from a local folder."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from olt_generator.diffusion.config import CONTROL_CHANNELS, LATENT_CHANNELS, PATCH, AutoencoderConfig, BackboneConfig
from olt_generator.distance.model_folder import check_model_folder, load_network
from olt_generator.errors import InputError

if TYPE_CHECKING:
    from diffusers.models.autoencoders.autoencoder_kl_wan import AutoencoderKLWan
    from diffusers.models.transformers.transformer_wan_vace import WanVACETransformer3DModel

# A noise level of 1 is this time of the backbone.
TIME_SCALE = 1000.0


def build_backbone(config: BackboneConfig) -> "WanVACETransformer3DModel":
    """A frozen transformer with random weights, on torch's default device; on "meta" it holds no weights.

    Raises:
        InputError: diffusers is not installed.
    """
    return _backbone_class()(**config.to_diffusers()).eval().requires_grad_(False)


def load_backbone(folder: Path, device: str = "cpu", dtype: torch.dtype = torch.float32) -> "WanVACETransformer3DModel":
    """The frozen transformer of a local folder as diffusers writes it, such as Wan2.1-VACE-1.3B-diffusers.

    What diffusers keeps in single precision (norms, modulation, the time's embedding) stays so in every `dtype`.

    Args:
        folder: with the subfolder `transformer`.

    Raises:
        InputError: diffusers is not installed, files are missing or damaged, or the network has other inputs.
    """
    check_model_folder(folder, ["transformer/config.json"])
    backbone = load_network(_backbone_class(), folder / "transformer", device, torch_dtype=dtype)
    config = backbone.config
    expected = {
        "patch_size": (1, PATCH, PATCH),
        "in_channels": LATENT_CHANNELS,
        "out_channels": LATENT_CHANNELS,
        "vace_in_channels": CONTROL_CHANNELS,
    }
    for name, value in expected.items():
        found = tuple(config[name]) if isinstance(value, tuple) else config[name]
        if found != value:
            raise InputError(
                f"{folder}/transformer/config.json: {name} is {found}, not {value}; give a Wan2.1-VACE model"
            )
    return backbone.requires_grad_(False)


def read_config(backbone: "WanVACETransformer3DModel") -> BackboneConfig:
    """The sizes of a loaded transformer."""
    config: Any = backbone.config
    return BackboneConfig(
        heads=config.num_attention_heads,
        head_dim=config.attention_head_dim,
        ffn_dim=config.ffn_dim,
        layers=config.num_layers,
        vace_layers=tuple(config.vace_layers),
        text_dim=config.text_dim,
        frequency_dim=config.freq_dim,
        longest=config.rope_max_seq_len,
    )


def build_autoencoder(config: AutoencoderConfig) -> "AutoencoderKLWan":
    """A video autoencoder with random weights, on torch's default device.

    Raises:
        InputError: diffusers is not installed.
    """
    return _autoencoder_class()(**config.to_diffusers())


def load_autoencoder(folder: Path, device: str = "cpu", dtype: torch.dtype = torch.float32) -> "AutoencoderKLWan":
    """The autoencoder in the subfolder `vae` of a local folder as diffusers writes it.

    Raises:
        InputError: diffusers is not installed, or files are missing or damaged.
    """
    check_model_folder(folder, ["vae/config.json"])
    return load_network(_autoencoder_class(), folder / "vae", device, torch_dtype=dtype)


def _backbone_class() -> Any:
    try:
        from diffusers.models.transformers.transformer_wan_vace import WanVACETransformer3DModel
    except ImportError as error:
        raise InputError("Wan2.1-VACE needs diffusers; pip install 'olt-generator[learned]'") from error
    return WanVACETransformer3DModel


def _autoencoder_class() -> Any:
    try:
        from diffusers.models.autoencoders.autoencoder_kl_wan import AutoencoderKLWan
    except ImportError as error:
        raise InputError("The video autoencoder needs diffusers; pip install 'olt-generator[learned]'") from error
    return AutoencoderKLWan
