"""A small cache of training clips with random content, and an engine small enough to be trained in a test."""

from dataclasses import replace

import numpy as np
import torch

from olt_generator.diffusion.config import CONFIGS, BackboneConfig, ConditioningConfig, EngineConfig
from olt_generator.diffusion.flow_training import FlowTraining
from olt_generator.diffusion.splits import Window
from olt_generator.diffusion.training_cache import CacheFacts, write_cache
from olt_generator.diffusion.training_clips import ClipVideos, TrainingClip
from olt_generator.diffusion.training_settings import FlowSettings, OptimizerSettings

ENGINE = EngineConfig(
    BackboneConfig(heads=2, head_dim=12, ffn_dim=32, layers=2, vace_layers=(0,), text_dim=8, frequency_dim=16),
    CONFIGS["tiny"].autoencoder,
    ConditioningConfig(hidden=8, memory_layers=(0, 1), queries=2, window=1),
    replace(CONFIGS["tiny"].lora, rank=2),
)
OPTIMIZER = OptimizerSettings(
    steps=6, batch=2, adapter_rate=1e-2, new_rate=1e-2, warmup=2, clip=0.5, average=0.9, save_every=2
)
SPLITS = ("train", "train", "seen", "unseen")
WINDOWS = (
    Window("synthetic", "a", 0, 400_000),
    Window("synthetic", "a", 500_000, 900_000),
    Window("synthetic", "a", 1_000_000, 1_400_000),
    Window("synthetic", "b", 0, 400_000),
)


def draw_clip(seed, frames=2, rows=4, columns=6):
    """A clip of random latents, and videos that fit it."""
    generator = torch.Generator().manual_seed(seed)
    size = (frames, rows, columns)
    clip = TrainingClip(
        torch.randn(6, 16, *size, generator=generator),
        torch.randn(6, 16, *size, generator=generator),
        torch.rand(6, 1, *size, generator=generator),
        torch.randn(6, 6, frames, rows // 2, columns // 2, generator=generator),
        torch.randn(frames, 6, generator=generator),
    )
    draw = np.random.default_rng(seed)
    images = (6, 4 * frames - 3, 8 * rows, 8 * columns)
    videos = ClipVideos(
        draw.integers(0, 256, (*images, 3), np.uint8),
        draw.integers(0, 256, (*images, 3), np.uint8),
        draw.integers(0, 3, images, np.uint8),
        draw.random((6, *images[2:])) < 0.9,
        clip.rays.numpy(),
        clip.motion.numpy(),
        np.tile([20.0, 20.0, 23.5, 15.5], (6, 1)),
        np.tile(np.eye(4), (6, images[1], 1, 1)),
    )
    return clip, videos


def make_cache(folder):
    """A cache of four clips, two of them to train on."""
    clips = [draw_clip(seed) for seed in range(len(WINDOWS))]
    return write_cache(folder, CacheFacts(48, 32, 5, 100_000, "random"), WINDOWS, SPLITS, clips)


def build_texts():
    """Embeddings of a prompt and of none."""
    prompt = torch.randn(3, ENGINE.backbone.text_dim, generator=torch.Generator().manual_seed(9))
    return prompt, torch.zeros_like(prompt)


def make_flow(cache, **settings):
    """Samples of that cache."""
    return FlowTraining(cache, FlowSettings(**settings), 0, *build_texts())


def write_released(folder, frames=2, rows=4, columns=6):
    """A clip in the released layout with a lookback warp that sees more in the left half of the rear views."""
    generator = torch.Generator().manual_seed(5)
    size = (frames, rows, columns)
    shape = (5, 16, *size)
    poses = torch.eye(4).repeat(frames, 1, 1)
    poses[:, 2, 3] = torch.arange(frames) * 2.0
    K = torch.tensor([[30.0, 0.0, 24.0], [0.0, 30.0, 16.0], [0.0, 0.0, 1.0]]).repeat(6, 1, 1)
    seen = torch.zeros(5, 1, *size)
    earlier = seen.clone()
    earlier[2:, ..., :3] = 1.0
    parts = {
        "": {"uuid": "u", "z_all": torch.randn(6, 16, *size, generator=generator).bfloat16(), "K": K}
        | {"E": torch.eye(4).repeat(6, 1, 1), "clip_id": 1},
        "_p4": {"T_anchor_front": poses},
        "_warp": {"warped_target_latents": torch.zeros(shape).bfloat16(), "warped_target_visibility": seen.half()},
        "_lookback": {
            "adjacent_warped_target_latents": torch.ones(shape).bfloat16(),
            "adjacent_warped_target_visibility": earlier.half(),
        },
    }
    for part, content in parts.items():
        torch.save(content, folder / f"clip_000001{part}.pt")
    return folder / "clip_000001.pt"
