"""What only the toy is trained on beside its stages' own losses: plans in numbers, and what is where.

The real model brings knowledge of the world from its pre-training. The toy starts from nothing and with minutes to
learn, so Stage 1 also tells it, where a data set knows the truth, which cells of its bird's-eye grids are taken now and
in the seconds to come, and where a red light or somebody's hand holds the way; and it regresses the whole plan at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from olt_generator.poses import Array
from olt_sft_recipes.toy.birds_eye import FRONT, STATIONS, world_cells
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD, TAKEN_WEIGHT, Sight
from olt_toolkit.policy.action_space import ACTION_MEAN, ACTION_STD
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS
from olt_toolkit.policy.sample import TRUTH_OFFSETS_US, PolicySample

ROUTE_ROOM, WORLD_ROOM = 0.8, 1.0
"""A cell is taken where its centre is nearer to somebody than so many metres."""
HELD_ROOM = 1.5
_SIGHT_SCALE = 6.0
_FADES_SECONDS = 3.0


@dataclass(frozen=True)
class SightTruth:
    """What the heads of the image encoder are to tell.

    Attributes:
        known: (n,) bool, whether the sample knows it.
        route: (n, seconds + 1, stations, offsets) uint8 as `Sight.route`.
        world: (n, seconds, rows, columns) uint8 as `Sight.world`.
    """

    known: Tensor
    route: Tensor
    world: Tensor


def gather_truth(
    samples: Sequence[PolicySample], along: Array
) -> tuple[NDArray[np.bool_], NDArray[np.uint8], NDArray[np.uint8]]:
    """Whether samples know what is where, and what, as `SightTruth` has it.

    Args:
        samples: n samples.
        along: (n, stations, offsets, 3) cells of their route grids.
    """
    seconds, world = len(SECONDS_AHEAD), world_cells()
    known = np.zeros(len(samples), bool)
    route_truth = np.zeros((len(samples), seconds + 1, *along.shape[1:3]), np.uint8)
    world_truth = np.zeros((len(samples), seconds, *world.shape[:2]), np.uint8)
    for row, sample in enumerate(samples):
        if sample.obstacle_boxes is None or sample.hold is None or np.isnan(sample.hold[0]):
            continue
        known[row] = True
        boxes = _boxes_at_heads(sample.obstacle_boxes.astype(np.float64))
        route_truth[row, :-1] = _taken(along[row], boxes, ROUTE_ROOM)
        world_truth[row] = _taken(world, boxes, WORLD_ROOM)
        held, metres = sample.hold
        if held == 1.0:
            route_truth[row, -1] = (np.abs(STATIONS - FRONT - metres) < HELD_ROOM)[:, None]
    return known, route_truth, world_truth


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


def _taken(cells: Array, boxes: Array, room: float) -> NDArray[np.bool_]:
    """Whether cells (rows, columns, 3) are nearer than `room` to a box (seconds, k, 5): (seconds, rows, columns)."""
    taken = np.zeros((len(boxes), *cells.shape[:2]), dtype=bool)
    reach = (room + np.hypot(boxes[..., 3], boxes[..., 4]) / 2)[..., None]
    first, last = cells[..., :2].min(axis=(0, 1)), cells[..., :2].max(axis=(0, 1))
    near = ((boxes[..., :2] + reach > first) & (boxes[..., :2] - reach < last)).all(axis=-1)  # NaN is near nothing
    x, y, yaw, length, width = np.moveaxis(boxes[near], -1, 0)[..., None, None]
    dx, dy = cells[..., 0] - x, cells[..., 1] - y
    ahead = np.abs(np.cos(yaw) * dx + np.sin(yaw) * dy) - length / 2
    aside = np.abs(np.cos(yaw) * dy - np.sin(yaw) * dx) - width / 2
    found = np.maximum(ahead, 0.0) ** 2 + np.maximum(aside, 0.0) ** 2 < room**2
    np.logical_or.at(taken, np.nonzero(near)[0], found)
    return taken


def sight_errors(sight: Sight, truth: SightTruth) -> Tensor:
    """Cross-entropy (n,) of both grids; 0 where the truth is not known."""
    errors = _cross_entropy(sight.route, truth.route) + _cross_entropy(sight.world, truth.world)
    return _SIGHT_SCALE * errors * truth.known


def _cross_entropy(logits: Tensor, truth: Tensor) -> Tensor:
    weight = torch.tensor(TAKEN_WEIGHT)
    errors = functional.binary_cross_entropy_with_logits(logits, truth.float(), pos_weight=weight, reduction="none")
    return errors.mean((1, 2, 3))


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
