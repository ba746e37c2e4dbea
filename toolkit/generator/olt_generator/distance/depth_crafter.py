"""DepthCrafter (Hu et al., DepthCrafter: Generating Consistent Long Depth Sequences for Open-world Videos, 2024).

A video diffusion network that denoises the inverse depth of a whole clip, given the latents of its frames and one
embedding of each. Long clips are denoised in windows; each starts from the end of the one before, and where two
overlap they are blended.
"""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from olt_generator.distance.depth_source import RelativeDepth
from olt_generator.distance.model_folder import check_model_folder, load_network
from olt_generator.errors import InputError
from olt_generator.seeds import derive_seed

FILES = (
    "unet/config.json",
    "unet/diffusion_pytorch_model.safetensors",
    "vae/config.json",
    "vae/diffusion_pytorch_model.safetensors",
    "image_encoder/config.json",
    "image_encoder/model.safetensors",
    "scheduler/scheduler_config.json",
)

# Mean and spread of the colours on which CLIP was trained.
CLIP_MEAN = (0.48145466, 0.4578275, 0.40821073)
CLIP_SPREAD = (0.26862954, 0.26130258, 0.27577711)

# What the network is told of every clip, as in its training: frames per second less one, amount of motion, and the
# noise that is added to the frames.
FRAME_RATE, MOTION, FRAME_NOISE = 7, 127, 0.02

# Frames that pass the autoencoder at a time.
CHUNK = 8


@dataclass(frozen=True)
class DiffusionSettings:
    """How the depth of a clip is denoised.

    Attributes:
        width, height: size of the frames, multiples of 64.
        steps: denoising steps.
        window, overlap: frames denoised at once, and frames that two windows share.
    """

    width: int = 672
    height: int = 384
    steps: int = 5
    window: int = 110
    overlap: int = 25

    def __post_init__(self) -> None:
        if self.width % 64 or self.height % 64 or self.steps < 1 or not 0 < self.overlap < self.window:
            raise InputError(f"{self}: give sides that are multiples of 64, a step and an overlap below the window")


class DepthCrafter(RelativeDepth):
    """DepthCrafter, which sees a whole clip.

    Args:
        folder: with subfolders as diffusers writes them: `unet` of DepthCrafter; `vae`, `image_encoder` and
            `scheduler` of Stable Video Diffusion, on which it builds.
        device: where the networks run.
        settings: how the depth is denoised.
        seed: of the noise from which it starts.

    Raises:
        InputError: diffusers or transformers is not installed, or the folder is incomplete.
    """

    def __init__(
        self, folder: Path, device: str = "cpu", settings: DiffusionSettings | None = None, seed: int = 0
    ) -> None:
        check_model_folder(folder, FILES)
        self._networks = _load(folder, device)
        self._device, self._settings, self._seed = device, settings or DiffusionSettings(), seed

    def relative_inverse_depth(self, frames: NDArray[np.uint8], wanted: NDArray[np.int64]) -> NDArray[np.float32]:
        """See `RelativeDepth`; the network sees all frames, whichever are wanted. 0 to 1 over the clip."""
        size = (self._settings.width, self._settings.height)
        resized = np.stack([cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames])
        generator = torch.Generator().manual_seed(derive_seed("DepthCrafter", self._seed))
        vae = self._networks.vae
        with torch.inference_mode():
            video = torch.from_numpy(resized.transpose(0, 3, 1, 2)).to(self._device).float() / 127.5 - 1.0
            embeddings = self._embed(video)
            noisy = video + FRAME_NOISE * torch.randn(video.shape, generator=generator).to(self._device)
            # Latents (n, c, h / 8, w / 8); the depth is the mean of three channels.
            conditions = torch.cat([vae.encode(chunk).latent_dist.mode() for chunk in noisy.split(CHUNK)])
            latents = self._denoise(conditions, embeddings, generator) / vae.config.scaling_factor
            decoded = [vae.decode(chunk, num_frames=len(chunk)).sample for chunk in latents.split(CHUNK)]
        depth = torch.cat([0.5 * part.clamp(-1.0, 1.0).mean(dim=1) + 0.5 for part in decoded]).float().cpu().numpy()
        low, high = depth.min(), depth.max()
        return ((depth - low) / max(high - low, 1e-6)).astype(np.float32)[wanted]

    def _embed(self, video: Tensor) -> Tensor:
        """Embeddings (n, c) of frames (n, 3, h, w), one each."""
        side = self._networks.image_encoder.config.image_size
        small = torch.nn.functional.interpolate(video, (side, side), mode="bicubic", antialias=True)
        mean, spread = (video.new_tensor(values)[:, None, None] for values in (CLIP_MEAN, CLIP_SPREAD))
        pixels = ((0.5 * small + 0.5) - mean) / spread
        return torch.cat([self._networks.image_encoder(chunk).image_embeds for chunk in pixels.split(CHUNK)])

    def _denoise(self, conditions: Tensor, embeddings: Tensor, generator: Any) -> Tensor:
        """Latents (n, c, h, w) of the depth of the whole clip, window by window."""
        count, overlap = len(conditions), self._settings.overlap
        done = conditions[:0]
        for start in range(0, max(count - overlap, 1), self._settings.window - overlap):
            here = slice(start, min(start + self._settings.window, count))
            before = done[start:]
            noise = torch.randn(conditions[here].shape, generator=generator).to(self._device)
            latents = self._denoise_window(noise, before, conditions[here], embeddings[here])
            share = torch.linspace(0.0, 1.0, max(len(before), 1), device=self._device)[: len(before), None, None, None]
            blended = share * latents[: len(before)] + (1.0 - share) * before
            done = torch.cat([done[:start], blended, latents[len(before) :]])
        return done

    def _denoise_window(self, noise: Tensor, before: Tensor, conditions: Tensor, embeddings: Tensor) -> Tensor:
        """Latents (k, c, h, w) from noise; the first frames start from what is known of them `before` (j, c, h, w)."""
        unet, scheduler = self._networks.unet, self._networks.scheduler
        scheduler.set_timesteps(self._settings.steps, device=self._device)
        latents = noise * scheduler.init_noise_sigma
        latents[: len(before)] = before + noise[: len(before)] * scheduler.sigmas[0]
        time_ids = torch.tensor([[FRAME_RATE, MOTION, FRAME_NOISE]], device=self._device)
        for timestep in scheduler.timesteps:
            scaled = scheduler.scale_model_input(latents, timestep)
            sample = torch.cat([scaled, conditions], dim=1)[None]
            predicted = unet(sample, timestep, embeddings[None], time_ids).sample[0]
            latents = scheduler.step(predicted, timestep, latents).prev_sample
        return latents


def _load(folder: Path, device: str) -> SimpleNamespace:
    """The networks `unet`, `vae` and `image_encoder`, and the `scheduler`."""
    try:
        from diffusers.models.autoencoders.autoencoder_kl_temporal_decoder import AutoencoderKLTemporalDecoder
        from diffusers.models.transformers.transformer_temporal import TransformerSpatioTemporalModel
        from diffusers.models.unets.unet_spatio_temporal_condition import UNetSpatioTemporalConditionModel
        from diffusers.schedulers.scheduling_euler_discrete import EulerDiscreteScheduler
        from transformers import CLIPVisionModelWithProjection
    except ImportError as error:
        raise InputError(
            "DepthCrafter needs diffusers and transformers; pip install 'olt-generator[learned]'"
        ) from error
    unet = load_network(UNetSpatioTemporalConditionModel, folder / "unet", device)
    for module in unet.modules():
        if isinstance(module, TransformerSpatioTemporalModel):
            module.register_forward_pre_hook(_attend_to_own_embedding, with_kwargs=True)
    return SimpleNamespace(
        unet=unet,
        vae=load_network(AutoencoderKLTemporalDecoder, folder / "vae", device),
        image_encoder=load_network(CLIPVisionModelWithProjection, folder / "image_encoder", device),
        scheduler=EulerDiscreteScheduler.from_pretrained(folder / "scheduler", local_files_only=True),
    )


def _attend_to_own_embedding(module: Any, arguments: Any, named: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Let every frame attend to its own embedding only.

    The network of diffusers hands all given embeddings (n, c) to each of the n frames, as (n, n, c); DepthCrafter was
    trained with one each, (n, 1, c).
    """
    every = named["encoder_hidden_states"]
    return arguments, named | {"encoder_hidden_states": every.diagonal(dim1=0, dim2=1).T[:, None]}
