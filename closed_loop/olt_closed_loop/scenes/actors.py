"""Agents on a road, and how close two of them come."""

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.scenes.roads import Road
from olt_closed_loop.scenes.scene import Agent
from olt_generator.poses import Array, transform, yaw_of
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions

AGENT_SAMPLE_US = 100_000
_SIGNS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])

# Length, width and height in metres.
SIZES: dict[str, tuple[float, float, float]] = {
    "automobile": (4.6, 1.85, 1.5),
    "heavy_truck": (8.5, 2.5, 3.2),
    "other_vehicle": (4.6, 2.3, 2.9),
    "rider": (1.8, 0.65, 1.75),
    "person": (0.5, 0.6, 1.75),
    "animal": (1.7, 0.5, 1.5),
    "cone": (0.38, 0.38, 0.75),
    "barrier": (2.4, 0.4, 1.0),
}


def standing(name: str, label: str, road: Road, s: float, d: float, duration_us: int, turn: float = 0.0) -> Agent:
    """An agent that stands at road coordinates (s, d), turned by `turn` radians from the road's direction."""
    poses = _poses(label, road, np.full(2, s), np.full(2, d), turn)
    return Agent(name, label, *SIZES[label], np.array([0, duration_us], dtype=np.int64), poses)


def standing_row(
    name: str, label: str, road: Road, stations: Array, offsets: Array | float, duration_us: int
) -> list[Agent]:
    """Agents `name`_0, `name`_1, ... that stand at road coordinates (n,); one offset may serve them all."""
    places = zip(stations.tolist(), np.broadcast_to(offsets, stations.shape).tolist(), strict=True)
    return [standing(f"{name}_{index}", label, road, s, d, duration_us) for index, (s, d) in enumerate(places)]


def moving(
    name: str, label: str, road: Road, times: Array, stations: Array, offsets: Array, turn: float = 0.0
) -> list[Agent]:
    """An agent whose box centre is at stations and offsets (n,) at times (n,) in seconds; none if it never is there.

    It exists while it is on the road, and is turned by `turn` radians from the road's direction.
    """
    margin = SIZES[label][0]
    present = (stations > margin) & (stations < road.length - margin)
    if present.sum() < 2:
        return []
    timestamps_us = np.round(times[present] * 1e6).astype(np.int64)
    poses = _poses(label, road, stations[present], offsets[present], turn)
    return [Agent(name, label, *SIZES[label], timestamps_us, poses)]


def sample_times(duration_us: int) -> Array:
    """Seconds (n,) at which moving agents are recorded."""
    return np.arange(0, duration_us + 1, AGENT_SAMPLE_US, dtype=np.float64) * 1e-6


def agent_poses(agent: Agent, timestamps_us: NDArray[np.int64]) -> Array:
    """Poses (n, 4) x, y, z, yaw of the box centre at times within the agent's samples; yaw takes the shorter way."""
    return poses_at(agent, pose_columns(agent), timestamps_us)


def pose_columns(agent: Agent) -> list[Array]:
    """x, y, z and unwrapped yaw (n,) of an agent's samples, for `poses_at`."""
    return [*agent.poses[:, :3].T, np.unwrap(agent.poses[:, 3])]


def poses_at(agent: Agent, columns: list[Array], timestamps_us: NDArray[np.int64]) -> Array:
    """`agent_poses` from the columns of `pose_columns`, which one who asks often keeps."""
    known = agent.timestamps_us - agent.timestamps_us[0]
    query = timestamps_us - agent.timestamps_us[0]
    return np.stack([np.interp(query, known, column) for column in columns], axis=-1)


def corners(poses: Array, half_size: Array) -> Array:
    """Corners (..., 4, 2) in the plane, metres, of boxes at poses (..., 4) x, y, z, yaw of their centres.

    They are front left, rear left, rear right, front right; half sizes are (3,) or (..., 3), metres.
    """
    cos, sin = np.cos(poses[..., 3, None]), np.sin(poses[..., 3, None])
    along, across = np.moveaxis(_SIGNS * half_size[..., None, :2], -1, 0)
    x = poses[..., 0, None] + cos * along - sin * across
    return np.stack([x, poses[..., 1, None] + sin * along + cos * across], axis=-1)


def footprints(poses: Array, length: float, width: float) -> NDArray[np.object_]:
    """Rectangles (n,) on the ground, as shapely polygons, of boxes at poses (n, 4) x, y, z, yaw."""
    return np.asarray(shapely.polygons(corners(poses, np.array([length, width]) / 2)))


def ego_agent(ego: Trajectory, vehicle: VehicleDimensions) -> Agent:
    """The ego as an agent, sampled every 0.1 s."""
    times = np.arange(0, ego.timestamps_us[-1] + 1, AGENT_SAMPLE_US)
    T_world_rig = ego.interpolate(times)
    offset = np.array([[vehicle.rear_axle_to_bbox_center, 0.0, vehicle.height / 2]])
    poses = np.concatenate([transform(T_world_rig, offset)[:, 0], yaw_of(T_world_rig)[:, None]], axis=1)
    return Agent("ego", "automobile", vehicle.length, vehicle.width, vehicle.height, times, poses)


def clearance(first: Agent, second: Agent) -> float:
    """Smallest distance in metres between two agents, sampled every 0.1 s; inf if they never exist together."""
    start = max(first.timestamps_us[0], second.timestamps_us[0])
    end = min(first.timestamps_us[-1], second.timestamps_us[-1])
    times = np.arange(start, end + 1, AGENT_SAMPLE_US)
    if len(times) == 0:
        return float("inf")
    (ours, base), (theirs, other) = ((agent_poses(one, times), (one.length, one.width)) for one in (first, second))
    apart = np.hypot(*(ours[:, :2] - theirs[:, :2]).T)
    # The distance lies between `apart` less both radii and `apart`: only times that can hold the smallest are measured.
    close = apart - (np.hypot(*base) + np.hypot(*other)) / 2 <= apart.min()
    return float(shapely.distance(footprints(ours[close], *base), footprints(theirs[close], *other)).min())


def _poses(label: str, road: Road, stations: Array, offsets: Array, turn: float) -> Array:
    position = road.locate(stations, offsets)
    height = np.full(len(stations), SIZES[label][2] / 2)
    return np.stack([*position.T, height, road.heading(stations) + turn], axis=-1)
