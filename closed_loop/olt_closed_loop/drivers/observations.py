"""What a driver is told of the ego and its route, and the plan that its answer is."""

from typing import Any

import numpy as np

from olt_closed_loop.control.plans import PlanRefused
from olt_closed_loop.drivers import contract
from olt_closed_loop.drivers.conversions import poses_at, read_trajectory, write_trajectory, write_vector
from olt_generator.errors import InputError
from olt_generator.poses import Array, make_pose
from olt_toolkit.policy.contract import (
    FUTURE_STEPS,
    HISTORY_STEPS,
    STEP_SECONDS,
    STEP_US,
    Observation,
    PlannedTrajectory,
)

SHORTEST_PLAN = 10
"""Steps of 0.1 s that an answer must cover: as many as the controller looks ahead."""


def write_egomotion(observation: Observation, steps: int, T_local_rig: Array) -> Any:
    """The message `RolloutEgoTrajectory` of the newest poses of an observation, with their rates."""
    poses = make_pose(observation.history_rotation, observation.history_xyz)
    times = observation.time_us - STEP_US * np.arange(HISTORY_STEPS - 1, -1, -1)
    states = _dynamic_states(poses)
    new = np.arange(HISTORY_STEPS) >= HISTORY_STEPS - steps
    new &= times >= 0  # times before 0 do not exist on the wire
    message = contract.RolloutEgoTrajectory()
    message.trajectory.CopyFrom(write_trajectory(times[new].tolist(), T_local_rig @ poses[new]))
    for index in np.flatnonzero(new):
        state = message.dynamic_states.add()
        for field, values in zip(_RATES, states, strict=True):
            getattr(state, field).CopyFrom(write_vector(values[index]))
    return message


def write_routes(observation: Observation) -> list[Any]:
    """The message `RouteRequest`, if a route is known."""
    if not len(observation.route_xy):
        return []
    message = contract.RouteRequest()
    message.route.timestamp_us = observation.time_us
    message.route.waypoints.extend(contract.Vec3(x=x, y=y) for x, y in observation.route_xy.tolist())
    return [message]


_RATES = ("linear_velocity", "angular_velocity", "linear_acceleration", "angular_acceleration")


def _dynamic_states(poses: Array) -> tuple[Array, Array, Array, Array]:
    """Velocities and accelerations (n, 3), linear and angular, in the rig of each of the poses (n, 4, 4).

    Differences of second order, one-sided at the ends; accelerations are the differences of the velocities.
    """
    rotation = poses[:, :3, :3]
    slope = np.gradient(poses[:, :3, :], STEP_SECONDS, axis=0, edge_order=2)
    accelerated = np.gradient(slope[:, :, 3], STEP_SECONDS, axis=0, edge_order=2)
    spin = np.einsum("nji,njk->nik", rotation, slope[:, :, :3])
    angular = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
    in_rig = np.einsum("nji,njk->nik", rotation, np.stack([slope[:, :, 3], accelerated], axis=-1))
    return in_rig[..., 0], angular, in_rig[..., 1], np.gradient(angular, STEP_SECONDS, axis=0, edge_order=2)


def read_plan(trajectory: Any, now_us: int, T_rig_local: Array) -> PlannedTrajectory:
    """The plan of an answer: a message `Trajectory` of rig poses in the local frame.

    Poses before now are passed over; where the first is later than now, the way leads there from where the rig is.

    Raises:
        PlanRefused: it does not cover `SHORTEST_PLAN` from now, begins only after that, its times do not rise, or its
            poses are none.
    """
    try:
        times, poses = read_trajectory(trajectory, "plan")
    except InputError as error:
        raise PlanRefused(str(error)) from error
    if len(times) == 0:
        raise PlanRefused("plan of no poses")
    if np.any(np.diff(times) <= 0):
        raise PlanRefused("times of the plan do not increase")
    first, last = (int(times[0]) - now_us) * 1e-6, (int(times[-1]) - now_us) * 1e-6
    shortest = SHORTEST_PLAN * STEP_SECONDS
    if last < shortest or first > shortest:
        covered = f"from {first:.1f} s to {last:.1f} s from now"
        raise PlanRefused(f"plan of {len(times)} poses {covered}; control looks {shortest:g} s ahead")
    poses = T_rig_local @ poses
    if first > 0.0:
        times, poses = np.concatenate([[now_us], times]), np.concatenate([np.eye(4)[None], poses])
    wanted = now_us + STEP_US * np.arange(1, FUTURE_STEPS + 1, dtype=np.int64)
    planned = poses_at(times, poses, np.minimum(wanted, times[-1]))
    seconds_beyond = np.maximum(wanted - times[-1], 0) * 1e-6
    velocity = (poses[-1, :3, 3] - poses[-2, :3, 3]) / ((times[-1] - times[-2]) * 1e-6)
    planned[:, :3, 3] += seconds_beyond[:, None] * velocity
    return PlannedTrajectory(planned[:, :3, 3], planned[:, :3, :3])
