"""Drives whose motion is known at every instant, to be sampled at any rate and scored."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout_record import PLAN_STEP_US, EgoBox, LaneLines, PlanRecord, RolloutRecord
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.moving_boxes import corners
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
    """An ego and one agent that meets it or just misses it."""

    name: str
    ego: Weaving
    agent: Weaving

    def sampled(self, step_us: int) -> RolloutRecord:
        """The drive as a record with a sample every `step_us`; the recording is the drive itself."""
        times = np.arange(0, DURATION_US + 1, step_us, dtype=np.int64)
        rig = _rig(self.ego, times)
        agent = Agent("other", "automobile", *self.agent.size, times, self.agent.poses(times))
        lanes, edges = _road()
        return RolloutRecord(self.name, HANDOVER_US, times, rig, EGO, (agent,), times, rig, lanes, edges)

    def contact_us(self) -> float:
        """When the outlines first touch after the hand-over, by bisection of the exact motion; infinite if never."""
        times = np.arange(HANDOVER_US, DURATION_US + 1, FINE_US)
        touching = np.flatnonzero(self._touch(times))
        if len(touching) == 0:
            return np.inf
        first = int(touching[0])
        between = np.arange(int(times[max(first - 1, 0)]), int(times[first]) + 1)
        return float(between[np.argmax(self._touch(between))])

    def _touch(self, times_us: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.asarray(shapely.intersects(*(_outlines(body, times_us) for body in (self.ego, self.agent))))


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
    return KnownDrive(f"{kind} {index}", ego, agent)


def _rig(ego: Weaving, times_us: NDArray[np.int64]) -> Array:
    """Poses (n, 4) of the rig of an ego whose box weaves."""
    rig = ego.poses(times_us)
    rig[:, :2] -= EGO.rear_axle_to_center * np.stack([np.cos(rig[:, 3]), np.sin(rig[:, 3])], axis=-1)
    rig[:, 2] = 0.0
    return rig


def _outlines(body: Weaving, times_us: NDArray[np.int64]) -> NDArray[np.object_]:
    return np.asarray(shapely.polygons(corners(body.poses(times_us), 0.5 * np.array(body.size))))


def _road(end: float = 200.0) -> tuple[tuple[LaneLines, ...], tuple[Array, ...]]:
    """A lane of 5 m about the x axis, 100 m beyond both ends of the drive, and edges 10 m from it."""
    x = np.arange(-100.0, end + 100.0, 2.0)

    def line(y: float) -> Array:
        return np.stack([x, np.full_like(x, y), np.zeros_like(x)], axis=-1)

    return (LaneLines(line(0.0), line(2.5), line(-2.5)),), (line(-10.0), line(10.0))


@dataclass(frozen=True)
class CrowdedDrive:
    """An ego that meets no one on a busy road: vehicles on three lanes to each side, at every instant known."""

    ego: Weaving
    agents: tuple[Weaving, ...]

    def record(self) -> RolloutRecord:
        """The drive with a sample and, after the hand-over, a plan every 0.1 s; the recording is the drive itself."""
        times = np.arange(0, CROWDED_US + 1, PLAN_STEP_US, dtype=np.int64)
        agents = tuple(
            Agent(str(index), "automobile", *agent.size, times, agent.poses(times))
            for index, agent in enumerate(self.agents)
        )
        rig, (lanes, edges) = _rig(self.ego, times), _road(CROWDED_US * 1e-6 * self.ego.speed)
        plans = tuple(self._plan(int(now_us)) for now_us in times[times >= HANDOVER_US][:-1])
        return RolloutRecord("crowded", HANDOVER_US, times, rig, EGO, agents, times, rig, lanes, edges, plans=plans)

    def _plan(self, now_us: int) -> PlanRecord:
        times = now_us + PLAN_STEP_US * np.arange(FUTURE_STEPS + 1, dtype=np.int64)
        poses = _rig(self.ego, times)[:, [0, 1, 3]]
        return PlanRecord(now_us, now_us + PLAN_STEP_US, times, poses, (poses,))

    def nearest_m(self, start_us: int) -> float:
        """Smallest distance in metres to an agent from a time on, of the exact outlines every millisecond."""
        times = np.arange(start_us, CROWDED_US + 1, FINE_US, dtype=np.int64)
        ego, *others = (_outlines(body, times) for body in (self.ego, *self.agents))
        return min(float(shapely.distance(ego, other).min()) for other in others)


def crowded_drive(count: int) -> CrowdedDrive:
    """A drive of 20 s among `count` vehicles."""
    generator = make_generator("score benchmark", "crowded", count)
    ego = Weaving((0.0, 0.0), 0.0, 10.0, 0.3, 5.0, (EGO.length, EGO.width, EGO.height))
    return CrowdedDrive(ego, tuple(_neighbour(index, generator) for index in range(count)))


def _neighbour(index: int, generator: np.random.Generator) -> Weaving:
    """A vehicle that keeps to a lane beside the ego's: ahead the same way to its right, towards it to its left."""
    lane, side = 1 + index % 3, -1.0 if index % 2 else 1.0
    size = (float(generator.uniform(4.0, 5.0)), float(generator.uniform(1.7, 2.0)), 1.6)
    start = (float(generator.uniform(-50.0, 350.0)), side * 4.0 * lane)
    heading = np.pi if side > 0.0 else 0.0
    return Weaving(start, heading, float(generator.uniform(0.0, 12.0)), 0.2, 4.0, size)
