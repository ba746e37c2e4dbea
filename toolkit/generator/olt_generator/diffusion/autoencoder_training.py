"""Training of a small video autoencoder from random weights, for engines that own theirs."""

import hashlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from olt_generator.diffusion.backbone import build_autoencoder
from olt_generator.diffusion.config import AutoencoderConfig
from olt_generator.diffusion.training_loop import train
from olt_generator.diffusion.training_settings import OptimizerSettings
from olt_generator.progress import Progress, silent
from olt_generator.seeds import derive_seed, make_generator

if TYPE_CHECKING:
    from diffusers.models.autoencoders.autoencoder_kl_wan import AutoencoderKLWan

# Spread of the noise on latents in training, so that close latents show alike, and the price of large ones.
_NOISE, _SIZE_WEIGHT = 0.1, 1e-4
_MEASURED = 64


class _Reconstruction(nn.Module):
    """Errors (b,) of videos (b, 3, f, h, w), -1 to 1, after their way through noised latents."""

    def __init__(self, autoencoder: "AutoencoderKLWan") -> None:
        super().__init__()
        self.autoencoder: Any = autoencoder

    def forward(self, video: Tensor, noise: Tensor) -> Tensor:
        latents = self.autoencoder.encode(video).latent_dist.mean
        made = self.autoencoder.decode(latents + _NOISE * noise).sample
        error = ((made - video) ** 2).flatten(1).mean(dim=1) + 0.1 * (made - video).abs().flatten(1).mean(dim=1)
        return error + _SIZE_WEIGHT * (latents**2).flatten(1).mean(dim=1)


def train_autoencoder(
    videos: NDArray[np.uint8],
    config: AutoencoderConfig,
    settings: OptimizerSettings,
    run: Path,
    seed: int,
    on_progress: Progress = silent,
) -> "tuple[AutoencoderKLWan, AutoencoderConfig]":
    """Train on videos (n, f, h, w, 3); returns the frozen autoencoder, and its configuration with measured latents.

    Raises:
        InputError: see `training_loop.train`.
    """
    with torch.random.fork_rng():
        torch.manual_seed(derive_seed("autoencoder", seed) % 2**63)
        autoencoder = build_autoencoder(config)
    train(
        _Reconstruction(autoencoder),
        lambda model, numbers: _losses(model, numbers, videos, seed),
        settings,
        run,
        facts={
            "seed": seed,
            "autoencoder": asdict(config),
            "videos": hashlib.blake2b(videos.tobytes(), digest_size=8).hexdigest(),
        },
        on_progress=on_progress,
    )
    return measure_latents(autoencoder, videos, config)


@torch.no_grad()
def measure_latents(
    autoencoder: Any, videos: NDArray[np.uint8], config: AutoencoderConfig
) -> "tuple[AutoencoderKLWan, AutoencoderConfig]":
    """The autoencoder with mean and spread of its latent channels over (a spread of) the videos."""
    chosen = np.unique(np.linspace(0, len(videos) - 1, _MEASURED).astype(int))
    device = next(autoencoder.parameters()).device
    latents = torch.cat(
        [autoencoder.encode(to_pixels(videos[index : index + 1]).to(device)).latent_dist.mode() for index in chosen]
    )
    mean, spread = latents.mean(dim=(0, 2, 3, 4)).tolist(), latents.std(dim=(0, 2, 3, 4)).clamp(min=1e-3).tolist()
    measured = replace(config, latents_mean=tuple(mean), latents_std=tuple(spread))
    fresh = build_autoencoder(measured)
    fresh.load_state_dict(autoencoder.state_dict())
    return fresh.eval().requires_grad_(False).to(device), measured


def to_pixels(videos: NDArray[np.uint8]) -> Tensor:
    """Videos (n, f, h, w, 3) uint8 as (n, 3, f, h, w) float32 from -1 to 1."""
    return torch.from_numpy(videos).permute(0, 4, 1, 2, 3).float() / 127.5 - 1.0


def _losses(model: nn.Module, numbers: list[int], videos: NDArray[np.uint8], seed: int) -> Tensor:
    device = next(model.parameters()).device
    chosen = [int(make_generator("autoencoder sample", seed, number).integers(len(videos))) for number in numbers]
    pixels = to_pixels(videos[chosen])
    _, _, frames, height, width = pixels.shape
    shape = (16, 1 + (frames - 1) // 4, height // 8, width // 8)
    noise = [
        torch.randn(shape, generator=torch.Generator().manual_seed(derive_seed("autoencoder noise", seed, number)))
        for number in numbers
    ]
    return model(pixels.to(device), torch.stack(noise).to(device))
