"""What a definition of the score looks at: one rollout, what was around it, and what had been recorded there."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scenes.scene_map import map_of
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import Array, yaw_of

PLAN_STEP_US = 100_000


@dataclass(frozen=True)
class EgoBox:
    """The ego's box in metres; its centre is `rear_axle_to_center` ahead of the rig and half its height above it."""

    length: float
    width: float
    height: float
    rear_axle_to_center: float


@dataclass(frozen=True)
class LaneLines:
    """One lane: centre line and, where known, its borders, each (n, 3) in driving direction, metres.

    `red_us` (k, 2) holds from when until when the light at its start was red, microseconds; None where none is known.
    """

    center: Array
    left: Array | None = None
    right: Array | None = None
    red_us: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class PlanRecord:
    """What the policy planned at one time, in the world.

    Attributes:
        now_us: when the plan was made.
        query_us: the first time that it was asked for.
        timestamps_us: (n,) int64 times of its poses, increasing.
        poses: (n, 3) x, y, yaw of the rig in the world, metres and radians.
        samples: further plans (n, 3) that the policy drew at the same times.
    """

    now_us: int
    query_us: int
    timestamps_us: NDArray[np.int64]
    poses: Array
    samples: tuple[Array, ...] = ()


@dataclass(frozen=True)
class RolloutRecord:
    """One rollout with everything that scoring needs; times are integer microseconds, lengths metres, angles radians.

    Attributes:
        name: what the rollout is called.
        handover_us: when the policy took over; what comes before is warm-up.
        timestamps_us: (n,) int64, strictly increasing.
        poses: (n, 4) x, y, z, yaw of the rig in the world.
        box: size of the ego.
        agents: the others.
        recorded_us, recorded_poses: (m,) times and (m, 4) rig poses of the recorded ego.
        lanes, road_edges: the map; road edges are polylines (n, 3) of either direction.
        drivable: closed outlines (n, 3) of the drivable area, where the map has them.
        plans: what the policy planned, in order of time.
        failure: why the rollout broke off, or None.
        driver_ended: whether the policy itself asked for the end of the drive.
        absent: names of agents that the source has, of which no sample counts.
    """

    name: str
    handover_us: int
    timestamps_us: NDArray[np.int64]
    poses: Array
    box: EgoBox
    agents: tuple[Agent, ...]
    recorded_us: NDArray[np.int64]
    recorded_poses: Array
    lanes: tuple[LaneLines, ...] = ()
    road_edges: tuple[Array, ...] = ()
    drivable: tuple[Array, ...] = ()
    plans: tuple[PlanRecord, ...] = ()
    failure: str | None = None
    driver_ended: bool = False
    absent: tuple[str, ...] = ()


def record_rollout(scene: Scene, rollout: Rollout) -> RolloutRecord:
    """The record of a rollout of a scene. A policy's plan is the one sample that it drew."""
    vehicle = scene.vehicle
    x, y, yaw = rollout.states[:, [STATE.x, STATE.y, STATE.yaw]].T
    T_world_rig, road_map = scene.ego.T_world_rig, map_of(scene)
    end_us = int(rollout.timestamps_us[-1])
    return RolloutRecord(
        name=scene.name,
        handover_us=rollout.handover_us,
        timestamps_us=rollout.timestamps_us,
        poses=np.stack([x, y, rollout.heights, yaw], axis=-1),
        box=EgoBox(vehicle.length, vehicle.width, vehicle.height, vehicle.rear_axle_to_bbox_center),
        agents=rollout.driven_scene(scene).agents,
        recorded_us=scene.ego.timestamps_us,
        recorded_poses=np.column_stack([T_world_rig[:, :3, 3], yaw_of(T_world_rig)]),
        lanes=tuple(
            LaneLines(lane.center, lane.left, lane.right, road_map.red_us(lane.id, end_us))
            for lane in scene.lanes
            if lane.for_cars
        ),
        road_edges=scene.road_edges,
        drivable=scene.drivable,
        plans=tuple(
            PlanRecord(now_us, now_us + PLAN_STEP_US, now_us + PLAN_STEP_US * np.arange(len(poses)), poses, (poses,))
            for now_us, poses in zip(rollout.plan_times_us.tolist(), rollout.plans, strict=True)
        ),
    )
