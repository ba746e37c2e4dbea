"""Upright boxes over time, and the gaps between them.

Between samples centres move linearly and yaws turn at a constant rate, the short way. Two boxes touch when no axis
separates them: the axes of both in the plane (separating axis theorem; Ericson, Real-Time Collision Detection,
section 4.4.1) and height.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scenes.presence import jumps, stretches_between
from olt_closed_loop.scenes.scene import Agent
from olt_generator.poses import Array

SHORTEST_GAP_US = 500_000
USUAL_STEPS = 3


@dataclass(frozen=True)
class MovingBox:
    """A box over time: poses (n, 4) at times (n,), and half its length, width and height (3,) in metres.

    A pose is x, y, z of the centre in the world, metres, and unwrapped yaw, radians.
    """

    timestamps_us: NDArray[np.int64]
    poses: Array
    half_size: Array

    def at(self, timestamps_us: NDArray[np.int64], columns: int = 4) -> Array:
        """Poses (m, 4), or only their first columns, at times (m,) within the box's own."""
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


def ego_box(record: RolloutRecord) -> MovingBox:
    """The ego's box along its drive."""
    x, y, z, yaw = record.poses.T
    ahead, half_height = record.box.rear_axle_to_center, 0.5 * record.box.height
    poses = np.stack([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), z + half_height, np.unwrap(yaw)], axis=-1)
    return MovingBox(
        record.timestamps_us, poses, 0.5 * np.array([record.box.length, record.box.width, record.box.height])
    )


def agent_box(agent: Agent) -> MovingBox:
    """An agent's box along its recording."""
    poses = np.column_stack([agent.poses[:, :3], np.unwrap(agent.poses[:, 3])])
    return MovingBox(agent.timestamps_us, poses, 0.5 * np.array([agent.length, agent.width, agent.height]))


def stretches(agents: Sequence[Agent]) -> Iterator[Agent]:
    """Agents over the times without a gap, so that nobody is taken to be where it was not seen.

    A gap is longer than half a second and than three times the agent's usual step, or one that nothing on a road
    crosses in its time.
    """
    for agent in agents:
        steps = np.diff(agent.timestamps_us)
        if len(steps) == 0:
            yield agent
            continue
        longest = max(SHORTEST_GAP_US, USUAL_STEPS * float(np.median(steps)))
        away = (steps > longest) | jumps(agent.timestamps_us, agent.poses[:, :2])
        if not away.any():
            yield agent
            continue
        for part in stretches_between(away):
            yield replace(agent, timestamps_us=agent.timestamps_us[part], poses=agent.poses[part])


def separations(ego: Array, ego_half: Array, other: Array, other_half: Array) -> tuple[Array, Array]:
    """How far boxes are apart along each axis.

    Args:
        ego, other: poses (n, 4), as in `MovingBox`.
        ego_half, other_half: half sizes (3,) or (n, 3), metres.

    Returns:
        Signed gaps (n, 5) in metres along the axes of the ego (2), of the other box (2), and height, negative where
        the boxes overlap along the axis; and the offsets (n, 5) of the other's centre along these axes.
    """
    offset = other[:, :3] - ego[:, :3]
    turn = other[:, 3] - ego[:, 3]
    cos_turn, sin_turn = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    offsets, sizes = np.empty((len(ego), 5)), np.empty((len(ego), 5))
    for first, (own, theirs, yaw) in enumerate(
        ((ego_half, other_half, ego[:, 3]), (other_half, ego_half, other[:, 3]))
    ):
        cos, sin = np.cos(yaw), np.sin(yaw)
        offsets[:, 2 * first] = cos * offset[:, 0] + sin * offset[:, 1]
        offsets[:, 2 * first + 1] = cos * offset[:, 1] - sin * offset[:, 0]
        sizes[:, 2 * first] = own[..., 0] + theirs[..., 0] * cos_turn + theirs[..., 1] * sin_turn
        sizes[:, 2 * first + 1] = own[..., 1] + theirs[..., 1] * cos_turn + theirs[..., 0] * sin_turn
    offsets[:, 4], sizes[:, 4] = offset[:, 2], ego_half[..., 2] + other_half[..., 2]
    return np.abs(offsets) - sizes, offsets
