"""What only the toy is trained on beside its stages' own losses: plans in numbers, and what is where.

The real model brings knowledge of the world from its pre-training. The toy starts from nothing and with minutes to
learn, so Stage 1 also tells it, where a data set knows the truth, which cells of its bird's-eye grid are taken now and
in the seconds to come, where a red light or somebody's hand holds the way, and where road is; and it regresses the
whole plan at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from olt_generator.poses import Array
from olt_sft_recipes.toy.birds_eye import FRONT, OFFSETS, STATIONS, TOLD
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD, TAKEN_WEIGHT, Sight
from olt_toolkit.policy.action_space import ACTION_MEAN, ACTION_STD
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS
from olt_toolkit.policy.sample import TRUTH_OFFSETS_US, PolicySample

FAR, NEAR = 1.04, 0.24
"""A cell is not taken where its centre is so many metres from somebody, wholly where it is that near, and by a share
between: so cells of almost a metre tell where somebody ends."""
HELD_ROOM = 1.5
_SIGHT_SCALE = 6.0
_FADES_SECONDS = 3.0
_WHOLE = 255
_PARTS = (-1 / 3, 0.0, 1 / 3)


@dataclass(frozen=True)
class SightTruth:
    """What the heads of the image encoder are to tell.

    Attributes:
        known: (n, 2) bool, whether the sample knows others and holds, and the road.
        route: (n, seconds + 2, stations, offsets) uint8 as `Sight.route`, 255 for 1.
    """

    known: Tensor
    route: Tensor


def gather_truth(samples: Sequence[PolicySample], along: Array) -> tuple[NDArray[np.bool_], NDArray[np.uint8]]:
    """Whether samples know what is where, and what, as `SightTruth` has it.

    Args:
        samples: n samples.
        along: (n, stations, offsets, 3) cells of their bird's-eye grids along the route.
    """
    known = np.zeros((len(samples), 2), bool)
    truth = np.zeros((len(samples), len(SECONDS_AHEAD) + 2, len(STATIONS), len(OFFSETS)), np.uint8)
    for row, sample in enumerate(samples):
        if sample.obstacle_boxes is not None and sample.hold is not None and not np.isnan(sample.hold[0]):
            known[row, 0] = True
            boxes = _boxes_at_heads(sample.obstacle_boxes.astype(np.float64))
            truth[row, :-1] = others_truth(along[row], boxes, sample.hold)
        if sample.road is not None and not np.isnan(sample.road[0, 0]):
            known[row, 1] = True
            truth[row, -1] = road_truth(sample.road.astype(np.float64))
    return known, truth


def others_truth(along: Array, boxes: Array, hold: NDArray[np.floating]) -> NDArray[np.uint8]:
    """What is true of cells (seconds + 1, stations, offsets) but for the road, as `SightTruth` has it.

    Args:
        along: (stations, offsets, 3) cells of the bird's-eye grid.
        boxes: (seconds, k, 5) at SECONDS_AHEAD in the rig frame at t0.
        hold: as in `PolicySample`.
    """
    truth = np.zeros((len(SECONDS_AHEAD) + 1, len(STATIONS), len(OFFSETS)), np.uint8)
    truth[:-1] = np.rint(_WHOLE * nearness(along[:, TOLD], boxes))
    if hold[0] == 1.0:
        truth[-1] = _WHOLE * (np.abs(STATIONS - FRONT - hold[1]) < HELD_ROOM)[:, None]
    return truth


def _boxes_at_heads(boxes: Array) -> Array:
    """Boxes (times, k, 5) of TRUTH_OFFSETS_US at the times of the heads: halfway between those known, NaN beyond."""
    told = 1e-6 * np.array(TRUTH_OFFSETS_US)
    boxes = boxes.copy()
    boxes[..., 2] = np.unwrap(boxes[..., 2], axis=0)
    before = np.clip(np.searchsorted(told, SECONDS_AHEAD, side="right") - 1, 0, len(told) - 2)
    share = (np.array(SECONDS_AHEAD) - told[before]) / (told[before + 1] - told[before])
    found = np.where(share[:, None, None] == 1.0, boxes[before + 1], boxes[before])
    between = (share > 0.0) & (share < 1.0)
    mixed = boxes[before] + share[:, None, None] * (boxes[before + 1] - boxes[before])
    return np.where(between[:, None, None], mixed, found)


def nearness(cells: Array, boxes: Array) -> Array:
    """How near boxes (seconds, k, 5) are to cells (rows, columns, 3): (seconds, rows, columns) of 0 to 1.

    A cell is as long as rows are apart, and the nearest of its parts tells.
    """
    found = np.zeros((len(boxes), *cells.shape[:2]))
    reach = (FAR + np.hypot(boxes[..., 3], boxes[..., 4]) / 2)[..., None]
    apart = np.gradient(cells[..., :2], axis=0)
    first, last = (cells[..., :2] - apart).min(axis=(0, 1)), (cells[..., :2] + apart).max(axis=(0, 1))
    near = ((boxes[..., :2] + reach > first) & (boxes[..., :2] - reach < last)).all(axis=-1)  # NaN is near nothing
    x, y, yaw, length, width = np.moveaxis(boxes[near], -1, 0)[..., None, None]
    for part in _PARTS:
        dx, dy = np.moveaxis(cells[..., :2] + part * apart, -1, 0)[:, None] - np.stack([x, y])
        ahead = np.abs(np.cos(yaw) * dx + np.sin(yaw) * dy) - length / 2
        aside = np.abs(np.cos(yaw) * dy - np.sin(yaw) * dx) - width / 2
        distance = np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0))
        np.maximum.at(found, np.nonzero(near)[0], np.clip((FAR - distance) / (FAR - NEAR), 0.0, 1.0))
    return found


def road_truth(road: Array) -> NDArray[np.uint8]:
    """What share of cells (stations, offsets) is road, 255 for 1, of points with the road beside them (20, 4)."""
    known = road[~np.isnan(road[:, 0])]
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(known[:, :2], axis=0).T))])
    right, left = (np.interp(STATIONS, way, column)[:, None] for column in known[:, 2:].T)
    width = OFFSETS[1] - OFFSETS[0]
    inner = np.minimum(left - OFFSETS, right + OFFSETS)
    return np.rint(_WHOLE * np.clip(inner / width + 0.5, 0.0, 1.0)).astype(np.uint8)


def sight_errors(sight: Sight, truth: SightTruth) -> Tensor:
    """Cross-entropy (n,) of the heads; 0 where the truth is not known."""
    errors = functional.binary_cross_entropy_with_logits(
        sight.route, truth.route / _WHOLE, pos_weight=torch.tensor(TAKEN_WEIGHT), reduction="none"
    )
    planes = errors.mean((2, 3))
    others, road = planes[:, :-1].sum(dim=1), planes[:, -1]
    return _SIGHT_SCALE / planes.shape[1] * (others * truth.known[:, 0] + road * truth.known[:, 1])


def plan_errors(planned: Tensor, wanted: Tensor, speeds: Tensor) -> Tensor:
    """Errors (n,) of normalised actions (n, 64, 2) and of where they lead from speeds (n,) in m/s.

    The near future counts more, since plans are made anew all the time. Errors of actions are cut to their size beyond
    one, so that the mean of two ways to drive is no better than one of them.
    """
    time = STEP_SECONDS * torch.arange(1, FUTURE_STEPS + 1)
    weight = torch.exp(-time / _FADES_SECONDS)
    weight = weight / weight.mean()
    actions = functional.huber_loss(planned, wanted, reduction="none").mean(dim=2)
    apart = (drive(planned, speeds) - drive(wanted, speeds)).abs().sum(dim=-1) / (0.5 + time)
    return ((actions + apart) * weight).mean(dim=1)


def drive(actions: Tensor, speeds: Tensor) -> Tensor:
    """Places (n, 64, 2) in metres to which normalised actions (n, 64, 2) lead, as `actions_to_trajectory` does."""
    physical = actions * torch.tensor(ACTION_STD, dtype=torch.float32) + torch.tensor(ACTION_MEAN, dtype=torch.float32)
    acceleration, curvature = physical.unbind(dim=-1)
    start = speeds[:, None]
    speed = torch.cat([start, start + torch.cumsum(acceleration * STEP_SECONDS, dim=1)], dim=1)
    steps = speed[:, :-1] * STEP_SECONDS + 0.5 * acceleration * STEP_SECONDS**2
    heading = torch.cat([torch.zeros_like(start), torch.cumsum(curvature * steps, dim=1)], dim=1)
    velocity = speed[..., None] * torch.stack([heading.cos(), heading.sin()], dim=-1)
    return torch.cumsum(0.5 * STEP_SECONDS * (velocity[:, :-1] + velocity[:, 1:]), dim=1)
