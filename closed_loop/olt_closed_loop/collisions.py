"""Contact between the ego's box and the agents' boxes over time: when, on which side, and who moved into whom.

Boxes stand upright and are not shrunk. Between samples poses are interpolated (positions linearly, yaw the short way)
at no more than 20 ms apart, and a first contact is then narrowed to microseconds. Two boxes touch when no axis
separates them: the axes of both in the plane (separating axis theorem; Ericson, Real-Time Collision Detection,
section 4.4.1) and height.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.rollout import Rollout
from olt_closed_loop.scene import Agent
from olt_closed_loop.vehicle import STATE
from olt_generator.poses import Array
from olt_toolkit.rig import VehicleDimensions

SAMPLE_US = 20_000
STANDING_SPEED = 0.1
"""An ego slower than this, m/s, moves into nobody."""
FAULT_SHARE = 0.25
"""Share of the closing speed from which on the ego moved into the agent. Head-on both did; an ego that creeps while it
is run into did not, nor one that is hit from behind or cut in on."""
_TOUCH = -1e-6
"""Overlap in metres (negative gap) from which boxes touch; rounding at far coordinates stays below it."""

Side = Literal["front", "rear", "lateral"]


@dataclass(frozen=True)
class Collision:
    """The first contact with one agent.

    Attributes:
        time_us: when they touched.
        agent_id, label: whom.
        side: the side of the ego that the contact presses on.
        at_fault: whether the ego moved into the agent.
        ego_closing, agent_closing: speed of each towards the other along the direction of contact, m/s.
    """

    time_us: int
    agent_id: str
    label: str
    side: Side
    at_fault: bool
    ego_closing: float
    agent_closing: float

    def to_dict(self) -> dict[str, Any]:
        """The collision as JSON can hold it."""
        return vars(self).copy()


@dataclass(frozen=True)
class MovingBox:
    """A box over time: centre x, y, z and unwrapped yaw (n, 4) at times (n,), and half its length, width, height."""

    timestamps_us: NDArray[np.int64]
    poses: Array
    half_size: Array

    def at(self, timestamps_us: NDArray[np.int64], columns: int = 4) -> Array:
        """Poses (m, 4), or only their first columns, at times within the box's own."""
        first = self.timestamps_us[0]
        known, asked = self.timestamps_us - first, timestamps_us - first
        return np.stack([np.interp(asked, known, column) for column in self.poses[:, :columns].T], axis=-1)

    @property
    def radius(self) -> float:
        """Radius in metres of the circle about the centre that holds the box in the plane."""
        return float(np.hypot(*self.half_size[:2]))

    def covers(self, timestamps_us: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which times (m,) lie within the box's own."""
        return (timestamps_us >= self.timestamps_us[0]) & (timestamps_us <= self.timestamps_us[-1])


def ego_box(rollout: Rollout, vehicle: VehicleDimensions) -> MovingBox:
    """The ego's box along a rollout."""
    x, y, yaw = rollout.states[:, : STATE.speed].T
    poses = np.stack(
        [
            x + vehicle.rear_axle_to_bbox_center * np.cos(yaw),
            y + vehicle.rear_axle_to_bbox_center * np.sin(yaw),
            rollout.heights + 0.5 * vehicle.height,
            np.unwrap(yaw),
        ],
        axis=-1,
    )
    return MovingBox(rollout.timestamps_us, poses, 0.5 * np.array([vehicle.length, vehicle.width, vehicle.height]))


def agent_box(agent: Agent) -> MovingBox:
    """An agent's box along its recording."""
    poses = np.column_stack([agent.poses[:, :3], np.unwrap(agent.poses[:, 3])])
    return MovingBox(agent.timestamps_us, poses, 0.5 * np.array([agent.length, agent.width, agent.height]))


def sample_times(start_us: int, end_us: int) -> NDArray[np.int64]:
    """Times from start to end, both included, at most 20 ms apart."""
    return np.append(np.arange(start_us, end_us, SAMPLE_US, dtype=np.int64), end_us)


def within_reach(ego: MovingBox, agent: MovingBox, times: NDArray[np.int64]) -> bool:
    """Whether the areas that the two sweep over all their time come near enough to touch.

    Interpolated centres stay in the bounds of the sampled ones, so an agent out of reach can be left out.
    """
    if times[-1] < agent.timestamps_us[0] or times[0] > agent.timestamps_us[-1]:
        return False
    reach = ego.radius + agent.radius
    low, high = agent.poses[:, :2].min(axis=0) - reach, agent.poses[:, :2].max(axis=0) + reach
    return bool(np.all(ego.poses[:, :2].max(axis=0) >= low) and np.all(ego.poses[:, :2].min(axis=0) <= high))


def find_collisions(
    ego: MovingBox, agents: Sequence[Agent], times: NDArray[np.int64], skip_unreachable: bool = True
) -> tuple[tuple[Collision, ...], tuple[str, ...]]:
    """First contact with each agent, in order of time.

    Args:
        ego: the ego's box.
        agents: whom to test.
        times: (n,) when to test, increasing and at most 20 ms apart.
        skip_unreachable: whether agents that cannot be reached are left out.

    Returns:
        The collisions, and the ids of the agents that were left out.
    """
    collisions, left_out = [], []
    for agent in agents:
        box = agent_box(agent)
        if skip_unreachable and not within_reach(ego, box, times):
            left_out.append(agent.id)
            continue
        collision = _first_contact(ego, box, agent, times)
        if collision:
            collisions.append(collision)
    return tuple(sorted(collisions, key=lambda c: (c.time_us, c.agent_id))), tuple(sorted(left_out))


def _first_contact(ego: MovingBox, box: MovingBox, agent: Agent, times: NDArray[np.int64]) -> Collision | None:
    ends = box.timestamps_us[[0, -1]]
    shared = np.union1d(times[box.covers(times)], ends[(ends >= times[0]) & (ends <= times[-1])])
    if len(shared) == 0:
        return None
    near = np.flatnonzero(_distances(ego, box, shared) < ego.radius + box.radius)
    touching = near[_gaps(ego, box, shared[near]).max(axis=1) < _TOUCH]
    if len(touching) == 0:
        return None
    index = int(touching[0])
    before_us, contact_us = _narrow(ego, box, int(shared[max(index - 1, 0)]), int(shared[index]))
    return _describe(ego, box, agent, before_us, contact_us)


def _narrow(ego: MovingBox, box: MovingBox, apart_us: int, touching_us: int) -> tuple[int, int]:
    """Bring the last time apart and the first time touching to neighbouring microseconds."""
    while touching_us - apart_us > 1:
        times = np.unique(np.linspace(apart_us, touching_us, 33).round().astype(np.int64))
        index = 1 + int(np.argmax(_gaps(ego, box, times[1:]).max(axis=1) < _TOUCH))
        apart_us, touching_us = int(times[index - 1]), int(times[index])
    return apart_us, touching_us


def _distances(ego: MovingBox, box: MovingBox, times: NDArray[np.int64]) -> Array:
    """Distances (n,) in metres between the centres in the plane."""
    offset = ego.at(times, columns=2) - box.at(times, columns=2)
    return np.hypot(offset[:, 0], offset[:, 1])


def _gaps(ego: MovingBox, box: MovingBox, times: NDArray[np.int64]) -> Array:
    """Signed gaps (n, 5) in metres along the axes of the ego (2), of the other box (2), and height."""
    return _gaps_of(ego.at(times), ego.half_size, box.at(times), box.half_size)


def _gaps_of(ego: Array, ego_half: Array, other: Array, other_half: Array) -> Array:
    offset = other[:, :3] - ego[:, :3]
    turn = other[:, 3] - ego[:, 3]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    gaps = np.empty((len(ego), 5))
    for column, (yaw, own, foreign) in enumerate(
        ((ego[:, 3], ego_half, other_half), (other[:, 3], other_half, ego_half))
    ):
        c, s = np.cos(yaw), np.sin(yaw)
        along = np.abs(c * offset[:, 0] + s * offset[:, 1])
        across = np.abs(c * offset[:, 1] - s * offset[:, 0])
        gaps[:, 2 * column] = along - own[0] - (cos * foreign[0] + sin * foreign[1])
        gaps[:, 2 * column + 1] = across - own[1] - (sin * foreign[0] + cos * foreign[1])
    gaps[:, 4] = np.abs(offset[:, 2]) - ego_half[2] - other_half[2]
    return gaps


def _describe(ego: MovingBox, box: MovingBox, agent: Agent, before_us: int, contact_us: int) -> Collision:
    """Side and fault from the axis that separated the boxes until the contact."""
    moment = np.array([before_us])
    ego_pose, other_pose = ego.at(moment)[0], box.at(moment)[0]
    axis = int(np.argmax(_gaps(ego, box, moment)[0, :4]))
    direction = _direction(axis, ego_pose, other_pose)
    point = _contact_point(direction, ego_pose, ego.half_size, other_pose, box.half_size)
    ego_velocity = _velocity_at(ego, before_us, point)
    ego_closing = float(direction @ ego_velocity)
    agent_closing = float(-direction @ _velocity_at(box, before_us, point))
    moving = float(np.linalg.norm(ego_velocity)) > STANDING_SPEED
    return Collision(
        time_us=contact_us,
        agent_id=agent.id,
        label=agent.label,
        side=_side(direction, ego_pose[3]),
        at_fault=moving and ego_closing > FAULT_SHARE * (ego_closing + max(agent_closing, 0.0)),
        ego_closing=ego_closing,
        agent_closing=agent_closing,
    )


def _direction(axis: int, ego_pose: Array, other_pose: Array) -> Array:
    """Unit vector (2,) of the separating axis (0, 1: of the ego; 2, 3: of the other), from the ego to the other."""
    yaw = (ego_pose if axis < 2 else other_pose)[3] + (np.pi / 2 if axis % 2 else 0.0)
    direction = np.array([np.cos(yaw), np.sin(yaw)])
    return direction if direction @ (other_pose[:2] - ego_pose[:2]) >= 0.0 else -direction


def _side(direction: Array, ego_yaw: float) -> Side:
    """The contact direction seen from the ego: ahead, behind, or more to the side than either."""
    ahead = float(direction @ [np.cos(ego_yaw), np.sin(ego_yaw)])
    if abs(ahead) <= np.cos(np.pi / 4):
        return "lateral"
    return "front" if ahead > 0.0 else "rear"


def _contact_point(direction: Array, ego_pose: Array, ego_half: Array, other_pose: Array, other_half: Array) -> Array:
    """Point (2,) where the boxes meet: midway between the extents that face each other, in the plane of both."""
    across = np.array([-direction[1], direction[0]])
    corners = [_corners(ego_pose, ego_half), _corners(other_pose, other_half)]
    intervals = [(facing @ across) for facing in (_facing(corners[0], direction), _facing(corners[1], -direction))]
    low, high = max(values.min() for values in intervals), min(values.max() for values in intervals)
    depth = 0.5 * ((corners[0] @ direction).max() + (corners[1] @ direction).min())
    return depth * direction + 0.5 * (low + high) * across


def _facing(corners: Array, direction: Array) -> Array:
    """The corners (1 or 2, 2) that reach farthest along `direction`, to a millimetre."""
    reach = corners @ direction
    return corners[reach > reach.max() - 1e-3]


def _corners(pose: Array, half: Array) -> Array:
    cos, sin = np.cos(pose[3]), np.sin(pose[3])
    signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    return pose[:2] + (signs * half[:2]) @ np.array([[cos, sin], [-sin, cos]])


def _velocity_at(box: MovingBox, time_us: int, point: Array) -> Array:
    """Velocity (2,) in m/s of the body's point over the sample interval that ends at `time_us`."""
    first, last = int(box.timestamps_us[0]), int(box.timestamps_us[-1])
    begin = max(time_us - SAMPLE_US, first)
    end = max(time_us, min(begin + SAMPLE_US, last))
    if end == begin:
        return np.zeros(2)
    (start, stop), seconds = box.at(np.array([begin, end])), (end - begin) * 1e-6
    velocity, yaw_rate = (stop[:2] - start[:2]) / seconds, (stop[3] - start[3]) / seconds
    arm = point - stop[:2]
    return velocity + yaw_rate * np.array([-arm[1], arm[0]])
