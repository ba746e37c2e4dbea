"""Collisions of the ego with the agents: when, on which side, and who moved into whom.

Boxes stand upright and are not shrunk. `scoring.contacts` finds when they touch; here a contact is described by
the axis that separated the boxes until then, so that its side depends neither on heading nor on the order of agents.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.contacts import first_contacts
from olt_closed_loop.scoring.moving_boxes import MovingBox, separations
from olt_generator.poses import Array

STANDING_SPEED = 0.1
"""An ego slower than this, m/s, moves into nobody."""
FAULT_SHARE = 0.25
"""Share of the closing speed from which on the ego moved into the agent. Head-on both did; an ego that creeps while it
is run into did not, nor one that is hit from behind or cut in on."""
_VELOCITY_US = 20_000

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


def within_reach(ego: MovingBox, agent: MovingBox, start_us: int, end_us: int) -> bool:
    """Whether the areas that the two sweep over all their time come near enough to touch.

    Interpolated centres stay in the bounds of the sampled ones, so an agent out of reach can be left out.
    """
    if end_us < agent.timestamps_us[0] or start_us > agent.timestamps_us[-1]:
        return False
    reach = ego.radius + agent.radius
    low, high = agent.poses[:, :2].min(axis=0) - reach, agent.poses[:, :2].max(axis=0) + reach
    return bool(np.all(ego.poses[:, :2].max(axis=0) >= low) and np.all(ego.poses[:, :2].min(axis=0) <= high))


def find_collisions(
    ego: MovingBox,
    agents: Sequence[Agent],
    boxes: Sequence[MovingBox],
    start_us: int,
    end_us: int,
    skip_unreachable: bool = True,
) -> tuple[tuple[Collision, ...], int]:
    """First contact with each agent from `start_us` to `end_us`, in order of time, and how many were left out.

    The ego's box is sampled over all of that time; `skip_unreachable` leaves out agents that cannot be reached.
    """
    tested = [
        (agent, box)
        for agent, box in zip(agents, boxes, strict=True)
        if not skip_unreachable or within_reach(ego, box, start_us, end_us)
    ]
    contacts = first_contacts(ego, [box for _, box in tested], start_us, end_us)
    collisions = [
        _describe(ego, box, agent, start_us, start_us + int(np.ceil(after_us)))
        for (agent, box), after_us in zip(tested, contacts, strict=True)
        if np.isfinite(after_us)
    ]
    return tuple(sorted(collisions, key=lambda hit: (hit.time_us, hit.agent_id))), len(agents) - len(tested)


def _describe(ego: MovingBox, box: MovingBox, agent: Agent, start_us: int, contact_us: int) -> Collision:
    """Side and fault from the axis that separated the boxes a microsecond before the contact.

    The side is that of the direction along this axis: ahead, behind, or more to the side than either.
    """
    before_us = max(contact_us - 1, start_us, int(box.timestamps_us[0]))
    moment = np.array([before_us])
    ego_pose, other_pose = ego.at(moment)[0], box.at(moment)[0]
    gaps, _ = separations(ego_pose[None], ego.half_size, other_pose[None], box.half_size)
    axis = int(np.argmax(gaps[0, :4]))
    yaw = (ego_pose if axis < 2 else other_pose)[3] + (np.pi / 2 if axis % 2 else 0.0)
    direction = np.array([np.cos(yaw), np.sin(yaw)])
    if direction @ (other_pose[:2] - ego_pose[:2]) < 0.0:
        direction = -direction
    ahead = float(direction @ [np.cos(ego_pose[3]), np.sin(ego_pose[3])])
    point = _contact_point(direction, corners(ego_pose, ego.half_size), corners(other_pose, box.half_size))
    ego_velocity = _velocity_at(ego, before_us, point)
    ego_closing = float(direction @ ego_velocity)
    agent_closing = float(-direction @ _velocity_at(box, before_us, point))
    moving = float(np.linalg.norm(ego_velocity)) > STANDING_SPEED
    return Collision(
        time_us=contact_us,
        agent_id=agent.id,
        label=agent.label,
        side="lateral" if abs(ahead) <= np.cos(np.pi / 4) else "front" if ahead > 0.0 else "rear",
        at_fault=moving and ego_closing > FAULT_SHARE * (ego_closing + max(agent_closing, 0.0)),
        ego_closing=ego_closing,
        agent_closing=agent_closing,
    )


def _contact_point(direction: Array, ego_corners: Array, other_corners: Array) -> Array:
    """Point (2,) where the boxes meet: midway between the extents that face each other, in the plane of both."""
    across = np.array([-direction[1], direction[0]])
    intervals = [facing @ across for facing in (_facing(ego_corners, direction), _facing(other_corners, -direction))]
    low, high = max(values.min() for values in intervals), min(values.max() for values in intervals)
    depth = 0.5 * ((ego_corners @ direction).max() + (other_corners @ direction).min())
    return depth * direction + 0.5 * (low + high) * across


def _facing(points: Array, direction: Array) -> Array:
    """The points (1 or 2, 2) that reach farthest along `direction`, to a millimetre."""
    reach = points @ direction
    return points[reach > reach.max() - 1e-3]


def _velocity_at(box: MovingBox, time_us: int, point: Array) -> Array:
    """Velocity (2,) in m/s of the body's point over the 20 ms that end at `time_us`, or that its time begins with."""
    first, last = int(box.timestamps_us[0]), int(box.timestamps_us[-1])
    begin = max(time_us - _VELOCITY_US, first)
    end = max(time_us, min(begin + _VELOCITY_US, last))
    if end == begin:
        return np.zeros(2)
    (start, stop), seconds = box.at(np.array([begin, end])), (end - begin) * 1e-6
    velocity, yaw_rate = (stop[:2] - start[:2]) / seconds, (stop[3] - start[3]) / seconds
    arm = point - stop[:2]
    return velocity + yaw_rate * np.array([-arm[1], arm[0]])
