"""Motions of boxes by their speed, turns and lane changes over time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from olt_closed_loop.scenes.scene import Agent
from olt_generator.poses import Array

STEP_US = 100_000
DURATION = 10.0
_FINE_US = 10_000
SIZES: dict[str, tuple[float, float, float]] = {
    "automobile": (4.8, 1.9, 1.6),
    "heavy_truck": (9.0, 2.5, 3.2),
    "person": (0.5, 0.6, 1.75),
    "rider": (1.8, 0.6, 1.75),
    "animal": (1.6, 0.5, 1.4),
    "other_vehicle": (2.0, 0.3, 1.4),
}
"""Length, width and height in metres."""

Steps = Sequence[tuple[float, float]]
Ramps = Sequence[tuple[float, float, float]]


def sample_times(step_us: int) -> NDArray[np.int64]:
    """Times (n,) of a situation every `step_us`, which divides its 10 s."""
    return step_us * np.arange(round(DURATION * 1e6) // step_us + 1, dtype=np.int64)


@dataclass(frozen=True)
class Motion:
    """A box that starts somewhere and drives.

    Attributes:
        start: x, y of its centre at time 0, metres.
        heading: where it looks then, radians.
        speed: (time, speed) in s and m/s, straight in between; negative is backwards.
        shifts: (from, until, metres to the left), smooth changes of its offset from its course.
        turns: (from, until, radians to the left), even changes of its course.
        seen: from when until when it was recorded, s.
        noise: standard deviation of its recorded position, metres.
    """

    start: tuple[float, float]
    heading: float = 0.0
    speed: Steps = ((0.0, 10.0),)
    shifts: Ramps = ()
    turns: Ramps = ()
    seen: tuple[float, float] = (0.0, DURATION)
    noise: float = 0.0

    def poses(self, step_us: int = STEP_US) -> Array:
        """Poses (n, 3) x, y, yaw of the centre every `step_us`, a multiple of 10 ms, over all of the time."""
        fine = sample_times(_FINE_US) * 1e-6
        speed = np.interp(fine, *np.array(self.speed).T)
        course = self.heading + sum((turn * np.clip((fine - t0) / (t1 - t0), 0.0, 1.0) for t0, t1, turn in self.turns))
        course = np.broadcast_to(course, fine.shape)
        offset = np.zeros_like(fine)
        for t0, t1, metres in self.shifts:
            share = np.clip((fine - t0) / (t1 - t0), 0.0, 1.0)
            offset += metres * share**2 * (3.0 - 2.0 * share)
        x, y = (
            at + cumulative_trapezoid(speed * part, fine, initial=0.0)
            for at, part in zip(self.start, (np.cos(course), np.sin(course)), strict=True)
        )
        aside = np.arctan2(np.gradient(offset, fine), np.maximum(np.abs(speed), 1.0)) * np.sign(speed)
        poses = np.stack([x - np.sin(course) * offset, y + np.cos(course) * offset, course + aside], axis=-1)[
            :: step_us // _FINE_US
        ]
        if self.noise:
            poses[:, :2] += np.random.default_rng(7).normal(0.0, self.noise, (len(poses), 2))
        return poses

    def agent(self, name: str, label: str, step_us: int = STEP_US) -> Agent:
        """The motion as an agent of a class, sampled every `step_us`."""
        times = sample_times(step_us)
        there = (times >= round(self.seen[0] * 1e6)) & (times <= round(self.seen[1] * 1e6))
        size, poses = SIZES[label], self.poses(step_us)[there]
        height = np.full(len(poses), 0.5 * size[2])
        return Agent(name, label, *size, times[there], np.column_stack([poses[:, :2], height, poses[:, 2]]))
