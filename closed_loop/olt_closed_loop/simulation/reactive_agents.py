"""Recorded vehicles that brake for the ego: the Intelligent Driver Model along their own recorded ways.

A vehicle plays its recording by a clock of its own. While nothing is in its way the clock runs with the time, so the
vehicle is where the recording has it; with something ahead it slows down, its clock falls behind, and it follows the
same way later. It never overtakes its recording, so it still waits where the recorded driver waited.

Only the ego, and vehicles that lag their recordings already, can be in the way: everyone else is where the recording
has them, and the recording shows that the way past them is free. Braking is the interaction term of the model (Treiber,
Hennecke, Helbing, Phys. Rev. E 62, 2000); in place of its free-road term the recorded speed is the limit:

    v' = max(a, recorded v') - a (s* / s)^2,    s* = s0 + v T + v (v - v_leader) / (2 sqrt(a b)),    v <= recorded v
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from olt_closed_loop.scenes.polylines import arc_lengths
from olt_closed_loop.scenes.scene import Agent
from olt_generator.poses import Array
from olt_toolkit.policy.contract import STEP_SECONDS, STEP_US

ACCELERATION = 1.5
"""a, m/s^2."""
COMFORTABLE_BRAKING = 2.0
"""b, m/s^2."""
HARDEST_BRAKING = 8.0
MINIMUM_GAP = 2.0
"""s0, metres."""
HEADWAY = 1.5
"""T, seconds."""
REACTING_LABELS = ("automobile", "heavy_truck", "bus", "trailer", "other_vehicle", "rider")

_LOOK_AHEAD, _SPACING = 60.0, 1.0
_SHORTEST_WAY = 2.0
"""A vehicle that moves less than this many metres stands."""
_STANDING = 1e-3
"""Recorded speeds below this, m/s, are waiting: the clock runs on."""
_ROUNDING = 1e-9


class ReactiveAgents:
    """The agents of one rollout from the hand-over on."""

    def __init__(self, agents: Sequence[Agent], handover_us: int) -> None:
        moving = [agent for agent in agents if agent.label in REACTING_LABELS and len(agent.timestamps_us) > 1]
        drivers = [_Driver(agent, handover_us) for agent in moving if agent.timestamps_us[-1] > handover_us]
        self._drivers = [driver for driver in drivers if driver.arc[-1] >= _SHORTEST_WAY]

    def step(self, time_us: int, ego_pose: Array, ego_size: tuple[float, float], ego_speed: float) -> None:
        """Move all agents from `time_us` on by 0.1 s, seeing the ego as it is then.

        Its pose (3,) is x, y (m) of its box centre and yaw; its size length and width (m), its speed m/s along its yaw.
        """
        ego = _Obstacle(ego_pose, ego_size, ego_speed)
        present = [driver for driver in self._drivers if driver.is_present(time_us)]
        lagging = [(driver, driver.obstacle()) for driver in present if driver.lags]
        for driver in present:
            driver.step(time_us, [ego, *(obstacle for other, obstacle in lagging if other is not driver)])

    def reacted(self) -> tuple[Agent, ...]:
        """The agents that came to differ from the recording, as they moved so far."""
        return tuple(driver.moved_agent() for driver in self._drivers if driver.lags)


class _Obstacle(NamedTuple):
    """A box in the plane: pose (3,) x, y, yaw, its length and width, and its speed along its yaw."""

    pose: Array
    size: tuple[float, float]
    speed: float


class _Driver:
    """One vehicle: its clock in microseconds from its first sample, its speed, and the way that was recorded.

    The way has poses (n, 4) with unwrapped yaw, and arc length (n,) in metres, over times (n,) on the clock.
    """

    def __init__(self, agent: Agent, handover_us: int) -> None:
        self._agent, self._start_us = agent, int(agent.timestamps_us[0])
        self._times = (agent.timestamps_us - agent.timestamps_us[0]).astype(np.float64)
        self._poses = np.column_stack([agent.poses[:, :3], np.unwrap(agent.poses[:, 3])])
        self.arc = arc_lengths(self._poses)
        self._clock = float(max(handover_us - self._start_us, 0))
        self._speed = self._recorded_speed(self._clock)
        self._moved: list[tuple[int, Array]] = []

    @property
    def lags(self) -> bool:
        """Whether it has ever been held up."""
        return bool(self._moved)

    def is_present(self, time_us: int) -> bool:
        """Whether it has appeared and not come to its recording's end."""
        return time_us >= self._start_us and self._clock < self._times[-1]

    def obstacle(self) -> _Obstacle:
        """Itself as others see it."""
        return _Obstacle(self._pose()[[0, 1, 3]], (self._agent.length, self._agent.width), self._speed)

    def step(self, time_us: int, obstacles: Sequence[_Obstacle]) -> None:
        """Move on by 0.1 s."""
        if not self.lags:
            self._clock = float(time_us - self._start_us)
            self._speed = self._recorded_speed(max(self._clock - STEP_US, 0.0))
        recorded = self._recorded_speed(self._clock)
        before = self._recorded_speed(max(self._clock - STEP_US, 0.0))
        gain = max(ACCELERATION, (recorded - before) / STEP_SECONDS)
        change = max(gain - self._hindrance(obstacles), -HARDEST_BRAKING)
        self._speed = max(min(recorded, self._speed + change * STEP_SECONDS), 0.0)
        rate = self._speed / recorded if recorded > _STANDING else 1.0
        if rate < 1.0 - _ROUNDING and not self.lags:
            self._moved.append((time_us, self._pose()))
        self._clock = min(self._clock + rate * STEP_US, float(self._times[-1]))
        if self.lags:
            self._moved.append((time_us + STEP_US, self._pose()))

    def moved_agent(self) -> Agent:
        """The recording until it was first held up, and its own motion from then on."""
        agent, times = self._agent, np.array([time_us for time_us, _ in self._moved], dtype=np.int64)
        kept = agent.timestamps_us < times[0]
        poses = np.concatenate([agent.poses[kept], np.stack([pose for _, pose in self._moved])])
        return replace(agent, timestamps_us=np.concatenate([agent.timestamps_us[kept], times]), poses=poses)

    def _pose(self) -> Array:
        return np.array([np.interp(self._clock, self._times, column) for column in self._poses.T])

    def _arc_at(self, clock: float) -> float:
        return float(np.interp(clock, self._times, self.arc))

    def _recorded_speed(self, clock: float) -> float:
        """Mean recorded speed over the 0.1 s from the clock on, m/s; 0 at the recording's end."""
        return (self._arc_at(clock + STEP_US) - self._arc_at(clock)) / STEP_SECONDS

    def _hindrance(self, obstacles: Sequence[_Obstacle]) -> float:
        """Deceleration that the nearest obstacle on the way asks for, a (s* / s)^2, m/s^2; 0 without one."""
        arc = self._arc_at(self._clock)
        ahead = np.arange(arc, min(arc + _LOOK_AHEAD, float(self.arc[-1])), _SPACING)
        way = np.stack([np.interp(ahead, self.arc, self._poses[:, column]) for column in (0, 1, 3)], axis=-1)
        leaders = [_leader(way, self._agent, obstacle) for obstacle in obstacles]
        gaps = [leader for leader in leaders if leader is not None]
        if not gaps:
            return 0.0
        gap, speed = min(gaps)
        closing = self._speed * (self._speed - speed) / (2.0 * np.sqrt(ACCELERATION * COMFORTABLE_BRAKING))
        desired = max(MINIMUM_GAP + self._speed * HEADWAY + closing, 0.0)
        return ACCELERATION * (desired / max(gap, 1e-3)) ** 2


def _leader(way: Array, agent: Agent, obstacle: _Obstacle) -> tuple[float, float] | None:
    """Gap in metres to an obstacle on the way (n, 3) ahead and its speed along the way; None if it is not on it."""
    offset = obstacle.pose[:2] - way[:, :2]
    cos, sin = np.cos(way[:, 2]), np.sin(way[:, 2])
    along, across = cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]
    turn, (length, width) = obstacle.pose[2] - way[:, 2], obstacle.size
    turned_cos, turned_sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    half_length = 0.5 * (length * turned_cos + width * turned_sin)
    half_width = 0.5 * (length * turned_sin + width * turned_cos)
    touched = (np.abs(across) < half_width + 0.5 * agent.width) & (np.abs(along) < half_length + 0.5 * _SPACING)
    if not touched.any():
        return None
    index = int(np.argmax(touched))
    if index == 0 and along[0] <= 0.0:
        return None
    gap = index * _SPACING + along[index] - half_length[index] - 0.5 * agent.length
    heading = np.array([np.cos(obstacle.pose[2]), np.sin(obstacle.pose[2])])
    return float(gap), float(obstacle.speed * heading @ [cos[index], sin[index]])
