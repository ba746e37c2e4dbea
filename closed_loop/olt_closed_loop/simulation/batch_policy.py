"""Policies that answer for many rollouts at once.

A policy with `plan_batch` keeps nothing between calls, so one of it drives whole batches of rollouts in step. Each row
of its answer depends on the same row of the observations alone: a rollout is the same alone and in any batch.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_toolkit.policy.contract import Observation, PlannedTrajectory, Policy


@dataclass(frozen=True)
class ObservationBatch:
    """What n rollouts show their policy; fields as in `Observation`, without images.

    Attributes:
        history_xyz: (n, 16, 3).
        history_rotation: (n, 16, 3, 3).
        route_xy: (n, 20, 2), filled up with NaN where the route ends earlier or is not known.
        time_us: (n,).
        seeds: (n,).
    """

    history_xyz: Array
    history_rotation: Array
    route_xy: Array
    time_us: NDArray[np.int64]
    seeds: NDArray[np.int64]

    @classmethod
    def of(cls, observation: Observation) -> "ObservationBatch":
        """The batch of one."""
        return cls(
            observation.history_xyz[None],
            observation.history_rotation[None],
            observation.route_xy[None],
            np.array([observation.time_us], dtype=np.int64),
            np.array([observation.seed], dtype=np.int64),
        )

    def row(self, index: int) -> "ObservationBatch":
        """The batch of the one rollout at `index`."""
        return ObservationBatch(**{name: values[index : index + 1] for name, values in vars(self).items()})


@runtime_checkable
class BatchPolicy(Policy, Protocol):
    """A policy without cameras and memory. `uses_route` says whether it looks at the route at all."""

    uses_route: bool

    def plan_batch(self, observations: ObservationBatch) -> PlannedTrajectory:
        """Answer for every row: xyz (n, 64, 3) and rotation (n, 64, 3, 3)."""
        ...
