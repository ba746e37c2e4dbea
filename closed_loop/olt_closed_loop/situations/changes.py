"""Situations a little changed, moved and mirrored, to see whether a verdict stays."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout_record import LaneLines, RolloutRecord
from olt_generator.poses import Array

Change = Callable[[Array], Array]

SHARE = 0.01
"""Of the speed, and in radians of the heading."""
PLACE = 0.05
"""Metres; 1 % of the length of a car."""


def changed(record: RolloutRecord, contact_us: int, draws: Array) -> RolloutRecord:
    """A rollout whose ego and first agent drive a little faster or slower, elsewhere, and in another direction.

    Args:
        record: the rollout; its other agents stay.
        contact_us: when the two touch; they are changed about where they are then, so that they still do.
        draws: (8,) from -1 to 1, shares of the largest change: speed, heading, x and y of the agent, then of the ego.
    """
    partner, *others = record.agents
    agent = _changed(partner.timestamps_us, partner.poses, contact_us, draws[:4])
    return replace(
        record,
        poses=_changed(record.timestamps_us, record.poses, contact_us, draws[4:]),
        agents=(replace(partner, poses=agent), *others),
    )


def _changed(times: NDArray[np.int64], poses: Array, contact_us: int, draws: Array) -> Array:
    speed, turn = 1.0 + SHARE * draws[0], SHARE * draws[1]
    asked = contact_us + speed * (times - contact_us)
    unwrapped = np.column_stack([poses[:, :3], np.unwrap(poses[:, 3])])
    sped_up = np.stack([np.interp(asked, times, column) for column in unwrapped.T], axis=-1)
    # Before the first and after the last sample it goes on as between those two.
    for end, other, beyond in ((0, 1, asked < times[0]), (-1, -2, asked > times[-1])):
        velocity = (poses[end, :2] - poses[other, :2]) / (times[end] - times[other])
        sped_up[beyond, :2] = poses[end, :2] + (asked[beyond] - times[end])[:, None] * velocity
    place = np.array([np.interp(contact_us, times, column) for column in poses[:, :2].T])
    turned = _turned(sped_up[:, :2] - place, turn) + place + PLACE * draws[2:]
    return np.column_stack([turned, sped_up[:, 2], sped_up[:, 3] + turn])


def moved(record: RolloutRecord, yaw: float, shift: tuple[float, float] = (0.0, 0.0)) -> RolloutRecord:
    """The whole rollout turned about the origin and then shifted."""

    def points(line: Array) -> Array:
        return np.column_stack([_turned(line[:, :2], yaw) + shift, line[:, 2:]])

    def poses(track: Array) -> Array:
        return points(track) + np.array([0.0, 0.0, 0.0, yaw])

    lanes = tuple(
        replace(lane, center=points(lane.center), left=_maybe(points, lane.left), right=_maybe(points, lane.right))
        for lane in record.lanes
    )
    return _with(record, points, poses, lanes)


def mirrored(record: RolloutRecord) -> RolloutRecord:
    """The whole rollout mirrored at the x axis: traffic keeps to the other side."""

    def points(line: Array) -> Array:
        return line * np.array([1.0, -1.0, *[1.0] * (line.shape[1] - 2)])

    def poses(track: Array) -> Array:
        return track * np.array([1.0, -1.0, 1.0, -1.0])

    lanes = tuple(
        LaneLines(points(lane.center), _maybe(points, lane.right), _maybe(points, lane.left), lane.red_us)
        for lane in record.lanes
    )
    return _with(record, points, poses, lanes)


def _with(record: RolloutRecord, points: Change, poses: Change, lanes: tuple[LaneLines, ...]) -> RolloutRecord:
    return replace(
        record,
        poses=poses(record.poses),
        recorded_poses=poses(record.recorded_poses),
        agents=tuple(replace(agent, poses=poses(agent.poses)) for agent in record.agents),
        lanes=lanes,
        road_edges=tuple(points(edge) for edge in record.road_edges),
    )


def _maybe(points: Change, line: Array | None) -> Array | None:
    return None if line is None else points(line)


def _turned(points: Array, yaw: float) -> Array:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[cos, sin], [-sin, cos]])
