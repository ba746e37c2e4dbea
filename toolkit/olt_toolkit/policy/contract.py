"""The policy contract: what eats camera images and ego history, and answers with a trajectory.

Shapes, rates and frames are those of Alpamayo (docs/formats/alpamayo.md). A toy policy, a
trained checkpoint and a remote driver are the same thing to whoever calls `Policy.plan`.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array

HISTORY_STEPS = 16
FUTURE_STEPS = 64
IMAGE_FRAMES = 4
STEP_US = 100_000
STEP_SECONDS = 0.1


@dataclass(frozen=True)
class Observation:
    """What a policy sees at time t0.

    Attributes:
        images: (cameras, 4, 3, H, W) uint8 RGB at t0 - 0.3, -0.2, -0.1, 0 s, or None for a policy without cameras.
        camera_indices: (cameras,) int64, ascending (`olt_toolkit.rigs.rig.CAMERA_INDEX`).
        history_xyz: (16, 3) float64 rig positions at t0 - 1.5 ... 0 s in the rig frame at t0; the last is the origin.
        history_rotation: (16, 3, 3) float64.
        route_xy: (n, 2) float64 points ahead on the route in the rig frame at t0; empty when no route is known.
        seed: seeds any sampling of this call, so that the answer is a pure function of the observation.
    """

    images: NDArray[np.uint8] | None
    camera_indices: NDArray[np.int64]
    history_xyz: Array
    history_rotation: Array
    route_xy: Array
    time_us: int
    seed: int


@dataclass(frozen=True)
class PlannedTrajectory:
    """Rig poses at t0 + 0.1 ... 6.4 s in the rig frame at t0: xyz (64, 3) and rotation (64, 3, 3), float64."""

    xyz: Array
    rotation: Array


class Policy(Protocol):
    """A driving policy. `cameras` names what it needs, in index order; nothing else is rendered for it.

    The three attributes are read once, before the first call. A policy leaves its observation, the global states of
    `random` and `numpy.random`, and the working folder as they are.
    """

    name: str
    cameras: tuple[str, ...]
    image_size: tuple[int, int]
    """Height and width of the images that it takes."""

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """Answer with the trajectory to follow."""
        ...


@runtime_checkable
class Resettable(Protocol):
    """A policy that forgets at the start of a rollout. Any other is made anew for every rollout."""

    def reset(self, seed: int, scene: str) -> None:
        """Forget all earlier calls: the next answers depend on these two and on the observations to come."""
        ...
