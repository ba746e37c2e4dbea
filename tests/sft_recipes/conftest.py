"""A tiny toy model and fabricated samples on which it can be trained in seconds."""

import numpy as np
import pytest

from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_toolkit.policy.sample import PolicySample, SampleKey

# fmt: off
TINY_CONFIG = ToyPolicyConfig(
    image_height=16, image_width=32, image_top=0, image_channels=4, precision="float32",
    width=16, layers=2, heads=2, expert_width=16,
)
# fmt: on


@pytest.fixture(scope="session")
def tiny_config():
    return TINY_CONFIG


def make_sample(curvature, speed=8.0, clip_id="clip", t0_us=2_000_000):
    """A drive of constant curvature; a bright column in every image says where the road goes."""
    times = np.concatenate([np.arange(-15, 1), np.arange(1, 65)]) * 0.1
    distance = speed * times
    yaw = curvature * distance
    if curvature:
        x, y = np.sin(yaw) / curvature, (1.0 - np.cos(yaw)) / curvature
    else:
        x, y = distance, np.zeros_like(distance)
    xyz = np.stack([x, y, np.zeros_like(x)], axis=-1).astype(np.float32)
    rotation = np.zeros((80, 3, 3), np.float32)
    rotation[:, 0, 0] = rotation[:, 1, 1] = np.cos(yaw)
    rotation[:, 1, 0] = np.sin(yaw)
    rotation[:, 0, 1] = -rotation[:, 1, 0]
    rotation[:, 2, 2] = 1.0
    images = np.full((4, 4, 3, 16, 32), 40, np.uint8)
    images[..., int(np.clip(16 - 300 * curvature, 2, 29))] = 250
    return PolicySample(
        image_frames=images,
        camera_indices=np.array([0, 1, 2, 6]),
        ego_history_xyz=xyz[None, :16],
        ego_history_rot=rotation[None, :16],
        ego_future_xyz=xyz[None, 16:],
        ego_future_rot=rotation[None, 16:],
        relative_timestamps=np.zeros((4, 4), np.float32),
        absolute_timestamps=np.zeros((4, 4), np.int64),
        t0_us=t0_us,
        clip_id=clip_id,
    )


def make_drives():
    """Twelve samples by key: left, right and straight at several speeds."""
    curvatures = np.linspace(-0.03, 0.03, 12)
    keys = [SampleKey("store", f"clip{index:02d}", 2_000_000) for index in range(12)]
    return {
        key: make_sample(float(curvature), 5.0 + index % 4, key.clip_id)
        for index, (key, curvature) in enumerate(zip(keys, curvatures, strict=True))
    }


@pytest.fixture(scope="session")
def drives():
    return make_drives()


@pytest.fixture(scope="session")
def make_textured_drive():
    """Front images (n, 144, 256, 3) of a short drive through the synthetic world, at 25 frames a second."""
    from olt_closed_loop.scenes.procedural import generate_scene
    from olt_closed_loop.sensors.recorder import record_drive

    frames = record_drive(generate_scene("nominal", 9), 256, 144, 25.0).frames
    return lambda count: frames[:count]
