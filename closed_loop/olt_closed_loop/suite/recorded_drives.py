"""How somebody who sees everything drives through an event, as the recording of its scene."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.privileged.holds import holds_of
from olt_closed_loop.privileged.plan import Drive, plan_drive
from olt_closed_loop.privileged.truth import Truth, area_of
from olt_closed_loop.scenes.driving import SAMPLE_US
from olt_closed_loop.suite.courses import DURATION_US
from olt_closed_loop.suite.event import Event
from olt_generator.poses import Array, planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

SEES_US = 2_000_000
"""Until when the recorded driver drives as if nothing were ahead."""
BEYOND_US = 3_000_000
"""How far beyond a recording is planned."""


def truth_of_event(event: Event) -> Truth:
    """What the recorded driver knows of an event."""
    ground, road_map = event.ground, event.ground.road_map
    route, end_us = road_map.route_line(ground.lanes)[:, :2], DURATION_US + BEYOND_US
    holds = holds_of(road_map.lanes, road_map.lights, route, end_us)
    return Truth(route, area_of(road_map.drivable), event.agents, holds, DEFAULT_VEHICLE, ground.cruise, end_us)


def first_drives(event: Event, truth: Truth) -> tuple[Drive, Drive]:
    """The drive up to SEES_US, as if nothing were ahead, and the one from there with the truth."""
    ground = event.ground
    x, y, _ = ground.course.locate(ground.start)
    before = plan_drive(replace(truth, agents=(), holds=()), 0, float(x[0]), float(y[0]), ground.cruise)
    x, y, _ = before.poses(np.array([SEES_US, SEES_US + SAMPLE_US]))
    speed = float(np.hypot(x[1] - x[0], y[1] - y[0])) / (1e-6 * SAMPLE_US)
    return before, plan_drive(truth, SEES_US, float(x[0]), float(y[0]), speed)


def recorded_drive(event: Event) -> Trajectory:
    """The recording, 20 s long."""
    before, after = first_drives(event, truth_of_event(event))
    times = np.arange(0, DURATION_US + 1, SAMPLE_US, dtype=np.int64)
    parts = before.poses(times[times < SEES_US]), after.poses(times[times >= SEES_US])
    return Trajectory(times, planar_pose(*joined(parts)))


def joined(parts: tuple[tuple[Array, Array, Array], ...]) -> tuple[Array, Array, Array]:
    """Poses x, y, yaw (n,) one after another."""
    x, y, yaw = (np.concatenate(part) for part in zip(*parts, strict=True))
    return x, y, yaw


def speed_at(poses: tuple[Array, Array, Array], timestamps_us: NDArray[np.int64]) -> float:
    """Speed at the last of poses, from the last two, m/s."""
    x, y, _ = poses
    return float(np.hypot(x[-1] - x[-2], y[-1] - y[-2]) / (1e-6 * (timestamps_us[-1] - timestamps_us[-2])))
