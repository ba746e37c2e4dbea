"""What the toy policy reads of images, history and route, as tensors."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_array
from torch import Tensor

from olt_generator.poses import Array, yaw_of
from olt_sft_recipes.toy.birds_eye import look_up, route_cells
from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.toy.tokens import encode_history
from olt_toolkit.clips.images import resize_images
from olt_toolkit.policy.action_space import normalise_actions
from olt_toolkit.policy.contract import IMAGE_FRAMES, STEP_SECONDS

ROUTE_POINTS = 20
"""Most points of a route that are read."""
ROUTE_STATIONS = (8, 12, 16, 20, 24, 28)
"""Stations of the route grid whose places are told in numbers, too."""
MOTION_FEATURES = 4 + 4 * len(ROUTE_STATIONS)
# Speeds are given relative to a middle one, in units that bring city speeds to within -1 and 1; m/s.
MIDDLE_SPEED, SPEED_SPREAD = 5.0, 5.0
# Below this speed (m/s) a curvature is a ratio of two noises.
LEAST_SPEED = 1.0


@dataclass(frozen=True)
class PolicyInputs:
    """What the prefix is made of.

    Attributes:
        images: (n, cameras, frames, 3, rows, W) uint8, as of `select_images`.
        along: (n, stations, offsets, 3) cells of the bird's-eye grid in the rig frame.
        route: where they are in the images.
        history_tokens: (n, 48).
        motion: (n, MOTION_FEATURES) speed and curvature now, and where the route goes, of about unit size.
    """

    images: Tensor
    along: Array
    route: csr_array
    history_tokens: Tensor
    motion: Tensor


def encode_inputs(images: NDArray[np.uint8], history: Array, routes: Array, config: ToyPolicyConfig) -> PolicyInputs:
    """Tensors of a batch.

    History tokens cut off what is fast and do not hold the heading; the toy is too small to make up for it, so the
    motion is told in numbers, too. It is the speed and the curvature of the last three steps alone: who is told how it
    sped up or slowed down learns to go on like that.

    Args:
        images: (n, cameras, frames, 3, rows, W), of `select_images`.
        history: (n, 16, 3) of x, y in metres and yaw in radians in the rig frame at t0.
        routes: (n, points, 2) route ahead in the rig frame at t0, filled up with NaN; all NaN where none is known.
        config: of the model.
    """
    flat = np.concatenate([history[..., :2], np.zeros_like(history[..., :1])], axis=-1)
    speed, curvature = _speed_and_curvature(history)
    along = cells_along(history, routes)
    frame_poses = history[:, [frame - IMAGE_FRAMES for frame in config.frames]]
    motion = np.concatenate([_motion(speed, curvature), _route_numbers(along, routes)], axis=-1)
    return PolicyInputs(
        torch.from_numpy(np.ascontiguousarray(images)),
        along,
        look_up(along.reshape(len(along), -1, 3)[..., :2], frame_poses, config),
        torch.from_numpy(encode_history(flat)),
        torch.from_numpy(motion.astype(np.float32)),
    )


def cells_along(history: Array, routes: Array) -> Array:
    """Cells (n, stations, offsets, 3) of the route grids of histories (n, 16, 3) and routes (n, points, 2)."""
    _, curvature = _speed_and_curvature(history)
    return np.stack([route_cells(*row) for row in zip(routes, curvature.tolist(), strict=True)])


def _speed_and_curvature(history: Array) -> tuple[Array, Array]:
    """Speed now (n,) in m/s and mean curvature of the last three steps (n,) in 1/m."""
    rates = np.diff(history, axis=-2) / STEP_SECONDS
    speed = np.linalg.norm(rates[..., :2], axis=-1)
    curvature = rates[..., -3:, 2] / np.maximum(speed[..., -3:], LEAST_SPEED)
    return speed[..., -1], curvature.mean(axis=-1)


def _motion(speed: Array, curvature: Array) -> Array:
    """Speed, whether it stands, and curvature, (n, 3)."""
    actions = normalise_actions(np.zeros_like(curvature), curvature)
    return np.stack([(speed - MIDDLE_SPEED) / SPEED_SPREAD, np.exp(-speed), 0.5 * actions[..., 1]], axis=-1)


def _route_numbers(along: Array, routes: Array) -> Array:
    """Whether the route is known, and place and heading at some stations, in (n, 1 + 4 * stations)."""
    known = np.where(are_known(routes), 1.0, 0.0)
    middle = along[:, ROUTE_STATIONS, :].mean(axis=2)
    x, y, yaw = np.moveaxis(middle, -1, 0)
    numbers = np.stack([x / 20.0 - 1.0, y / 5.0, 2.0 * np.sin(yaw), np.cos(yaw)], axis=-1)
    return np.concatenate([known[:, None], numbers.reshape(len(numbers), -1)], axis=-1)


def are_known(routes: Array) -> NDArray[np.bool_]:
    """Which routes (n, points, 2) there are (n,): those that do not begin with NaN."""
    return np.logical_not(np.isnan(routes[:, :2, 0]).any(axis=1))


def pad_route(route_xy: NDArray[np.floating] | None) -> Array:
    """A route (n, 2) filled up with NaN to (ROUTE_POINTS, 2), which is what a route that is not known is all of."""
    padded = np.full((ROUTE_POINTS, 2), np.nan)
    if route_xy is not None:
        padded[: len(route_xy)] = route_xy[:ROUTE_POINTS]
    return padded


def planar_poses(xyz: Array, rotation: Array) -> Array:
    """x, y (m) and unwrapped yaw (rad), (..., n, 3), of positions (..., n, 3) and rotations (..., n, 3, 3)."""
    yaw = np.unwrap(yaw_of(rotation), axis=-1)
    return np.concatenate([xyz[..., :2], yaw[..., None]], axis=-1).astype(np.float64)


def select_images(images: NDArray[np.uint8], config: ToyPolicyConfig) -> NDArray[np.uint8]:
    """What the model uses of images (cameras, 4, 3, H, W): (cameras, frames, 3, rows below its top, W) at its size."""
    images = images[np.ix_(config.camera_rows, config.frames)]
    flat = images.reshape(-1, *images.shape[-3:]).transpose(0, 2, 3, 1)
    scaled = resize_images(flat, config.image_width, config.image_height)[:, config.image_top :]
    return scaled.transpose(0, 3, 1, 2).reshape(*images.shape[:3], *scaled.shape[1:3])
