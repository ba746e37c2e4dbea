"""Dense traffic around a drive: a vehicle close ahead, lanes beside the ego, and oncoming lanes."""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

from olt_closed_loop.scenes.actors import SIZES, moving, sample_times, standing_row
from olt_closed_loop.scenes.driving import EgoMotion
from olt_closed_loop.scenes.events import EGO_FRONT
from olt_closed_loop.scenes.roads import Road
from olt_closed_loop.scenes.scene import Agent
from olt_generator.poses import Array

# How far behind and ahead of the ego lanes are filled, metres; what is farther is not seen in traffic.
_BEHIND, _AHEAD = 60.0, 130.0
_OWN_LANE_GAP = 2.5


@dataclass(frozen=True)
class Lead:
    """A vehicle in front of the ego.

    Attributes:
        gap: metres between them at the start.
        label: class of the vehicle.
        swing: how many metres the gap grows and shrinks again, as a wave of `period` seconds.
        period: seconds.
        pulls_away: acceleration against the ego, m/s2, from one second on.
    """

    gap: float
    label: str = "automobile"
    swing: float = 0.0
    period: float = 8.0
    pulls_away: float = 0.0


@dataclass(frozen=True)
class Stream:
    """The vehicles of one lane, which all drive at the same speed.

    Attributes:
        offset: of the lane's centre from the road's reference line, metres; positive ones come towards the ego.
        speed: m/s along the lane.
        gap: mean metres between two vehicles.
        lorries: share of lorries.
        stops: whether the stream brakes to a stop and pulls away again, every `period` seconds.
        period: seconds.
    """

    offset: float
    speed: float
    gap: float
    lorries: float = 0.2
    stops: bool = False
    period: float = 6.0


def place_lead(road: Road, ego: EgoMotion, lead: Lead, offset: float) -> list[Agent]:
    """The vehicle ahead in the lane at `offset`; it never comes closer than 2.5 m."""
    times = sample_times(ego.duration_us)
    gaps = lead.gap + lead.swing * (1.0 - np.cos(2.0 * np.pi * times / lead.period)) / 2.0
    gaps += 0.5 * lead.pulls_away * np.maximum(times - 1.0, 0.0) ** 2
    stations = ego.station_at(times) + EGO_FRONT + np.maximum(gaps, _OWN_LANE_GAP) + SIZES[lead.label][0] / 2
    return moving("lead", lead.label, road, times, stations, np.full_like(times, offset))


def place_stream(name: str, road: Road, ego: EgoMotion, stream: Stream, generator: np.random.Generator) -> list[Agent]:
    """The vehicles of one lane, as far as they come near the ego."""
    times = sample_times(ego.duration_us)
    oncoming = stream.offset > 0.0
    travelled = cumulative_trapezoid(_stream_speeds(stream, times, generator), times, initial=0.0)
    moved = -travelled if oncoming else travelled
    ego_stations = ego.station_at(times)
    # Where vehicles may be at the start so that they are near the ego at some time.
    first = min(float((ego_stations - moved).min()), ego_stations[0]) - _BEHIND
    last = max(float((ego_stations - moved).max()), ego_stations[0]) + _AHEAD
    agents, place = [], first + generator.uniform(0.0, stream.gap)
    while place < last:
        label = "heavy_truck" if generator.random() < stream.lorries else "automobile"
        length = SIZES[label][0]
        offsets = np.full_like(times, stream.offset + generator.uniform(-0.25, 0.25))
        turn = np.pi if oncoming else 0.0
        stations = place + length / 2 + moved
        agents += moving(f"{name}_{len(agents)}", label, road, times, stations, offsets, turn)
        place += length + max(_OWN_LANE_GAP, stream.gap * generator.uniform(0.5, 1.5))
    return agents


def place_parked(road: Road, ego: EgoMotion, generator: np.random.Generator) -> list[Agent]:
    """Cars parked on both shoulders."""
    stations = np.arange(ego.stations.min(), ego.stations.max() + _AHEAD, 7.5)
    agents: list[Agent] = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        bays = stations[generator.random(len(stations)) < 0.5]
        bays = bays[(bays > 5.0) & (bays < road.length - 5.0)]
        offset = sign * (road.half_width - SIZES["automobile"][1] / 2 - 0.1)
        agents += standing_row(f"parked_{side}", "automobile", road, bays, offset, ego.duration_us)
    return agents


def _stream_speeds(stream: Stream, times: Array, generator: np.random.Generator) -> Array:
    phase = generator.uniform(0.0, 2.0 * np.pi)
    if not stream.stops:
        return np.full_like(times, stream.speed)
    # A wave whose lower part is cut off: standing, pulling away, rolling, braking.
    return stream.speed * np.maximum(np.sin(2.0 * np.pi * times / stream.period + phase) + 0.4, 0.0) / 1.4
