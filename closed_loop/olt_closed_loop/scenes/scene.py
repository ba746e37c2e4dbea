"""The scene in memory: road, lanes, route, recorded ego and agents. `scene_file` reads and writes it.

World frame: metres, z up, the ground is z = 0 unless a lane or hills say otherwise; times are integer microseconds from
the start of the recording.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.maps.lanes import Crossing, Lane, Light, StopLine
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions


@dataclass(frozen=True)
class Agent:
    """A recorded road user or object.

    Attributes:
        id: unique in the scene.
        label: class in the words of the PhysicalAI-AV obstacle table (automobile, person, rider, ...), cone or barrier.
        length, width, height: box size in metres.
        timestamps_us: (n,) int64, strictly increasing; outside its first and last sample the agent does not exist, and
            between two it moves on a line. Who is away for a while and back is two agents (`sources.tracks`).
        poses: (n, 4) float64: x, y, z of the box centre and yaw.

    Raises:
        InputError: a time is not after the one before it.
    """

    id: str
    label: str
    length: float
    width: float
    height: float
    timestamps_us: NDArray[np.int64]
    poses: Array

    def __post_init__(self) -> None:
        wrong = np.flatnonzero(self.timestamps_us[1:] <= self.timestamps_us[:-1])
        if len(wrong):
            raise InputError(
                f"agent {self.id:.80}: time {wrong[0] + 1} is not after the one before it; sort and deduplicate them"
            )


@dataclass(frozen=True)
class Hills:
    """Ground whose height changes along one direction only, in straight pieces; level before and behind.

    Attributes:
        direction: of the change, radians from the world's x axis.
        start: place of the first height along that direction from the origin, metres.
        step: metres between two heights.
        heights: (n,) metres.
    """

    direction: float
    start: float
    step: float
    heights: Array

    def along(self, points: Array) -> Array:
        """Places (...) of points (..., 2 or 3) along the direction of the change, metres from the origin."""
        return points[..., 0] * np.cos(self.direction) + points[..., 1] * np.sin(self.direction)

    def height(self, points: Array) -> Array:
        """Height (...) of the ground at points (..., 2 or 3), metres."""
        known = self.start + self.step * np.arange(len(self.heights))
        return np.interp(self.along(points), known, self.heights)


@dataclass(frozen=True)
class Scene:
    """A closed-loop scene.

    Attributes:
        name: unique name.
        category: long-tail category, or "nominal".
        factors: scene factors that hold (cone_delineated, cyclists, work_zone, ...).
        vehicle: size of the ego vehicle.
        ego: recorded ego trajectory T_world_rig from time 0.
        agents: recorded agents.
        lanes: all lanes.
        road_edges: polylines (n, 3) that bound the drivable area, which lies to their left.
        drivable: closed outlines (n, 3) of the drivable area, counter-clockwise.
        route: (n, 3) the line that the ego is meant to follow.
        looks: path of the scene file whose payload holds what only rendering needs; None if there is none.
        assumptions: what the recording does not say and was assumed, a sentence each.
        hills: height of the ground; None where it is level.
        stop_lines, crossings, lights: what regulates traffic; () also where the recording does not say.
    """

    name: str
    category: str
    factors: tuple[str, ...]
    vehicle: VehicleDimensions
    ego: Trajectory
    agents: tuple[Agent, ...]
    lanes: tuple[Lane, ...]
    road_edges: tuple[Array, ...]
    drivable: tuple[Array, ...]
    route: Array
    looks: str | None = None
    assumptions: tuple[str, ...] = ()
    hills: Hills | None = None
    stop_lines: tuple[StopLine, ...] = ()
    crossings: tuple[Crossing, ...] = ()
    lights: tuple[Light, ...] = ()
