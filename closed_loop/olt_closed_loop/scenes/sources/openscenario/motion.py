"""How a road user of a scenario moves: along lanes, along a trajectory, or freely."""

import heapq
from dataclasses import dataclass, replace

import numpy as np

from olt_closed_loop.scenes.polylines import arc_lengths, wrap
from olt_closed_loop.scenes.sources.opendrive import LaneKey, RoadNetwork
from olt_closed_loop.scenes.sources.openscenario.entities import Entity
from olt_generator.errors import InputError
from olt_generator.poses import Array

LOOK_AHEAD = 2000.0
"""Metres along which another is looked for on the way ahead."""


@dataclass(frozen=True)
class OnLane:
    """A place in a lane: `offset` metres to the left of its centre, seen along the road; travel is along `way`."""

    road: str
    lane: int
    s: float
    offset: float = 0.0
    way: int = 1


@dataclass(frozen=True)
class Free:
    """A place in the plane, heading in radians."""

    x: float
    y: float
    heading: float

    def shifted(self, ahead: float, left: float) -> "Free":
        """The place so many metres ahead and to the left, of the same heading."""
        cos, sin = float(np.cos(self.heading)), float(np.sin(self.heading))
        return Free(self.x + cos * ahead - sin * left, self.y + sin * ahead + cos * left, self.heading)


@dataclass(frozen=True)
class OnPath:
    """A place `along` a polyline (n, 2)."""

    path: Array
    along: float = 0.0


Place = OnLane | Free | OnPath


class Roads:
    """Where a network's lanes lead, and where on them is what."""

    def __init__(self, network: RoadNetwork) -> None:
        self.network = network

    def on_lane(self, road: str, lane: int, s: float, offset: float = 0.0) -> OnLane:
        """A place in a lane, in the lane's driving direction; `InputError` if the lane or the station is not there."""
        known = self.network.road(road)
        if not -1e-3 <= s <= known.length + 1e-3:
            raise InputError(f"road {road:.40} is {known.length:g} m long, and s is {s:g}")
        s = min(max(s, 0.0), known.length)
        known.lane_offset(lane, s)
        return OnLane(road, lane, s, offset, known.ahead(lane))

    def lateral(self, place: OnLane) -> float:
        """Offset from the reference line, metres."""
        return self.network.road(place.road).lane_offset(place.lane, place.s) + place.offset

    def pose(self, place: Place) -> Free:
        """The place in the plane."""
        if isinstance(place, Free):
            return place
        if isinstance(place, OnPath):
            return _on_path(place)
        road = self.network.road(place.road)
        s = np.array([place.s])
        (x, y), heading = road.locate(s, np.array([self.lateral(place)]))[0], road.line.at(s)[1][0]
        return Free(float(x), float(y), float(heading) + (0.0 if place.way > 0 else np.pi))

    def stretch(self, place: OnLane) -> float:
        """Metres along a lane for a metre of its road's reference line."""
        bend = self.network.road(place.road).line.curvature(place.s)
        return max(0.1, 1.0 - bend * self.lateral(place)) if bend else 1.0

    def advance(self, place: OnLane, distance: float, route: frozenset[str] = frozenset()) -> OnLane | None:
        """The place `distance` metres of reference line further along the lanes, None where they end.

        Of a fork it takes the road on the route, else the straightest. A negative distance leads back on the road.
        """
        road = self.network.road(place.road)
        s = place.s + place.way * distance
        if distance < 0.0:
            return replace(place, s=s) if 0.0 <= s <= road.length else None
        section = road.section_at(place.s)
        if place.way < 0 and section and place.s <= road.starts[section]:
            section -= 1
        key = LaneKey(place.road, section, place.lane)
        for _ in range(10_000):
            road = self.network.road(key.road)
            way = road.ahead(key.lane) if key.road != place.road else place.way
            end = road.section_end(key.section) if way > 0 else road.starts[key.section]
            beyond = way * (s - end)
            if beyond <= 0.0:
                return OnLane(key.road, key.lane, s, place.offset * (way * place.way), way)
            following = self.network.following(key) if way == road.ahead(key.lane) else ()
            if not following:
                return None
            chosen = self.choose(key, following, route)
            ahead = self.network.road(chosen.road).ahead(chosen.lane)
            start = self.network.road(chosen.road)
            s = (start.starts[chosen.section] if ahead > 0 else start.section_end(chosen.section)) + ahead * beyond
            if chosen.road != key.road:
                place = replace(place, road=chosen.road, way=ahead, offset=place.offset * (ahead * way))
            key = chosen
        raise InputError("lanes that follow each other without length")

    def choose(self, key: LaneKey, following: tuple[LaneKey, ...], route: frozenset[str]) -> LaneKey:
        """Of the lanes that follow one, that of the road on the route, else the straightest."""
        heading = self.network.end_of(key, last=True)[1]

        def turn(other: LaneKey) -> tuple[bool, float]:
            return other.road not in route, abs(float(wrap(np.array(self.network.end_of(other, True)[1] - heading))))

        return min(following, key=turn)

    def distance(self, first: OnLane, second: OnLane, route: frozenset[str]) -> float | None:
        """Metres along the way from one place to another on its way, negative behind on the same road; None if it is
        not met within LOOK_AHEAD. Lanes beside each other count as one way."""
        if first.road == second.road:
            return first.way * (second.s - first.s)
        here, travelled = first, 0.0
        while travelled < LOOK_AHEAD:
            road = self.network.road(here.road)
            rest = (road.length - here.s) if here.way > 0 else here.s
            following = self.advance(here, rest + 1e-6, route)
            if following is None:
                return None
            travelled += rest
            if following.road == second.road:
                return travelled + following.way * (second.s - following.s)
            if following.road == here.road:
                return None
            here = following
        return None

    def between(self, first: OnLane, second: OnLane) -> set[str]:
        """The ids of the roads of the shortest way along lanes from one place to another.

        Raises:
            InputError: the lanes of one do not lead to the road of the other.
        """
        start = LaneKey(first.road, self.network.road(first.road).section_at(first.s), first.lane)
        before: dict[LaneKey, LaneKey | None] = {start: None}
        ahead: list[tuple[float, LaneKey]] = [(0.0, start)]
        while ahead:
            length, key = heapq.heappop(ahead)
            if key.road == second.road:
                roads, here = set[str](), key
                while here is not None:
                    roads.add(here.road)
                    here = before[here]
                return roads
            road = self.network.road(key.road)
            length += road.section_end(key.section) - road.starts[key.section]
            for other in self.network.following(key):
                if other not in before:
                    before[other] = key
                    heapq.heappush(ahead, (length, other))
        raise InputError(f"no lane leads from road {first.road:.40}, lane {first.lane}, to road {second.road:.40}")

    def beside(self, place: OnLane, lanes: int) -> int:
        """The number of the lane `lanes` lanes to the left of a place, seen in its direction (negative: right)."""
        road = self.network.road(place.road)
        numbers = sorted([*road.sections[road.section_at(place.s)]])
        index = numbers.index(place.lane) + lanes * place.way
        if not 0 <= index < len(numbers):
            raise InputError(f"road {place.road:.40} has no lane {lanes:+d} beside lane {place.lane}")
        return numbers[index]


class Mover:
    """A road user in motion."""

    def __init__(self, entity: Entity, roads: Roads) -> None:
        self.entity, self.roads = entity, roads
        self.place: Place | None = None
        self.speed = 0.0
        self.travelled = 0.0
        self.route: frozenset[str] = frozenset()
        self.turned = 0.0
        """Heading beside that of the place: from a stated orientation, or while it moves sideways."""

    @property
    def pose(self) -> Free:
        """Its reference point and heading; `InputError` before it was put anywhere."""
        if self.place is None:
            raise InputError(f"entity {self.entity.name:.60} is nowhere: it has no TeleportAction before it is used")
        found = self.roads.pose(self.place)
        return replace(found, heading=found.heading + self.turned)

    @property
    def box_center(self) -> tuple[float, float]:
        """The middle of its box."""
        center = self.pose.shifted(self.entity.ahead, self.entity.left)
        return center.x, center.y

    def move(self, seconds: float) -> bool:
        """Go on at its speed; False where its lanes end."""
        distance = self.speed * seconds
        self.travelled += abs(distance)
        if isinstance(self.place, OnLane):
            self.place = self.roads.advance(self.place, distance / self.roads.stretch(self.place), self.route)
        elif isinstance(self.place, OnPath):
            self._follow(self.place.along + distance)
        elif self.place is not None:
            self.place = replace(self.place, heading=self.place.heading + self.turned).shifted(distance, 0.0)
            self.turned = 0.0
        return self.place is not None

    def _follow(self, along: float) -> None:
        """Go on along a path, and straight on from its end."""
        assert isinstance(self.place, OnPath)
        end = float(arc_lengths(self.place.path)[-1])
        self.place = replace(self.place, along=min(along, end))
        if along >= end:
            self.place = _on_path(self.place)

    def set_offset(self, offset: float, seconds: float) -> None:
        """Move sideways in its lane to an offset, within a step of some seconds."""
        assert isinstance(self.place, OnLane)
        sideways = self.place.way * (offset - self.place.offset) / seconds
        self.turned = float(np.arctan2(sideways, self.speed)) if self.speed > 0.1 else 0.0
        self.place = replace(self.place, offset=offset)

    def change_lane(self, lane: int) -> float:
        """Belong to another lane of the road from now on; returns the offset from its centre, where it still is."""
        assert isinstance(self.place, OnLane)
        road = self.roads.network.road(self.place.road)
        offset = self.roads.lateral(self.place) - road.lane_offset(lane, self.place.s)
        self.place = replace(self.place, lane=lane, offset=offset)
        return offset

    def gap(self, other: "Mover", freespace: bool, along_road: bool) -> float:
        """Signed metres to another, ahead positive: between reference points, or (`freespace`) between boxes.

        Measured along the road where both are on the way ahead, else along its heading.
        """
        signed = None
        if along_road and isinstance(self.place, OnLane) and isinstance(other.place, OnLane):
            signed = self.roads.distance(self.place, other.place, self.route)
        if signed is None:
            pose, there = self.pose, other.pose
            cos, sin = np.cos(pose.heading), np.sin(pose.heading)
            signed = float(cos * (there.x - pose.x) + sin * (there.y - pose.y))
        if not freespace:
            return signed
        if signed >= 0.0:
            return max(0.0, signed - self.entity.front - other.entity.rear)
        return min(0.0, signed + self.entity.rear + other.entity.front)


def _on_path(place: OnPath) -> Free:
    arc = arc_lengths(place.path)
    index = int(np.clip(np.searchsorted(arc, place.along, side="right") - 1, 0, len(arc) - 2))
    step = place.path[index + 1] - place.path[index]
    share = (place.along - arc[index]) / max(arc[index + 1] - arc[index], 1e-9)
    x, y = place.path[index] + min(max(share, 0.0), 1.0) * step
    return Free(float(x), float(y), float(np.arctan2(step[1], step[0])))
