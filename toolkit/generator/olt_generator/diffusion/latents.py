"""Videos to the latents of the frozen autoencoder and back."""

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from olt_generator.diffusion.config import CELL_PIXELS
from olt_generator.errors import InputError
from olt_generator.views.lookback import FRAMES_PER_LATENT

if TYPE_CHECKING:
    from diffusers.models.autoencoders.autoencoder_kl_wan import AutoencoderKLWan


def latent_frames(frames: int) -> int:
    """Latent frames of a video: 41 frames give 11.

    Raises:
        InputError: the frames are not 4 k + 1. The autoencoder would drop the last ones without a word.
    """
    if frames < 1 or (frames - 1) % FRAMES_PER_LATENT:
        fewer = max(1, frames - (frames - 1) % FRAMES_PER_LATENT)
        raise InputError(
            f"{frames} frames: the autoencoder takes 4 k + 1 and would drop the last ones; cut the video to {fewer} "
            f"or give {fewer + FRAMES_PER_LATENT}"
        )
    return 1 + (frames - 1) // FRAMES_PER_LATENT


class LatentCodec:
    """A frozen autoencoder that normalises: each latent channel has mean 0, spread 1 over its training videos.

    Args:
        autoencoder: `diffusers.AutoencoderKLWan`; its parameters take no gradients from here on.
    """

    def __init__(self, autoencoder: "AutoencoderKLWan") -> None:
        self.autoencoder: Any = autoencoder.eval().requires_grad_(False)
        self._mean, self._spread = (
            torch.tensor(self.autoencoder.config[name])[:, None, None, None] for name in ("latents_mean", "latents_std")
        )

    @torch.no_grad()
    def encode(self, video: Tensor) -> Tensor:
        """Normalised latents (b, 16, 1 + (f - 1) / 4, h / 8, w / 8), float32, of videos (b, f, h, w, 3) uint8.

        The mode of the posterior: the same video gives the same latents.

        Raises:
            InputError: the frames are not 4 k + 1, or the images do not fill tokens of 16 x 16 pixels.
        """
        latent_frames(video.shape[1])
        if video.shape[2] % (2 * CELL_PIXELS) or video.shape[3] % (2 * CELL_PIXELS):
            raise InputError(
                f"a video of {video.shape[3]} x {video.shape[2]} pixels does not fill tokens of 16 x 16; resize or "
                "crop it, as 832 x 480"
            )
        weight = next(self.autoencoder.parameters())
        pixels = video.permute(0, 4, 1, 2, 3).to(weight.device, weight.dtype) / 127.5 - 1.0
        latents = self.autoencoder.encode(pixels).latent_dist.mode().float()
        return (latents - self._mean.to(latents.device)) / self._spread.to(latents.device)

    @torch.no_grad()
    def decode(self, latents: Tensor) -> Tensor:
        """Videos (b, 4 (t - 1) + 1, 8 h, 8 w, 3) uint8 of normalised latents (b, 16, t, h, w)."""
        weight = next(self.autoencoder.parameters())
        raw = latents.to(weight.device).float() * self._spread.to(weight.device) + self._mean.to(weight.device)
        pixels = self.autoencoder.decode(raw.to(weight.dtype)).sample.float()
        return (127.5 * (pixels + 1.0)).round().clamp(0.0, 255.0).to(torch.uint8).permute(0, 2, 3, 4, 1)
