"""What a scene tells beside its images: boxes of others as the vehicle has them around it, whether its way is held, and
how far the road goes beside its route.

Labels for auxiliary losses, every 0.1 s from a time of the recording on, to which their times are counted.
"""

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.privileged.holds import holds_of
from olt_closed_loop.privileged.truth import area_of
from olt_closed_loop.scenes.actors import agent_poses
from olt_closed_loop.scenes.polylines import arc_lengths, without_repeats
from olt_closed_loop.scenes.scene import Scene
from olt_generator.poses import Array, invert, planar_pose, yaw_of
from olt_toolkit.policy.contract import STEP_US
from olt_toolkit.policy.route import ROUTE_LENGTH, PathTracker
from olt_toolkit.recordings.truth import Holds, ObstacleTracks

REACH = 80.0
"""Metres up to which others are told."""
ROADSIDE, ROADSIDE_STEP = 10.0, 0.1
"""Metres up to which road is told beside the route, and how finely."""
_PASSED = 1.0
"""Metres beyond a line up to which it is still the next one."""


def label_obstacles(scene: Scene, start_us: int) -> ObstacleTracks:
    """Boxes of all who are within REACH of the rig."""
    times = _times(scene, start_us)
    T_world_rig = scene.ego.interpolate(times)
    T_rig_world, yaw = invert(T_world_rig), yaw_of(T_world_rig)
    stamps, names, labels, boxes = [times[:0]], [np.empty(0, np.str_)], [np.empty(0, np.str_)], [np.empty((0, 7))]
    for agent in scene.agents:
        there = np.flatnonzero((times >= agent.timestamps_us[0]) & (times <= agent.timestamps_us[-1]))
        poses = agent_poses(agent, times[there])
        centers = np.einsum("nij,nj->ni", T_rig_world[there, :3, :3], poses[:, :3]) + T_rig_world[there, :3, 3]
        near = np.hypot(centers[:, 0], centers[:, 1]) <= REACH
        size = np.broadcast_to((agent.length, agent.width, agent.height), centers.shape)
        boxes.append(np.column_stack([centers, poses[:, 3] - yaw[there], size])[near])
        stamps.append(times[there][near])
        names.append(np.full(int(near.sum()), agent.id))
        labels.append(np.full(int(near.sum()), agent.label))
    all_stamps = np.concatenate(stamps)
    order = np.argsort(all_stamps, kind="stable")
    return ObstacleTracks(
        all_stamps[order] - start_us,
        np.concatenate(names)[order],
        np.concatenate(labels)[order],
        np.concatenate(boxes)[order],
    )


def label_holds(scene: Scene, start_us: int) -> Holds:
    """Whether the next line on the route that is held at some time is held, and how far it is."""
    times, end_us = _times(scene, start_us), int(scene.ego.timestamps_us[-1])
    held, distance = np.zeros(len(times), dtype=bool), np.full(len(times), np.nan)
    holds = holds_of(scene.lanes, scene.lights, scene.route, end_us) if len(scene.route) > 1 else ()
    if holds:
        line = shapely.LineString(scene.route[:, :2])
        middles = [shapely.Point(hold.line.mean(axis=0)) for hold in holds]
        stations = np.array([line.project(middle) for middle in middles])
        front = scene.vehicle.rear_axle_to_bbox_center + 0.5 * scene.vehicle.length
        for row, arc in enumerate(_arc_lengths(scene, times).tolist()):
            ahead = stations - arc - front
            ahead = np.where((ahead > -_PASSED) & (ahead <= ROUTE_LENGTH), ahead, np.inf)
            if not np.isfinite(nearest := ahead.min()):
                continue
            distance[row] = nearest
            held[row] = any(
                hold.from_us <= times[row] < hold.until_us
                for hold, gap in zip(holds, ahead.tolist(), strict=True)
                if gap - nearest < _PASSED
            )
    return Holds(times - start_us, held, distance)


def label_road(scene: Scene, start_us: int) -> Array | None:
    """Points of the route, and metres of road to the right and left of each that can be driven without a gap (n, 4).

    Places are seen from the rig at a time of the recording, without its roll and pitch. None without route or road.
    """
    drivable = area_of(scene.drivable)
    if drivable is None or len(scene.route) < 2:
        return None
    points = without_repeats(scene.route[:, :2])
    tangent = np.gradient(points, arc_lengths(points), axis=0)
    left = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / np.linalg.norm(tangent, axis=1)[:, None]
    metres = np.arange(ROADSIDE_STEP, ROADSIDE + 0.5 * ROADSIDE_STEP, ROADSIDE_STEP)
    shapely.prepare(drivable)
    sides = []
    for side in (-left, left):
        x, y = np.moveaxis(points[:, None] + metres[:, None] * side[:, None], -1, 0)
        road = np.asarray(shapely.contains_xy(drivable, x, y))
        sides.append(ROADSIDE_STEP * np.cumprod(road, axis=1).sum(axis=1))
    T_world_rig = scene.ego.interpolate(np.array([start_us], dtype=np.int64))[0]
    T_rig_world = invert(planar_pose(T_world_rig[0, 3], T_world_rig[1, 3], float(yaw_of(T_world_rig))))
    seen = points @ T_rig_world[:2, :2].T + T_rig_world[:2, 3]
    return np.column_stack([seen, *sides])


def _times(scene: Scene, start_us: int) -> NDArray[np.int64]:
    return np.arange(start_us, int(scene.ego.timestamps_us[-1]) + 1, STEP_US, dtype=np.int64)


def _arc_lengths(scene: Scene, times: NDArray[np.int64]) -> Array:
    """Arc lengths (n,) of the rig along the route, metres."""
    tracker, places = PathTracker(scene.route[:, :2]), scene.ego.interpolate(times)[:, :2, 3]
    tracker.start_at(places[0])
    return np.array([tracker.advance(place) for place in places])
