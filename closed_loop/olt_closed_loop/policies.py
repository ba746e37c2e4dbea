"""Policies that need no cameras: baselines, and proofs that the loop is closed."""

from collections.abc import Callable
from importlib.metadata import entry_points

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scene import Scene
from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.policy import FUTURE_STEPS, STEP_SECONDS, STEP_US, Observation, Plan, Policy

FUTURE_TIMES: Array = STEP_SECONDS * np.arange(1, FUTURE_STEPS + 1, dtype=np.float64)
PolicyLoader = Callable[[str | None], Policy]
"""What an entry point of the group `olt.policies` names: builds the policy from the text after the colon, if any."""


def make_policy(spec: str) -> Policy:
    """The policy called NAME or NAME:ARGUMENT, found through the entry points `olt.policies`.

    Raises:
        InputError: no package brings a policy of that name, or it does not take the argument.
    """
    name, _, argument = spec.partition(":")
    found = {entry.name: entry for entry in entry_points(group="olt.policies")}
    if name not in found:
        raise InputError(f"policy {name!r} is not known; choose from {', '.join(sorted(found))}")
    loader: PolicyLoader = found[name].load()
    return loader(argument or None)


class _CameralessPolicy:
    cameras: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)


class ConstantVelocityPolicy(_CameralessPolicy):
    """Goes straight on at the present speed."""

    name = "constant_velocity"

    def plan(self, observation: Observation) -> Plan:
        """See `Policy.plan`."""
        return _straight(_speed(observation) * FUTURE_TIMES)


class StandingPolicy(_CameralessPolicy):
    """Brakes to a standstill and stays."""

    name = "standing"
    braking = 4.0
    """Deceleration, m/s^2."""

    def plan(self, observation: Observation) -> Plan:
        """See `Policy.plan`."""
        speed = max(_speed(observation), 0.0)
        time = np.minimum(FUTURE_TIMES, speed / self.braking)
        return _straight(speed * time - 0.5 * self.braking * time**2)


class RouteFollowingPolicy(_CameralessPolicy):
    """Follows the route at the present speed; knows of nothing else."""

    name = "route"
    return_distance = 8.0
    """Metres over which an offset from the route fades to 1/e."""

    def plan(self, observation: Observation) -> Plan:
        """See `Policy.plan`.

        Raises:
            InputError: no route is known.
        """
        route = observation.route_xy
        if len(route) < 2:
            raise InputError("policy route: the scene gives no route ahead; choose another policy or scene")
        travelled = max(_speed(observation), 0.0) * FUTURE_TIMES
        offset = np.exp(-travelled / self.return_distance)[:, None] * -route[0]
        points = _along(route, travelled) + offset
        return _facing_forward(points)


class ReplayPolicy(_CameralessPolicy):
    """Drives back to and along the recording of the scene.

    It keeps track of its pose in the world by the observed history, from the recorded pose at which it is first asked;
    so it serves one rollout after the other, not two at once.
    """

    name = "replay"

    def __init__(self, scene: Scene) -> None:
        self._recording = scene.ego
        self._T_world_rig = np.eye(4)
        self._time_us: int | None = None

    def plan(self, observation: Observation) -> Plan:
        """See `Policy.plan`; after the recording's end the plan goes straight on at the last recorded speed."""
        now = observation.time_us
        if self._time_us is not None and now == self._time_us + STEP_US:
            self._T_world_rig = self._T_world_rig @ invert(_previous_pose(observation))
        else:
            self._T_world_rig = self._recording.interpolate(np.array([now]))[0]
        self._time_us = now
        future_us = now + STEP_US * np.arange(1, FUTURE_STEPS + 1, dtype=np.int64)
        in_rig = invert(self._T_world_rig) @ _going_on(self._recording, future_us)
        return Plan(in_rig[:, :3, 3], in_rig[:, :3, :3])


def load_constant_velocity(argument: str | None) -> Policy:
    """Entry point of `ConstantVelocityPolicy`."""
    return _without_argument(ConstantVelocityPolicy(), argument)


def load_route(argument: str | None) -> Policy:
    """Entry point of `RouteFollowingPolicy`."""
    return _without_argument(RouteFollowingPolicy(), argument)


def load_standing(argument: str | None) -> Policy:
    """Entry point of `StandingPolicy`."""
    return _without_argument(StandingPolicy(), argument)


def _without_argument(policy: Policy, argument: str | None) -> Policy:
    if argument is not None:
        raise InputError(f"policy {policy.name} takes nothing after its name; leave out {argument!r}")
    return policy


def _speed(observation: Observation) -> float:
    """Speed along the vehicle now, m/s: one-sided difference, exact while the acceleration is steady."""
    before, last, now = observation.history_xyz[-3:, 0]
    return float((3.0 * now - 4.0 * last + before) / (2.0 * STEP_SECONDS))


def _previous_pose(observation: Observation) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = observation.history_rotation[-2], observation.history_xyz[-2]
    return pose


def _going_on(recording: Trajectory, timestamps_us: NDArray[np.int64]) -> Array:
    """Recorded poses (n, 4, 4) at the given times; beyond the end the last two poses are carried on."""
    end = int(recording.timestamps_us[-1])
    before, last = recording.T_world_rig[-2:, :3, 3]
    velocity = (last - before) / (end - recording.timestamps_us[-2])
    poses = recording.interpolate(np.minimum(timestamps_us, end))
    poses[:, :3, 3] += np.maximum(timestamps_us - end, 0)[:, None] * velocity
    return poses


def _straight(distances: Array) -> Plan:
    poses = planar_pose(distances, 0.0, 0.0)
    return Plan(poses[:, :3, 3], poses[:, :3, :3])


def _along(path: Array, distances: Array) -> Array:
    """Points (n, 2) at these distances along a polyline (m, 2), m >= 2; its last segment goes on."""
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    points = np.stack([np.interp(distances, starts, column) for column in path.T], axis=-1)
    beyond = np.maximum(distances - starts[-1], 0.0)
    return points + beyond[:, None] * (path[-1] - path[-2]) / lengths[-1]


def _facing_forward(points: Array) -> Plan:
    """The plan through points (64, 2) that faces where it goes; while it does not move it faces as before."""
    moves = np.diff(np.concatenate([np.zeros((1, 2)), points]), axis=0)
    moving = np.linalg.norm(moves, axis=1) > 1e-3
    headings = np.where(moving, np.arctan2(moves[:, 1], moves[:, 0]), 0.0)
    latest = np.maximum.accumulate(np.where(moving, np.arange(len(moves)), -1))
    yaw = np.where(latest >= 0, headings[latest], 0.0)
    poses = planar_pose(points[:, 0], points[:, 1], yaw)
    return Plan(poses[:, :3, 3], poses[:, :3, :3])
