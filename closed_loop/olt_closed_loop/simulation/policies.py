"""Policies that need no cameras: baselines that answer for many rollouts at once.

A policy with `plan_batch` keeps nothing between calls, so one of it drives whole batches of rollouts in step. Each row
of its answer depends on the same row of the observations alone: a rollout is the same alone and in any batch.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import EntryPoint, entry_points

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.poses import Array, planar_pose
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS, Observation, PlannedTrajectory, Policy

FUTURE_TIMES: Array = STEP_SECONDS * np.arange(1, FUTURE_STEPS + 1, dtype=np.float64)
PolicyLoader = Callable[[str | None], Policy]
"""What an entry point of the group `olt.policies` names: builds the policy from the text after the colon, if any."""


def make_policy(spec: str) -> Policy:
    """The policy called NAME or NAME:ARGUMENT: found through the entry points `olt.policies` and `BUILT_IN`.

    Raises:
        InputError: no package brings a policy of that name, or it does not take the argument.
    """
    loader: PolicyLoader = find_policy(spec).load()
    return loader(spec.partition(":")[2] or None)


def find_policy(spec: str) -> EntryPoint:
    """The entry point of the policy called NAME or NAME:ARGUMENT.

    Raises:
        InputError: no package brings a policy of that name.
    """
    name = spec.partition(":")[0]
    found = {**{entry.name: entry for entry in entry_points(group="olt.policies")}, **BUILT_IN}
    if name not in found:
        raise InputError(f"policy {name!r} is not known; choose from {', '.join(sorted(found))}")
    return found[name]


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


class ConstantVelocityPolicy(BatchPolicy):
    """Goes straight on at the present speed."""

    name = "constant_velocity"

    def plan_batch(self, observations: ObservationBatch) -> PlannedTrajectory:
        """See `BatchPolicy.plan_batch`."""
        return _straight(_speed(observations)[:, None] * FUTURE_TIMES)


class ConstantSpeedPolicy(BatchPolicy):
    """Holds the present speed and the present turn, as a car does whose wheel and pedals nobody moves."""

    name = "constant_speed"

    def plan_batch(self, observations: ObservationBatch) -> PlannedTrajectory:
        """See `BatchPolicy.plan_batch`."""
        distances = _speed(observations)[:, None] * FUTURE_TIMES
        headings = _yaw_rate(observations)[:, None] * FUTURE_TIMES
        # Chords of the circle: exact for any turn, none included.
        chords = distances * np.sinc(headings / (2.0 * np.pi))
        poses = planar_pose(chords * np.cos(headings / 2.0), chords * np.sin(headings / 2.0), headings)
        return PlannedTrajectory(poses[..., :3, 3], poses[..., :3, :3])


class StandingPolicy(BatchPolicy):
    """Brakes to a standstill and stays."""

    name = "standing"
    braking = 4.0
    """Deceleration, m/s^2."""

    def plan_batch(self, observations: ObservationBatch) -> PlannedTrajectory:
        """See `BatchPolicy.plan_batch`."""
        speed = np.maximum(_speed(observations), 0.0)[:, None]
        time = np.minimum(FUTURE_TIMES, speed / self.braking)
        return _straight(speed * time - 0.5 * self.braking * time**2)


class RouteFollowingPolicy(BatchPolicy):
    """Follows the route at the present speed; knows of nothing else."""

    name = "route"
    uses_route = True
    return_distance = 8.0
    """Metres over which an offset from the route fades to 1/e."""

    def plan_batch(self, observations: ObservationBatch) -> PlannedTrajectory:
        """See `BatchPolicy.plan_batch`.

        Raises:
            InputError: no route is known.
        """
        route = observations.route_xy
        if route.shape[1] < 2 or np.isnan(route[:, :2]).any():
            raise InputError("policy route: the scene gives no route ahead; choose another policy or scene")
        travelled = np.maximum(_speed(observations), 0.0)[:, None] * FUTURE_TIMES
        offset = np.exp(-travelled / self.return_distance)[..., None] * -route[:, :1]
        points = _along(route, travelled) + offset
        # The plans face where they go; while they do not move they face as before.
        moves = np.diff(points, axis=1, prepend=0.0)
        moving = np.hypot(moves[..., 0], moves[..., 1]) > 1e-3
        headings = np.where(moving, np.arctan2(moves[..., 1], moves[..., 0]), 0.0)
        latest = np.maximum.accumulate(np.where(moving, np.arange(moves.shape[1]), -1), axis=1)
        held = np.take_along_axis(headings, np.maximum(latest, 0), axis=1)
        poses = planar_pose(points[..., 0], points[..., 1], np.where(latest >= 0, held, 0.0))
        return PlannedTrajectory(poses[..., :3, 3], poses[..., :3, :3])


def _load(make: type[BatchPolicy], argument: str | None) -> Policy:
    if argument is not None:
        raise InputError(f"policy {make.name} takes nothing after its name; leave out {argument!r}")
    return make()


load_constant_speed = partial(_load, ConstantSpeedPolicy)
load_constant_velocity = partial(_load, ConstantVelocityPolicy)
load_route = partial(_load, RouteFollowingPolicy)
load_standing = partial(_load, StandingPolicy)
BUILT_IN = {
    name: EntryPoint(name, f"{module}:load_{name}", "olt.policies")
    for name, module in {
        **dict.fromkeys(("constant_speed", "constant_velocity", "route", "standing"), __name__),
        "grpc": "olt_closed_loop.drivers.remote_driver",
        **dict.fromkeys(("privileged", "recorded"), "olt_closed_loop.evaluation.scene_policies"),
    }.items()
}
"""Policies that are there whatever else is installed, by name."""


def _speed(observations: ObservationBatch) -> Array:
    """Speed (n,) along the vehicle now, m/s: one-sided difference, exact while the acceleration is steady."""
    before, last, now = observations.history_xyz[:, -3:, 0].T
    return (3.0 * now - 4.0 * last + before) / (2.0 * STEP_SECONDS)


def _yaw_rate(observations: ObservationBatch) -> Array:
    """Yaw rate (n,) now, rad/s, by the same difference; the yaw now is 0."""
    before, last = np.arctan2(*np.moveaxis(observations.history_rotation[:, -3:-1, [1, 0], [0, 0]], -1, 0)).T
    return (before - 4.0 * last) / (2.0 * STEP_SECONDS)


def _straight(distances: Array) -> PlannedTrajectory:
    """Plans straight ahead by distances (n, 64)."""
    poses = planar_pose(distances, 0.0, 0.0)
    return PlannedTrajectory(poses[..., :3, 3], poses[..., :3, :3])


def _along(paths: Array, distances: Array) -> Array:
    """Points (n, k, 2) at distances (n, k) along polylines (n, m, 2), which NaN may end; last segments go on."""
    lengths = np.nan_to_num(np.linalg.norm(np.diff(paths, axis=1), axis=2))
    starts = np.concatenate([np.zeros((len(paths), 1)), np.cumsum(lengths, axis=1)], axis=1)
    last = np.max(np.where(lengths > 0.0, np.arange(lengths.shape[1]), 0), axis=1)
    segment = np.sum(distances[..., None] >= starts[:, None, 1:], axis=2)
    segment = np.minimum(segment, last[:, None])
    row = np.arange(len(paths))[:, None]
    share = (distances - starts[row, segment]) / lengths[row, segment]
    begin, end = paths[row, segment], paths[row, segment + 1]
    return begin + share[..., None] * (end - begin)
