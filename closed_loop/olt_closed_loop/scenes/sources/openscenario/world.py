"""What conditions and actions of a scenario look at: time, road users, and the states of the storyboard's parts."""

from dataclasses import dataclass, field, replace
from itertools import pairwise
from xml.etree.ElementTree import Element

import numpy as np

from olt_closed_loop.scenes.polylines import without_repeats
from olt_closed_loop.scenes.sources.openscenario.entities import Catalogues
from olt_closed_loop.scenes.sources.openscenario.motion import Free, Mover, OnLane, OnPath, Place, Roads
from olt_closed_loop.scenes.sources.xml_files import child, number_of, text_of
from olt_generator.errors import InputError

STEP = 0.05
"""Seconds between two looks at the conditions."""


@dataclass
class State:
    """Of a part of the storyboard: when it began and ended, in steps; None for not yet."""

    kind: str
    started: int | None = None
    ended: int | None = None
    stopped: bool = False
    """Whether it was ended from outside."""


@dataclass
class World:
    """The scenario at one moment."""

    roads: Roads
    catalogues: Catalogues
    movers: dict[str, Mover]
    step: int = 0
    states: dict[tuple[str, str], list[State]] = field(default_factory=dict)

    @property
    def time(self) -> float:
        """Seconds."""
        return self.step * STEP

    def mover(self, name: str) -> Mover:
        """A road user by its name, an `InputError` if there is none."""
        if name not in self.movers:
            raise InputError(f"there is no entity {name:.60}")
        return self.movers[name]

    def state(self, kind: str, name: str) -> State:
        """A new state of a part, by which conditions find it."""
        state = State(kind)
        self.states.setdefault((kind, name), []).append(state)
        return state

    def place(self, position: Element) -> tuple[Place, float]:
        """The place that a `Position` (resolved) means, and the turn beside that place's heading, radians.

        Raises:
            InputError: the position is of a kind that is not read, or is not on the roads.
        """
        if len(position) != 1:
            raise InputError(f"a Position of {len(position)} parts; one is expected")
        (kind,) = position
        place = self._place(kind)
        orientation = kind.find("Orientation")
        if orientation is None:
            return place, 0.0
        turn = number_of(orientation, "h", kind.tag, 0.0)
        if orientation.get("type", "absolute") != "relative":
            turn -= self.roads.pose(place).heading
        if isinstance(place, OnLane) and np.cos(turn) < 0.0:
            # It faces the other way, and drives that way.
            return replace(place, way=-place.way), turn - np.pi
        return place, turn

    def _place(self, kind: Element) -> Place:
        if kind.tag == "LanePosition":
            return self.roads.on_lane(
                text_of(kind, "roadId", kind.tag),
                lane_number(kind, "laneId"),
                number_of(kind, "s", kind.tag),
                number_of(kind, "offset", kind.tag, 0.0),
            )
        if kind.tag == "RelativeLanePosition":
            return self._beside_entity(kind)
        if kind.tag == "RoutePosition":
            return self._along_route(kind)
        if kind.tag == "RelativeObjectPosition":
            pose = self.mover(text_of(kind, "entityRef", kind.tag)).pose
            dx, dy = number_of(kind, "dx", kind.tag), number_of(kind, "dy", kind.tag)
            return pose.shifted(dx, dy)
        if kind.tag == "WorldPosition":
            x, y, heading = (number_of(kind, name, kind.tag, 0.0) for name in ("x", "y", "h"))
            return Free(x, y, heading)
        raise InputError(f"<{kind.tag:.60}> is not read as a position")

    def _beside_entity(self, kind: Element) -> Place:
        other = self.mover(text_of(kind, "entityRef", kind.tag))
        if not isinstance(other.place, OnLane):
            raise InputError(f"{kind.tag}: entity {other.entity.name:.60} is in no lane")
        distance = number_of(kind, "ds", kind.tag, number_of(kind, "dsLane", kind.tag, 0.0))
        there = self.roads.advance(other.place, distance, other.route)
        if there is None:
            raise InputError(f"{kind.tag}: {distance:g} m from entity {other.entity.name:.60} there is no road")
        lane = self.roads.beside(there, lane_number(kind, "dLane"))
        offset = number_of(kind, "offset", kind.tag, 0.0)
        return OnLane(there.road, lane, there.s, offset, there.way)

    def _along_route(self, kind: Element) -> Place:
        route = self.catalogues.entry(child(child(kind, "RouteRef", kind.tag), "CatalogReference", kind.tag))
        inside = kind.find("InRoutePosition/FromLaneCoordinates")
        if inside is None:
            raise InputError("a RoutePosition without FromLaneCoordinates is not read")
        first, roads = self.route(route)
        there = self.roads.advance(first, number_of(inside, "pathS", kind.tag), roads)
        if there is None:
            raise InputError(f"route {route.get('name', ''):.60} ends before pathS")
        lane = lane_number(inside, "laneId")
        on_lane = self.roads.on_lane(there.road, lane, there.s)
        return OnLane(on_lane.road, lane, on_lane.s, 0.0, there.way)

    def route(self, route: Element) -> tuple[OnLane, frozenset[str]]:
        """The first waypoint of a `Route` (resolved), and the ids of the roads that it leads along."""
        places = [self.place(child(one, "Position", "Waypoint"))[0] for one in route.findall("Waypoint")]
        lanes = [place for place in places if isinstance(place, OnLane)]
        if route.tag != "Route" or len(lanes) < 2 or len(lanes) < len(places):
            raise InputError(f"route {route.get('name', ''):.60}: two or more waypoints in lanes are needed")
        roads: set[str] = set()
        for here, there in pairwise(lanes):
            roads |= self.roads.between(here, there)
        return lanes[0], frozenset(roads)

    def path(self, trajectory: Element) -> tuple[OnPath, list[float]]:
        """The polyline of a `Trajectory` (resolved) and the time of each of its points, seconds."""
        if trajectory.get("closed", "false") not in ("false", "0"):
            raise InputError("a closed Trajectory is not read")
        polyline = trajectory.find("Shape/Polyline")
        if polyline is None:
            raise InputError("a Trajectory whose Shape is no Polyline is not read")
        vertices = polyline.findall("Vertex")
        poses = [self.roads.pose(self.place(child(vertex, "Position", "Vertex"))[0]) for vertex in vertices]
        points = np.array([(pose.x, pose.y) for pose in poses]).reshape(-1, 2)
        if len(points) < 2 or len(without_repeats(points)) < 2:
            raise InputError("a Trajectory of fewer than two places")
        return OnPath(points), [number_of(vertex, "time", "Vertex", 0.0) for vertex in vertices]


def lane_number(element: Element, name: str) -> int:
    """An attribute that is a number of a lane, or of lanes."""
    number = number_of(element, name, element.tag)
    if number != round(number) or abs(number) > 100:
        raise InputError(f"{element.tag}: {name} {number:g} is no number of lanes")
    return int(number)
