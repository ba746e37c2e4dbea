"""Drives that come off their way: the vehicle is pushed aside, turned, and made too fast or too slow, and drives on.

A policy that has only seen drives on the path does not know what to do beside it (Ross et al., AISTATS 2011). A push
lasts PUSH_US and is smooth; after it whoever sees everything plans anew from where the vehicle is, and drives on until
the next push. In a push the way may be misjudged as well: who is blind goes on as if nobody were there and no line were
held, who hesitates brakes or stays where the way is free. Without the first nobody is ever near and fast at once, as
they are for a policy that has not seen them; without the second who stands is always right to stand. What is driven
from one push to the next is a leg. Its future is that of the plan, also beyond the next push, which is no part of it.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.privileged.plan import Drive, plan_drive
from olt_closed_loop.privileged.speeds import Progress
from olt_closed_loop.privileged.truth import Truth, box_of
from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scoring.moving_boxes import separations
from olt_generator.poses import Array
from olt_toolkit.policy.contract import STEP_SECONDS, STEP_US

PUSH_US = 1_600_000
SHORTEST_US = 4_000_000
"""The least time on average from one push to the next."""
ROOM = 0.25
"""Metres that a pushed vehicle keeps from everybody."""
LATERAL = 4.5
"""Largest lateral acceleration of a push and of the way back, m/s2."""
HESITATES = 2.5
"""Deceleration of who hesitates, m/s2."""
_LEAST_WAY = 4.0
_STEEPEST = 0.08
_FASTER = 0.35


@dataclass(frozen=True)
class Disturbance:
    """How much vehicles are disturbed.

    Attributes:
        every_us: time from one push to the next, on average, at least SHORTEST_US.
        offset: largest push to either side, metres.
        angle: largest turn to either side, radians.
        speed: largest change of speed up or down, m/s.
        blind, hesitant: shares of the pushes that misjudge the way so.
    """

    every_us: int = SHORTEST_US
    offset: float = 1.0
    angle: float = 0.1
    speed: float = 2.0
    blind: float = 0.0
    hesitant: float = 0.0

    def pushes(self, generator: np.random.Generator, until_us: int) -> tuple["Push", ...]:
        """The pushes that are over by a time, each begun within the second half of its turn, on the 0.1 s grid."""
        found = list[Push]()
        begin_us = 0
        for turn in range(1, until_us // self.every_us + 2):
            begin_us = round(self.every_us * (turn - 0.5 * float(generator.random())) / STEP_US) * STEP_US
            offset, angle, speed = (
                generator.uniform(-1.0, 1.0, size=3) * (self.offset, self.angle, self.speed)
            ).tolist()
            misjudged = self._misjudged(generator)
            if begin_us + PUSH_US <= until_us:
                found.append(Push(begin_us, offset, angle, speed, misjudged))
        return tuple(found)

    def _misjudged(self, generator: np.random.Generator) -> "Misjudged":
        if self.blind + self.hesitant == 0.0:
            return None
        drawn = generator.random()
        return "blind" if drawn < self.blind else "hesitant" if drawn < self.blind + self.hesitant else None


Misjudged = Literal["blind", "hesitant"] | None


@dataclass(frozen=True)
class Push:
    """One push: when it begins, how much it has moved (metres to the left), turned (rad) and sped up (m/s), and how
    the way is misjudged meanwhile."""

    begin_us: int
    offset: float
    angle: float
    speed: float
    misjudged: Misjudged = None

    @property
    def end_us(self) -> int:
        """When it is over."""
        return self.begin_us + PUSH_US

    def times(self, step_us: int) -> NDArray[np.int64]:
        """Times (n,) from its begin to its end, both included."""
        return np.arange(self.begin_us, self.end_us + 1, step_us, dtype=np.int64)

    def scaled(self, factor: float) -> "Push":
        """The same push, weaker, or to the other side where the factor is negative."""
        return replace(self, offset=factor * self.offset, angle=factor * self.angle, speed=factor * self.speed)

    def move(self, drive: Drive, timestamps_us: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """x, y, yaw (n,) of a vehicle that is pushed off a planned drive, at times from its begin to its end.

        Its speed changes as a smooth step, and its offset as the polynomial of fifth degree of the way that ends at
        the offset and the angle without bending. Who hardly moves is not pushed.
        """
        seconds = 1e-6 * PUSH_US
        share = (timestamps_us - self.begin_us) / PUSH_US
        known, planned = drive.progress.timestamps_us, drive.progress.arc
        arc = np.interp(timestamps_us, known, planned)
        first, last = np.interp([self.begin_us, self.end_us], known, planned).tolist()
        slowest = (last - first) / seconds
        faster = float(np.clip(self.speed, -_FASTER * slowest, _FASTER * slowest))
        arc = arc + faster * seconds * (share**3 - 0.5 * share**4)
        way = last - first + 0.5 * faster * seconds
        x, y, yaw = drive.path.poses(arc)
        if way < _LEAST_WAY:
            return x, y, yaw
        aside = float(np.clip(self.offset, -_STEEPEST * way, _STEEPEST * way))
        along = (arc - first) / way
        slope = np.tan(self.angle) * way
        steps = (10.0 * aside - 4.0 * slope, -15.0 * aside + 7.0 * slope, 6.0 * aside - 3.0 * slope)
        offset = sum(step * along**power for power, step in enumerate(steps, start=3))
        turned = sum(power * step * along ** (power - 1) for power, step in enumerate(steps, start=3)) / way
        return x - offset * np.sin(yaw), y + offset * np.cos(yaw), yaw + np.arctan(turned)


def misjudged_drive(truth: Truth, push: Push, drive: Drive) -> Drive:
    """How a planned drive goes on from the begin of a push where the way is misjudged."""
    times = push.times(STEP_US)
    known, planned = drive.progress.timestamps_us, drive.progress.arc
    arc = np.interp([push.begin_us - STEP_US, push.begin_us], known, planned)
    speed = float(arc[1] - arc[0]) / STEP_SECONDS
    if push.misjudged == "blind":
        x, y, yaw = (float(each[0]) for each in drive.path.poses(arc[1:]))
        return plan_drive(replace(truth, agents=(), holds=()), push.begin_us, x, y, speed, yaw)
    seconds = np.minimum(1e-6 * (times - push.begin_us), speed / HESITATES)
    braked = arc[1] + speed * seconds - 0.5 * HESITATES * seconds**2
    return Drive(drive.path, Progress(times, np.minimum(braked, np.interp(times, known, planned)), False))


def is_free(truth: Truth, timestamps_us: NDArray[np.int64], poses: tuple[Array, Array, Array]) -> bool:
    """Whether a vehicle at poses x, y, yaw (n,) at times (n,) stays on the road and ROOM metres from everybody."""
    ego = truth.box_poses(*poses)
    if truth.drivable is not None:
        boxes = np.asarray(shapely.polygons(corners(ego, truth.half_size)))
        if not np.asarray(shapely.covers(truth.drivable, boxes)).all():
            return False
    ego[:, 2] = 0.0
    half = truth.half_size + np.array([ROOM, ROOM, 0.0])
    for agent in truth.agents:
        box = box_of(agent)
        there = np.flatnonzero(box.covers(timestamps_us))
        if len(there) == 0:
            continue
        gaps, _ = separations(ego[there], half, box.at(timestamps_us[there]), box.half_size)
        if (gaps[:, :4].max(axis=1) < 0.0).any():
            return False
    return True


def is_gentle(timestamps_us: NDArray[np.int64], poses: tuple[Array, Array, Array]) -> bool:
    """Whether the lateral acceleration along poses x, y, yaw (n,) at times (n,) keeps below LATERAL."""
    x, y, yaw = poses
    seconds = 1e-6 * np.diff(timestamps_us)
    speed = np.hypot(np.diff(x), np.diff(y)) / seconds
    return bool((speed * np.abs(np.diff(np.unwrap(yaw))) / seconds).max() <= LATERAL)
