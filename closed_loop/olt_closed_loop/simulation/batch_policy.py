"""Policies that answer for many rollouts at once.

A policy with `plan_batch` keeps nothing between calls, so one of it drives whole batches of rollouts in step. Each row
of its answer depends on the same row of the observations alone: a rollout is the same alone and in any batch.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_toolkit.policy.contract import Observation, PlannedTrajectory


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


class BatchPolicy(ABC):
    """A policy without cameras and memory. `uses_route` says whether it looks at the route at all."""

    name: str
    cameras: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)
    uses_route = False

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """See `Policy.plan`."""
        plans = self.plan_batch(ObservationBatch.of(observation))
        return PlannedTrajectory(plans.xyz[0], plans.rotation[0])

    @abstractmethod
    def plan_batch(self, observations: ObservationBatch) -> PlannedTrajectory:
        """Answer for every row: xyz (n, 64, 3) and rotation (n, 64, 3, 3)."""
