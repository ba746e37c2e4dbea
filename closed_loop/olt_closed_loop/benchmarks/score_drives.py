"""Drives whose motion is known at every instant, to be sampled at any rate and scored."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout_record import PLAN_STEP_US, EgoBox, LaneLines, PlanRecord, RolloutRecord
from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scenes.scene import Agent
from olt_generator.poses import Array
from olt_generator.seeds import make_generator
from olt_toolkit.policy.contract import FUTURE_STEPS

DURATION_US = 8_000_000
HANDOVER_US = 1_700_000
EGO = EgoBox(5.393, 2.109, 1.503, 1.3965)
KINDS = ("parked", "crossing", "tailing", "oncoming")
FINE_US = 1000
CROWDED_US = 20_000_000


@dataclass(frozen=True)
class Weaving:
    """A box that weaves about a straight line: position along `heading` from `start`, and a sine across it."""

    start: tuple[float, float]
    heading: float
    speed: float
    amplitude: float
    period: float
    size: tuple[float, float, float]

    def poses(self, times_us: NDArray[np.int64]) -> Array:
        """Poses (n, 4) x, y, z, yaw of the box centre, headed along its velocity."""
        seconds, rate = times_us * 1e-6, 2.0 * np.pi / self.period
        along, across = self.speed * seconds, self.amplitude * np.sin(rate * seconds)
        drift = self.amplitude * rate * np.cos(rate * seconds)
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        x, y = self.start[0] + cos * along - sin * across, self.start[1] + sin * along + cos * across
        yaw = self.heading + np.arctan2(drift, max(self.speed, 1e-3))
        return np.stack([x, y, np.full(len(x), 0.5 * self.size[2]), yaw], axis=-1)


@dataclass(frozen=True)
class KnownDrive:
    """An ego among agents, all of whose motion is known at every instant; the recording is the drive itself."""

    name: str
    ego: Weaving
    agents: tuple[Weaving, ...]
    end_us: int = DURATION_US

    def sampled(self, step_us: int, with_plans: bool = False) -> RolloutRecord:
        """The drive with a sample every `step_us` and, if asked for, a plan at each after the hand-over."""
        times = np.arange(0, self.end_us + 1, step_us, dtype=np.int64)
        rig = self._rig(times)
        agents = tuple(
            Agent(str(index), "automobile", *agent.size, times, agent.poses(times))
            for index, agent in enumerate(self.agents)
        )
        plans = []
        for now_us in times[times >= HANDOVER_US][:-1].tolist() if with_plans else ():
            planned_us = now_us + PLAN_STEP_US * np.arange(FUTURE_STEPS + 1, dtype=np.int64)
            poses = self._rig(planned_us)[:, [0, 1, 3]]
            plans.append(PlanRecord(now_us, now_us + PLAN_STEP_US, planned_us, poses, (poses,)))
        # A lane of 5 m about the x axis, 100 m beyond both ends of the drive, and edges 10 m from it.
        x = np.arange(-100.0, 300.0, 2.0)
        line = {y: np.stack([x, np.full_like(x, y), np.zeros_like(x)], axis=-1) for y in (0.0, 2.5, -2.5, -10.0, 10.0)}
        lanes, edges = (LaneLines(line[0.0], line[2.5], line[-2.5]),), (line[-10.0], line[10.0])
        return RolloutRecord(
            self.name, HANDOVER_US, times, rig, EGO, agents, times, rig, lanes, edges, plans=tuple(plans)
        )

    def contact_us(self) -> float:
        """When outlines first touch after the hand-over, by bisection of the exact motion; infinite if never."""
        times = np.arange(HANDOVER_US, self.end_us + 1, FINE_US)
        touching = np.flatnonzero(self._distances(times) == 0.0)
        if len(touching) == 0:
            return np.inf
        first = int(touching[0])
        between = np.arange(int(times[max(first - 1, 0)]), int(times[first]) + 1)
        return float(between[np.argmax(self._distances(between) == 0.0)])

    def nearest_m(self) -> float:
        """Smallest distance in metres to an agent after the hand-over, of the exact outlines every millisecond."""
        return float(self._distances(np.arange(HANDOVER_US, self.end_us + 1, FINE_US)).min())

    def _distances(self, times_us: NDArray[np.int64]) -> Array:
        """Distances (n,) in metres to the nearest agent, 0 in a contact."""
        ego, *others = (
            np.asarray(shapely.polygons(corners(body.poses(times_us), 0.5 * np.array(body.size))))
            for body in (self.ego, *self.agents)
        )
        return np.min([shapely.distance(ego, other) for other in others], axis=0)

    def _rig(self, times_us: NDArray[np.int64]) -> Array:
        """Poses (n, 4) of the rig, whose box weaves."""
        rig = self.ego.poses(times_us)
        rig[:, :2] -= EGO.rear_axle_to_center * np.stack([np.cos(rig[:, 3]), np.sin(rig[:, 3])], axis=-1)
        rig[:, 2] = 0.0
        return rig


def known_drives(count: int) -> list[KnownDrive]:
    """Drives of four kinds: a parked car at the side, one that crosses, one from behind, one that comes towards."""
    return [_known_drive(KINDS[index % len(KINDS)], index) for index in range(count)]


def _known_drive(kind: str, index: int) -> KnownDrive:
    generator = make_generator("score benchmark", kind, index)
    size = (float(generator.uniform(0.5, 5.0)), float(generator.uniform(0.5, 2.0)), 1.6)
    speed, meeting, offset = generator.uniform(8.0, 14.0), generator.uniform(3.0, 7.0), generator.uniform(-0.6, 0.6)
    ego = Weaving((0.0, 0.0), 0.0, speed, 0.3, 5.0, (EGO.length, EGO.width, EGO.height))
    beside = 0.5 * (EGO.width + size[1]) + 0.5 * offset
    place = speed * meeting
    if kind == "parked":
        agent = Weaving((place, -beside), 0.0, 0.0, 0.0, 5.0, size)
    elif kind == "crossing":
        across, angle = generator.uniform(10.0, 30.0), generator.uniform(-2.2, -0.9)
        start = np.array([place + 8.0 * offset, 0.0]) - across * meeting * np.array([np.cos(angle), np.sin(angle)])
        agent = Weaving((float(start[0]), float(start[1])), angle, across, 0.2, 3.0, size)
    elif kind == "tailing":
        faster = speed + generator.uniform(2.0, 8.0)
        agent = Weaving((place - faster * meeting, 4.0 * offset), 0.0, faster, 0.1, 4.0, size)
    else:
        towards = generator.uniform(8.0, 14.0)
        agent = Weaving((place + towards * meeting, beside + offset), np.pi, towards, 0.3, 4.0, size)
    return KnownDrive(f"{kind} {index}", ego, (agent,))


def in_town(record: RolloutRecord) -> RolloutRecord:
    """The record on the map of a town: streets of four lanes across its road every 40 m, and eight along it."""
    lanes, edges = list(record.lanes), list(record.road_edges)
    for x in np.arange(-90.0, 300.0, 40.0):
        for end in (-1.0, 1.0):
            way = end * np.arange(11.0, 200.0, 2.0)
            _add_street(lanes, edges, lambda offset, x=x, way=way: (np.full_like(way, x + offset), way))
    along = np.arange(-100.0, 300.0, 2.0)
    for y in (-200.0, -160.0, -120.0, -80.0, 80.0, 120.0, 160.0, 200.0):
        _add_street(lanes, edges, lambda offset, y=y: (along, np.full_like(along, y + offset)))
    return replace(record, lanes=tuple(lanes), road_edges=tuple(edges))


def _add_street(lanes: list[LaneLines], edges: list[Array], line_at: Callable[[float], tuple[Array, Array]]) -> None:
    def line(offset: float) -> Array:
        x, y = line_at(offset)
        return np.stack([x, y, np.zeros_like(x)], axis=-1)

    lanes += [
        LaneLines(line(middle), line(middle - 1.75), line(middle + 1.75)) for middle in (-5.25, -1.75, 1.75, 5.25)
    ]
    edges += [line(-7.5), line(7.5)]


def crowded_drive(count: int) -> KnownDrive:
    """A drive of 20 s that meets no one of `count` vehicles on three lanes to each side.

    Those to its right go its way, those to its left come towards it.
    """
    generator = make_generator("score benchmark", "crowded", count)
    ego = Weaving((0.0, 0.0), 0.0, 10.0, 0.3, 5.0, (EGO.length, EGO.width, EGO.height))
    agents = []
    for index in range(count):
        lane, side = 1 + index % 3, -1.0 if index % 2 else 1.0
        size = (float(generator.uniform(4.0, 5.0)), float(generator.uniform(1.7, 2.0)), 1.6)
        start = (float(generator.uniform(-50.0, 350.0)), side * 4.0 * lane)
        speed = float(generator.uniform(0.0, 12.0))
        agents.append(Weaving(start, np.pi if side > 0.0 else 0.0, speed, 0.2, 4.0, size))
    return KnownDrive("crowded", ego, tuple(agents), CROWDED_US)
