"""Collisions of the ego with the agents: when, on which side, who was at fault and why.

Boxes stand upright and are not shrunk. `scoring.contacts` finds when they touch; here a contact is described by
the axis that separated the boxes until then, so that its side depends neither on heading nor on the order of agents.
`scoring.fault` says who was at fault. An agent that is over the ego when it appears, or at the hand-over, has not
been hit: it counts from when the two have been apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.contacts import TOUCH, first_contacts
from olt_closed_loop.scoring.drivable import DrivableArea
from olt_closed_loop.scoring.fault.encounter import Encounter, Side, Site
from olt_closed_loop.scoring.fault.lanes import LaneMap
from olt_closed_loop.scoring.fault.rules import judge
from olt_closed_loop.scoring.moving_boxes import MovingBox, separations
from olt_generator.poses import Array

_VELOCITY_US = 20_000
_APART_US = 20_000
NOWHERE = Site()
"""Of a scene without lanes, drivable area and recording."""


@dataclass(frozen=True)
class Collision:
    """The first contact with one agent.

    Attributes:
        time_us: when they touched.
        agent_id, label: whom.
        side: the side of the ego that the contact presses on.
        at_fault: whether the ego was at fault.
        rule: which rule of `scoring.fault.rules` decided.
        reason: why, in words.
        ego_closing, agent_closing: speed of each towards the other along the direction of contact, m/s.
    """

    time_us: int
    agent_id: str
    label: str
    side: Side
    at_fault: bool
    rule: str
    reason: str
    ego_closing: float
    agent_closing: float


@dataclass(frozen=True)
class Contacts:
    """What was found.

    Attributes:
        collisions: first contact with each agent, in order of time.
        appeared: agents that were over the ego when they appeared.
        handed_over: agents that were over the ego at the hand-over.
        unreachable: how many agents were left out as never within reach.
    """

    collisions: tuple[Collision, ...]
    appeared: tuple[str, ...]
    handed_over: tuple[str, ...]
    unreachable: int


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
    site: Site = NOWHERE,
) -> Contacts:
    """First contact with each agent from `start_us` to `end_us`.

    The ego's box is sampled over all of that time; `skip_unreachable` leaves out agents that cannot be reached. Of
    several agents of one name, which are one that was away for a while, the first contact counts.
    """
    tested = [
        (agent, box)
        for agent, box in zip(agents, boxes, strict=True)
        if not skip_unreachable or within_reach(ego, box, start_us, end_us)
    ]
    contacts = first_contacts(ego, [box for _, box in tested], start_us, end_us)
    hits: dict[str, Collision] = {}
    appeared: set[str] = set()
    handed_over: set[str] = set()
    for (agent, box), after_us in zip(tested, contacts, strict=True):
        first_us = max(start_us, int(box.timestamps_us[0]))
        if start_us + after_us <= first_us:
            (appeared if int(box.timestamps_us[0]) >= start_us else handed_over).add(agent.id)
            after_us = _contact_after_apart(ego, box, first_us, end_us) - start_us
        if np.isfinite(after_us):
            hit = _describe(ego, box, agent, start_us, start_us + int(np.ceil(after_us)), site, boxes)
            if agent.id not in hits or hit.time_us < hits[agent.id].time_us:
                hits[agent.id] = hit
    ordered = sorted(hits.values(), key=lambda hit: (hit.time_us, hit.agent_id))
    return Contacts(tuple(ordered), tuple(sorted(appeared)), tuple(sorted(handed_over)), len(agents) - len(tested))


def site_of(record: RolloutRecord, drivable: DrivableArea | None) -> Site:
    """What a rollout tells of the place of its contacts. Only outlines say where one may drive beside the lanes."""
    lanes = LaneMap(record.lanes, record.poses[0, :2]) if record.lanes else None
    outlines = drivable if drivable and drivable.edges is None else None
    return Site(lanes, outlines, record.recorded_poses)


def _contact_after_apart(ego: MovingBox, box: MovingBox, first_us: int, end_us: int) -> float:
    """When boxes that touch at `first_us` touch again after they have been apart; infinite if they never do."""
    last_us = min(end_us, int(box.timestamps_us[-1]))
    times = np.arange(first_us, last_us + 1, _APART_US, dtype=np.int64)
    gaps, _ = separations(ego.at(times), ego.half_size, box.at(times), box.half_size)
    apart = np.flatnonzero(gaps.max(axis=1) >= TOUCH)
    if len(apart) == 0:
        return np.inf
    from_us = int(times[apart[0]])
    return from_us + float(first_contacts(ego, [box], from_us, end_us)[0])


def _describe(
    ego: MovingBox,
    box: MovingBox,
    agent: Agent,
    start_us: int,
    contact_us: int,
    site: Site,
    others: Sequence[MovingBox],
) -> Collision:
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
    side: Side = "lateral" if abs(ahead) <= np.cos(np.pi / 4) else "front" if ahead > 0.0 else "rear"
    point = _contact_point(direction, corners(ego_pose, ego.half_size), corners(other_pose, box.half_size))
    finding = judge(Encounter(ego, box, agent.label, contact_us, start_us, side, direction, point, site, others))
    return Collision(
        time_us=contact_us,
        agent_id=agent.id,
        label=agent.label,
        side=side,
        at_fault=finding.at_fault,
        rule=finding.rule,
        reason=finding.reason,
        ego_closing=float(direction @ _velocity_at(ego, before_us, point)),
        agent_closing=float(-direction @ _velocity_at(box, before_us, point)),
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
