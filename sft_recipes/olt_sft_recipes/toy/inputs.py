"""What the toy policy reads of images and history, as tensors."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from olt_generator.poses import Array, yaw_of
from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.toy.tokens import encode_history
from olt_toolkit.clips.images import resize_images
from olt_toolkit.policy.action_space import normalise_actions
from olt_toolkit.policy.contract import STEP_SECONDS

MOTION_FEATURES = 7
# Speeds are given relative to a middle one, in units that bring city speeds to within -1 and 1; m/s.
MIDDLE_SPEED, SPEED_SPREAD = 10.0, 5.0
# Below this speed (m/s) a curvature is a ratio of two noises.
LEAST_SPEED = 1.0


@dataclass(frozen=True)
class PolicyInputs:
    """What the prefix is made of: images (n, cameras, frames, 3, H, W) uint8, history tokens (n, 48), motion (n, 7)."""

    images: Tensor
    history_tokens: Tensor
    motion: Tensor


def encode_inputs(images: NDArray[np.uint8], history: Array) -> PolicyInputs:
    """Tensors of images (n, cameras, frames, 3, H, W) and histories (n, 16, 3).

    Histories are x, y in metres and yaw in radians, in the rig frame at t0. The motion is the speed now, and the mean
    acceleration and curvature over the older half, the newer half and the last three steps, all of about unit size.
    History tokens cut off what is fast and do not hold the heading; the toy is too small to make up for it.
    """
    flat = np.concatenate([history[..., :2], np.zeros_like(history[..., :1])], axis=-1)
    rates = np.diff(history, axis=-2) / STEP_SECONDS
    speed = np.linalg.norm(rates[..., :2], axis=-1)
    curvature = rates[..., 1:, 2] / np.maximum(speed[..., 1:], LEAST_SPEED)
    actions = normalise_actions(np.diff(speed, axis=-1) / STEP_SECONDS, curvature)
    means = [part.mean(axis=-2) for part in (actions[..., :7, :], actions[..., 7:, :], actions[..., -3:, :])]
    motion = np.concatenate([(speed[..., -1:] - MIDDLE_SPEED) / SPEED_SPREAD, *means], axis=-1).astype(np.float32)
    return PolicyInputs(
        torch.from_numpy(np.ascontiguousarray(images)),
        torch.from_numpy(encode_history(flat)),
        torch.from_numpy(motion),
    )


def planar_poses(xyz: Array, rotation: Array) -> Array:
    """x, y (m) and unwrapped yaw (rad), (..., n, 3), of positions (..., n, 3) and rotations (..., n, 3, 3)."""
    yaw = np.unwrap(yaw_of(rotation), axis=-1)
    return np.concatenate([xyz[..., :2], yaw[..., None]], axis=-1).astype(np.float64)


def select_images(images: NDArray[np.uint8], config: ToyPolicyConfig) -> NDArray[np.uint8]:
    """The newest of the images (cameras, 4, 3, H, W) that the model uses, (cameras, frames, 3, H, W) at its size."""
    images = images[:, -config.image_frames :]
    flat = images.reshape(-1, *images.shape[-3:]).transpose(0, 2, 3, 1)
    scaled = resize_images(flat, config.image_width, config.image_height)
    return scaled.transpose(0, 3, 1, 2).reshape(*images.shape[:3], *scaled.shape[1:3])
