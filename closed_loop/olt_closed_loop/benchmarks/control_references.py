"""The 120 drives on which AlpaSim times its controllers (docs/formats/alpasim.md), 70 of them different.

Where the description leaves a choice open, it is made so that the stated counts, 120 and 70, come out: left and right
turns of radius 50 and 100 m at both speeds for moving off and for stopping, and a generator of ours for the spread of
the straight speeds.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from olt_closed_loop.control.plans import WorldPlan
from olt_generator.poses import Array
from olt_generator.seeds import make_generator
from olt_toolkit.policy.contract import STEP_SECONDS, STEP_US

REFERENCE_SECONDS = 15.0
PLAN_POINTS = 51
LATERAL_ACCELERATION = 3.0
"""Circles are driven at this many m/s^2, or at TOP_CIRCLE_SPEED m/s where that is slower."""
TOP_CIRCLE_SPEED = 15.0

_TIME: Array = STEP_SECONDS * np.arange(round(REFERENCE_SECONDS / STEP_SECONDS) + 1, dtype=np.float64)
_RAMPS = ((5, 15), (10, 20), (5, 25), (15, 25), (8, 18), (20, 10), (25, 15), (15, 5), (20, 5), (18, 8))
_TURNING_RAMPS = ((50, 10, 15), (-50, 10, 15), (100, 15, 10), (-100, 15, 10), (75, 8, 12))


@dataclass(frozen=True)
class Reference:
    """What is to be driven.

    Attributes:
        copies: how often it counts among the 120.
        poses: (151, 3) x, y (m) and yaw (rad) of the rig every 0.1 s.
        speed: at the start, m/s.
    """

    copies: int
    poses: Array
    speed: float

    def plan(self, index: int) -> WorldPlan:
        """What the vehicle is shown in step `index`: 5 s of the reference from there on."""
        times = STEP_US * (index + np.arange(PLAN_POINTS, dtype=np.int64))
        return WorldPlan(times, self.poses[index : index + PLAN_POINTS])


def alpasim_references() -> Iterator[Reference]:
    """Straights and circles at even speed; straights and turns of changing speed; turns from rest and to rest."""
    spread = make_generator(42, "control", "straight").uniform(-1.0, 1.0, size=(6, 4))
    for speed in (np.array([[1.0], [5.0], [10.0], [15.0], [20.0], [25.0]]) + spread).ravel():
        x = speed * _TIME
        yield Reference(1, np.stack([x, 0.0 * x, 0.0 * x], axis=-1), float(speed))
    for side, radius in product((1.0, -1.0), (20.0, 50.0, 100.0, 200.0, 500.0)):
        speed = min(TOP_CIRCLE_SPEED, float(np.sqrt(LATERAL_ACCELERATION * radius)))
        angle = speed * _TIME / radius
        poses = np.stack([radius * np.sin(angle), side * radius * (1.0 - np.cos(angle)), side * angle], axis=-1)
        yield Reference(4, poses, speed)
    for first, last in _RAMPS:
        yield _ramp(3, (0.0, 7.5), (first, last))
    for (radius, first, last), (wider, slower, faster) in product(_TURNING_RAMPS, ((1, 1, 1), (1.2, 0.9, 1.1))):
        yield _ramp(1, (0.0, 7.5), (slower * first, faster * last), wider * radius)
    turns = list(product((10.0, 15.0), (50.0, -50.0, 100.0, -100.0)))
    for speed, radius in turns:
        yield _ramp(1, (7.5, 15.0), (0, speed), radius)
    for speed, radius in turns:
        yield _ramp(1, (3.75, 11.25), (speed, 0), radius)


def _ramp(copies: int, seconds: tuple[float, float], speeds: tuple[float, float], radius: float = np.inf) -> Reference:
    """A drive whose speed changes evenly between two times: Euler steps of 0.1 s, the yaw before the position."""
    speed = np.interp(_TIME[:-1], seconds, speeds)
    yaw = np.concatenate([[0.0], np.cumsum(STEP_SECONDS * speed / radius)])
    x = np.concatenate([[0.0], np.cumsum(STEP_SECONDS * speed * np.cos(yaw[1:]))])
    y = np.concatenate([[0.0], np.cumsum(STEP_SECONDS * speed * np.sin(yaw[1:]))])
    return Reference(copies, np.stack([x, y, yaw], axis=-1), float(speed[0]))
