"""What a planner that sees everything knows of a drive to come."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.moving_boxes import MovingBox, agent_box
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import VehicleDimensions

STANDS = 0.3
"""Metres that who stands may move."""


@dataclass(frozen=True)
class Hold:
    """Nobody may pass a line while it is held: a red light, or somebody who holds up a hand.

    Attributes:
        line: its two ends (2, 2), metres.
        from_us, until_us: while it is held.
    """

    line: Array
    from_us: int
    until_us: int


@dataclass(frozen=True)
class Truth:
    """A drive to come.

    Attributes:
        route: (n, 2) line to follow, metres.
        drivable: where the vehicle may be, in the world; None if that is not known.
        agents: everybody, as they will move.
        holds: lines that may not be passed for a while.
        vehicle: its size.
        cruise: speed where nothing asks for less, m/s.
        end_us: how far to plan.
    """

    route: Array
    drivable: BaseGeometry | None
    agents: tuple[Agent, ...]
    holds: tuple[Hold, ...]
    vehicle: VehicleDimensions
    cruise: float
    end_us: int

    @property
    def half_size(self) -> Array:
        """Half of the vehicle's length, width and height (3,), metres."""
        return 0.5 * np.array([self.vehicle.length, self.vehicle.width, self.vehicle.height])

    def box_poses(self, x: Array, y: Array, yaw: Array) -> Array:
        """Poses (..., 4) of the centre of the vehicle's box from those of its rig, on level ground."""
        ahead = self.vehicle.rear_axle_to_bbox_center
        height = np.full_like(x, 0.5 * self.vehicle.height)
        return np.stack([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), height, yaw], axis=-1)


def box_of(agent: Agent) -> MovingBox:
    """An agent's box at ground level, since plans are made in the plane."""
    box = agent_box(agent)
    poses = box.poses.copy()
    poses[:, 2] = 0.0
    return MovingBox(box.timestamps_us, poses, np.array([*box.half_size[:2], 10.0]))


def stands(agent: Agent, from_us: int, until_us: int) -> bool:
    """Whether an agent stands, or is not there, from one time to another."""
    box = box_of(agent)
    first, last = max(from_us, int(box.timestamps_us[0])), min(until_us, int(box.timestamps_us[-1]))
    if last <= first:
        return True
    inside = box.timestamps_us[(box.timestamps_us > first) & (box.timestamps_us < last)]
    times: NDArray[np.int64] = np.array([first, *inside.tolist(), last], dtype=np.int64)
    places = box.at(times, columns=2)
    return bool(np.hypot(*(places - places[0]).T).max() <= STANDS)


def area_of(outlines: tuple[Array, ...]) -> BaseGeometry | None:
    """The union of closed outlines (n, 2 or more); None without one."""
    if not outlines:
        return None
    return shapely.union_all([shapely.make_valid(shapely.Polygon(outline[:, :2])) for outline in outlines])
