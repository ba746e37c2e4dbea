"""What happens on the road: how the ego means to drive through each event, and the agents that make it.

An event starts at the station `onset`, where the ego begins to react. Agents that move are placed after the drive is
known, so that they meet the ego where the event needs them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from olt_closed_loop.scenes.actors import SIZES, moving, sample_times, standing, standing_row
from olt_closed_loop.scenes.driving import EgoMotion, Knots, Limits, offset_profile
from olt_closed_loop.scenes.roads import LANE_WIDTH, Road
from olt_closed_loop.scenes.scene import Agent
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

HALF_EGO = DEFAULT_VEHICLE.width / 2
EGO_FRONT = DEFAULT_VEHICLE.rear_axle_to_bbox_center + DEFAULT_VEHICLE.length / 2

HANDOVER = 1.7
"""Seconds after which the policy drives, as in AlpaSim (docs/formats/alpasim.md)."""
REACTION, BRAKING = 1.45, 0.774 * 9.81
"""Seconds until a defensive driver has reacted and the brakes are full, and m/s2 (UN Regulation 157, annex 4)."""
_STAYS_ON = 0.2
"""Seconds for which a deer stays in the lane after it would have been hit."""


@dataclass(frozen=True)
class Approach:
    """How the ego comes to the event: station of its onset, offset of the ego's lane, cruising speed."""

    onset: float
    center: float
    cruise: float


@dataclass(frozen=True)
class Event:
    """An event on the road.

    Attributes:
        factors: scene factors that hold.
        offsets: (station, offset) knots of the ego's path from the onset on.
        limits: (from station, to station, speed) stretches where the ego is slower.
        place_agents: the agents, given how the ego drives.
    """

    factors: tuple[str, ...]
    offsets: Knots
    limits: Limits
    place_agents: Callable[[EgoMotion], list[Agent]]


def nominal(road: Road, approach: Approach, generator: np.random.Generator) -> Event:
    """Nothing but other cars: some parked on the shoulder, sometimes one ahead."""
    bays = np.arange(60.0, road.length - 20.0, 8.0)
    parked = generator.choice(bays, size=generator.integers(2, 6), replace=False)
    gap = generator.uniform(22.0, 32.0)
    leads = generator.random() < 0.5

    def place_agents(ego: EgoMotion) -> list[Agent]:
        offset = -road.half_width + SIZES["automobile"][1] / 2 + 0.1
        agents = standing_row("parked", "automobile", road, parked, offset, ego.duration_us)
        if leads:
            times = sample_times(ego.duration_us)
            stations = ego.station_at(times) + gap
            agents += moving("lead", "automobile", road, times, stations, np.full_like(stations, approach.center))
        return agents

    return Event((), (), (), place_agents)


def work_zone(road: Road, approach: Approach, generator: np.random.Generator) -> Event:
    """Cones and barriers close the outer part of the ego's lane; the ego keeps to the other side."""
    closed = -road.lane_edge + generator.uniform(1.2, 2.0)
    passing = closed + 0.2 + generator.uniform(0.5, 0.7) + HALF_EGO
    shifted = approach.onset + generator.uniform(32.0, 38.0)
    start, end = shifted + 10.0, shifted + generator.uniform(35.0, 50.0)
    with_truck = generator.random() < 0.6
    limit = generator.uniform(7.0, 9.0)

    def place_agents(ego: EgoMotion) -> list[Agent]:
        duration, border = ego.duration_us, -road.lane_edge + 0.1
        taper = np.linspace(start - 20.0, start, 6)
        exit_taper = np.linspace(end, end + 8.0, 4)
        agents = standing_row("cone", "cone", road, taper, np.linspace(border, closed, 6), duration)
        agents += standing_row("exit_cone", "cone", road, exit_taper, np.linspace(closed, border, 4), duration)
        agents += standing_row("barrier", "barrier", road, np.arange(start + 2.5, end - 2.0, 3.0), closed, duration)
        shoulder = -road.lane_edge - road.shoulder / 2
        if with_truck:
            agents.append(standing("work_truck", "heavy_truck", road, start + 9.0, shoulder, duration))
        agents.append(standing("worker", "person", road, end - 3.0, shoulder, duration, turn=np.pi / 2))
        return agents

    knots = _sidestep(approach, passing, shifted, end + 3.0)
    return Event(("work_zone", "cone_delineated"), knots, ((shifted - 10.0, end, limit),), place_agents)


def path_reassignment(road: Road, approach: Approach, generator: np.random.Generator) -> Event:
    """Two rows of cones lead out of the ego's lane and along the next one, against the marking."""
    shifted = approach.onset + generator.uniform(36.0, 42.0)
    end = shifted + generator.uniform(20.0, 35.0)
    knots = _sidestep(approach, approach.center + LANE_WIDTH, shifted, end, length=40.0)
    limit = generator.uniform(7.0, 9.0)
    half_channel = generator.uniform(1.85, 2.0)

    def place_agents(ego: EgoMotion) -> list[Agent]:
        path = offset_profile(((0.0, approach.center), *knots, (road.length, approach.center)))
        stations = np.arange(approach.onset + 2.0, end + 36.0, 4.0)
        agents: list[Agent] = []
        for side, sign in (("left", 1.0), ("right", -1.0)):
            row = path(stations) + sign * half_channel
            agents += standing_row(f"cone_{side}", "cone", road, stations, row, ego.duration_us)
        return agents

    factors = ("temporary_path_reassignment", "cone_delineated")
    return Event(factors, knots, ((approach.onset, end + 20.0, limit),), place_agents)


def cyclists(road: Road, approach: Approach, generator: np.random.Generator) -> Event:
    """One or two riders at the edge of the lane; the ego passes with room or stays behind."""
    offset = -road.lane_edge + generator.uniform(0.4, 0.5)
    passing = offset + SIZES["rider"][1] / 2 + generator.uniform(1.0, 1.3) + HALF_EGO
    riders = int(generator.integers(1, 3))
    speed = generator.uniform(4.0, 5.0)
    slow = _Slow("rider", riders, 5.0, offset, speed)
    if generator.random() < 0.3:
        return _follow(road, approach, slow, ("cyclists",), gap=generator.uniform(9.0, 13.0))
    return _overtake(road, approach, slow, ("cyclists",), passing)


def uncommon_vehicle(road: Road, approach: Approach, generator: np.random.Generator) -> Event:
    """A slow tractor that the ego follows or overtakes, or a truck that stands half in the lane."""
    factors = ("uncommon_vehicle",)
    kind = generator.choice(["follow", "overtake", "truck"])
    if kind == "truck":
        return _stopped_truck(road, approach, generator)
    slow = _Slow("other_vehicle", 1, 0.0, -road.lane_edge + 1.4, generator.uniform(3.5, 5.0))
    if kind == "follow":
        return _follow(road, approach, slow, factors, gap=generator.uniform(10.0, 14.0))
    passing = slow.offset + SIZES[slow.label][1] / 2 + generator.uniform(0.8, 1.0) + HALF_EGO
    return _overtake(road, approach, slow, factors, passing)


def animal(road: Road, approach: Approach, generator: np.random.Generator) -> Event:
    """A deer walks into the lane, stands there and walks on; the ego brakes until it has gone.

    It is still there when a car arrives that drives on as at the hand-over, and by then has stood in full view for
    longer than a defensive driver needs to stop.
    """
    crossing = approach.onset + generator.uniform(30.0, 45.0)
    crawl = generator.uniform(2.5, 3.5)
    speed = generator.uniform(3.0, 4.0)
    stands = REACTION + approach.cruise / BRAKING + generator.uniform(0.5, 1.5)
    side = generator.choice([-1.0, 1.0])

    def place_agents(ego: EgoMotion) -> list[Agent]:
        meets = _unbraked_arrival(ego, crossing - EGO_FRONT)
        far = side * (road.half_width + 5.0)
        comes, leaves = abs(approach.center + far) / speed, abs(far - approach.center) / speed
        stays = (meets - stands, meets + _STAYS_ON)
        times = sample_times(ego.duration_us)
        knots = (stays[0] - comes, *stays, stays[1] + leaves)
        offsets = np.interp(times, knots, (-far, approach.center, approach.center, far))
        return moving("deer", "animal", road, times, np.full_like(times, crossing), offsets, turn=side * np.pi / 2)

    slow_down = (crossing - EGO_FRONT - 9.0, crossing - EGO_FRONT - 4.0, crawl)
    return Event(("animal",), (), (slow_down,), place_agents)


def _unbraked_arrival(ego: EgoMotion, station: float) -> float:
    """Seconds at which the rig of a car would be at `station` that keeps the ego's speed at the hand-over."""
    start, later = ego.station_at(np.array([HANDOVER, HANDOVER + 0.1]))
    return HANDOVER + 0.1 * (station - start) / (later - start)


EVENTS: dict[str, Callable[[Road, Approach, np.random.Generator], Event]] = {
    "nominal": nominal,
    "work_zone": work_zone,
    "cyclists": cyclists,
    "uncommon_vehicle": uncommon_vehicle,
    "animal": animal,
    "path_reassignment": path_reassignment,
}


@dataclass(frozen=True)
class _Slow:
    """Slow road users of one label in a row, `spacing` metres apart, at one offset and speed."""

    label: str
    count: int
    spacing: float
    offset: float
    speed: float

    def place(self, road: Road, times: Array, stations: Array) -> list[Agent]:
        """The agents, the rearmost at `stations` (n,)."""
        offsets = np.full_like(times, self.offset)
        return [
            agent
            for i in range(self.count)
            for agent in moving(f"{self.label}_{i}", self.label, road, times, stations + i * self.spacing, offsets)
        ]


def _overtake(road: Road, approach: Approach, slow: _Slow, factors: tuple[str, ...], passing: float) -> Event:
    """Move over, pass the slow ones, and come back when they are well behind."""
    closing = max(approach.cruise - slow.speed, 3.0) / approach.cruise
    shifted = approach.onset + 34.0
    length = SIZES[slow.label][0]
    beside = shifted + (9.0 + length) / closing
    done = beside + (length + 6.0 + slow.spacing * (slow.count - 1)) / closing

    def place_agents(ego: EgoMotion) -> list[Agent]:
        times = sample_times(ego.duration_us)
        return slow.place(road, times, beside + slow.speed * (times - ego.time_at(beside)))

    return Event(factors, _sidestep(approach, passing, shifted, done), (), place_agents)


def _follow(road: Road, approach: Approach, slow: _Slow, factors: tuple[str, ...], gap: float) -> Event:
    """Slow down to the speed of the slow ones and stay behind them."""
    settled = approach.onset + 30.0

    def place_agents(ego: EgoMotion) -> list[Agent]:
        times = sample_times(ego.duration_us)
        rear = settled + EGO_FRONT + gap + SIZES[slow.label][0] / 2
        return slow.place(road, times, rear + slow.speed * (times - ego.time_at(settled)))

    return Event(factors, (), ((settled, road.length, slow.speed),), place_agents)


def _stopped_truck(road: Road, approach: Approach, generator: np.random.Generator) -> Event:
    offset = -road.lane_edge - generator.uniform(0.0, 0.4)
    length, width, _ = SIZES["heavy_truck"]
    passing = offset + width / 2 + generator.uniform(0.7, 1.0) + HALF_EGO
    shifted = approach.onset + 34.0
    station = shifted + EGO_FRONT + 2.0 + length / 2

    def place_agents(ego: EgoMotion) -> list[Agent]:
        return [standing("stopped_truck", "heavy_truck", road, station, offset, ego.duration_us)]

    knots = _sidestep(approach, passing, shifted, station + length / 2 + 3.0)
    return Event(("uncommon_vehicle",), knots, ((shifted, station, generator.uniform(7.0, 9.0)),), place_agents)


def _sidestep(approach: Approach, passing: float, shifted: float, returning: float, length: float = 34.0) -> Knots:
    """Leave the lane centre at the onset, be at offset `passing` from `shifted` to `returning`, and come back."""
    center = approach.center
    return (approach.onset, center), (shifted, passing), (returning, passing), (returning + length, center)
