"""A drive planned with the truth of a scene: which slow ones to overtake is tried, and the best drive is kept."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.privileged.paths import Path, plan_path
from olt_closed_loop.privileged.speeds import Progress, plan_speeds
from olt_closed_loop.privileged.truth import Truth, box_of, stands
from olt_closed_loop.scenes.actors import corners, footprints
from olt_closed_loop.scenes.polylines import wrap
from olt_closed_loop.scenes.scene import Agent
from olt_generator.poses import Array

ROUNDS = 3
"""How often a path past moving ones is planned anew with the times of the drive before."""
_SAME_WAY, _SLOWER = np.deg2rad(50.0), 0.85
_BEFORE, _BEHIND = 6.0, 8.0
_NEAR = 2.5
_PASS_STEP_US = 200_000
_OBSTRUCTED = 1e6
_MORE_LENGTH = 20.0


@dataclass(frozen=True)
class Drive:
    """A planned drive: the path, and the progress along it."""

    path: Path
    progress: Progress

    def poses(self, timestamps_us: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """x, y, yaw (n,) of the rig at times (n,); it goes on as it ends."""
        known, arc = self.progress.timestamps_us, self.progress.arc
        asked = np.interp(timestamps_us, known, arc)
        last = (arc[-1] - arc[-2]) / (known[-1] - known[-2])
        return self.path.poses(asked + last * np.maximum(timestamps_us - known[-1], 0))


def plan_drive(truth: Truth, now_us: int, x: float, y: float, speed: float, yaw: float | None = None) -> Drive:
    """The best drive from (x, y), metres, at `speed` m/s: it gets far, and touches nobody.

    It starts along the route, or in the direction `yaw`, radians, where that is given.
    """
    parked = [agent for agent in truth.agents if stands(agent, now_us, truth.end_us)]
    moving = [agent for agent in truth.agents if not stands(agent, now_us, truth.end_us)]
    obstacles = [_outline(agent, agent.poses[:1]) for agent in parked]
    length = max(truth.cruise, speed) * 1e-6 * (truth.end_us - now_us) + _MORE_LENGTH
    start = (x, y, speed, yaw)
    best = _drive(truth, now_us, start, length, obstacles)
    slow = [agent for agent in moving if _may_be_passed(agent, best.path, truth, now_us)]
    driven = Drive(best.path, _at_cruise(truth, now_us))
    for _ in range(ROUNDS if slow else 0):
        passed = [shape for agent in slow for shape in _beside(agent, driven, truth)]
        driven = _drive(truth, now_us, start, length, [*obstacles, *passed])
        best = min(best, driven, key=lambda drive: _badness(drive, truth))
    return best


def _drive(
    truth: Truth,
    now_us: int,
    start: tuple[float, float, float, float | None],
    length: float,
    obstacles: Sequence[shapely.Geometry],
) -> Drive:
    x, y, speed, yaw = start
    path = plan_path(truth, x, y, length, obstacles, yaw)
    return Drive(path, plan_speeds(truth, path, now_us, speed))


def _badness(drive: Drive, truth: Truth) -> float:
    """What is wrong with a drive: it touches somebody or leaves the road, or does not get far."""
    return _OBSTRUCTED * (not is_clean(drive, truth)) - float(drive.progress.arc[-1])


def is_clean(drive: Drive, truth: Truth) -> bool:
    """Whether a drive passes nobody too closely, no held line, and stays on the road."""
    return not drive.progress.obstructed and not _leaves_road(drive, truth)


def _leaves_road(drive: Drive, truth: Truth) -> bool:
    """Whether the vehicle leaves the road before the path ends."""
    if truth.drivable is None:
        return False
    x, y, yaw = drive.path.poses(np.arange(0.0, min(float(drive.progress.arc[-1]), drive.path.length), 0.5))
    boxes = np.asarray(shapely.polygons(corners(truth.box_poses(x, y, yaw), truth.half_size)))
    shapely.prepare(truth.drivable)
    return not bool(np.asarray(shapely.covers(truth.drivable, boxes)).all())


def _at_cruise(truth: Truth, now_us: int) -> Progress:
    times = np.array([now_us, truth.end_us], dtype=np.int64)
    return Progress(times, truth.cruise * (1e-6 * (times - now_us).astype(np.float64)), False)


def _may_be_passed(agent: Agent, path: Path, truth: Truth, now_us: int) -> bool:
    """Whether an agent goes along the path, slower than the vehicle would or against it."""
    box = box_of(agent)
    times = np.arange(max(now_us, int(box.timestamps_us[0])), int(box.timestamps_us[-1]), 500_000, dtype=np.int64)
    if len(times) < 3:
        return False
    poses = box.at(times)
    arc = np.arange(0.0, path.length, 1.0)
    x, y, yaw = path.poses(arc)
    distances = np.hypot(x - poses[:, :1], y - poses[:, 1:2])
    nearest = np.argmin(distances, axis=1)
    near = distances.min(axis=1) < _NEAR + 0.5 * agent.width
    turn = np.abs(wrap(poses[:, 3] - yaw[nearest]))
    speed = np.hypot(*(poses[-1, :2] - poses[0, :2])) / (1e-6 * (times[-1] - times[0]))
    if near.sum() < 3:
        return False
    against = bool((turn[near] > np.pi - _SAME_WAY).mean() > 0.5)
    return against or bool((turn[near] < _SAME_WAY).mean() > 0.5 and speed < _SLOWER * truth.cruise)


def _beside(agent: Agent, drive: Drive, truth: Truth) -> list[shapely.Geometry]:
    """Where an agent is while the vehicle drives up to, beside and before it."""
    box = box_of(agent)
    first, last = max(int(drive.progress.timestamps_us[0]), int(box.timestamps_us[0])), int(box.timestamps_us[-1])
    times = np.arange(first, min(last, truth.end_us), _PASS_STEP_US, dtype=np.int64)
    if len(times) == 0:
        return []
    poses = box.at(times)
    ego = truth.box_poses(*drive.poses(times))
    along = (poses[:, 0] - ego[:, 0]) * np.cos(ego[:, 3]) + (poses[:, 1] - ego[:, 1]) * np.sin(ego[:, 3])
    reach = 0.5 * (agent.length + truth.vehicle.length)
    beside = (along < reach + _BEFORE) & (along > -reach - _BEHIND)
    return [_outline(agent, poses[index : index + 1]) for index in np.flatnonzero(beside)]


def _outline(agent: Agent, poses: Array) -> shapely.Geometry:
    return footprints(poses, agent.length, agent.width)[0]
