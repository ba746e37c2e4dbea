"""A map of roads, and what is asked of it: what lane is here, what leads where, who goes first."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.scenes.maps.lanes import Crossing, Lane, Light, StopLine
from olt_closed_loop.scenes.maps.routes import find_route, line_along
from olt_closed_loop.scenes.maps.segments import Segments
from olt_closed_loop.scenes.maps.surfaces import lane_polygon
from olt_generator.errors import InputError
from olt_generator.poses import Array

REACH = 6.0
"""Metres from a lane's centre line beyond which a place is beside no lane."""
_LEAST_OVERLAP = 0.2
"""Metres by which two ways must overlap to conflict; neighbours only touch."""


@dataclass(frozen=True)
class LanePlaces:
    """Places beside lanes.

    Attributes:
        lanes: (n,) index of the lane in `RoadMap.lanes`; -1 where none is near.
        along: (n,) metres along its centre line; not a number where no lane is near.
        offsets: (n,) metres to the left of its centre line; not a number where no lane is near.
        headings: (n,) its direction there, radians; not a number where no lane is near.
    """

    lanes: NDArray[np.int64]
    along: Array
    offsets: Array
    headings: Array


@dataclass(frozen=True)
class RoadMap:
    """Lanes, what regulates them, and where one may drive. World frame, metres.

    Attributes:
        lanes: every lane, ids unique.
        road_edges: polylines (n, 3) that bound the drivable area, which lies to their left.
        drivable: closed outlines (n, 3) without holes, counter-clockwise, whose union is the drivable area.
        stop_lines, crossings, lights: what regulates traffic.
    """

    lanes: tuple[Lane, ...]
    road_edges: tuple[Array, ...] = ()
    drivable: tuple[Array, ...] = ()
    stop_lines: tuple[StopLine, ...] = ()
    crossings: tuple[Crossing, ...] = ()
    lights: tuple[Light, ...] = ()

    @cached_property
    def by_id(self) -> dict[str, Lane]:
        """The lanes by id."""
        return {lane.id: lane for lane in self.lanes}

    def lane(self, lane_id: str) -> Lane:
        """A lane.

        Raises:
            InputError: the map has none of that id.
        """
        if lane_id not in self.by_id:
            raise InputError(f"the map has no lane {lane_id:.80}; it has {', '.join(list(self.by_id)[:8]):.200}, ...")
        return self.by_id[lane_id]

    @cached_property
    def predecessors(self) -> dict[str, tuple[str, ...]]:
        """By lane, those that lead to it."""
        before: dict[str, list[str]] = {lane.id: [] for lane in self.lanes}
        for lane in self.lanes:
            for follower in lane.successors:
                before.get(follower, []).append(lane.id)
        return {lane: tuple(others) for lane, others in before.items()}

    @property
    def entries(self) -> tuple[str, ...]:
        """The lanes for cars to which no lane of the map leads."""
        return tuple(lane.id for lane in self.lanes if lane.for_cars and not self.predecessors[lane.id])

    @property
    def exits(self) -> tuple[str, ...]:
        """The lanes for cars from which no lane of the map leads on."""
        return tuple(
            lane.id for lane in self.lanes if lane.for_cars and not any(one in self.by_id for one in lane.successors)
        )

    def nearest(self, points: Array, headings: Array | None = None, reach: float = REACH) -> LanePlaces:
        """The lanes for cars nearest to points (n, 2 or more), by the distance from their centre lines.

        Args:
            points: (n, 2 or more) metres.
            headings: (n,) radians; then only lanes that run within 90 degrees of them are taken.
            reach: metres beyond which no lane is near.
        """
        return LanePlaces(*self._segments.nearest(points[:, :2], headings, reach))

    def lanes_at(self, point: Array) -> list[str]:
        """The lanes whose area holds a point (2,), in the map's order."""
        found = self._areas.query(shapely.Point(point[:2] - self._origin), predicate="intersects")
        return [self.lanes[index].id for index in np.sort(found)]

    @cached_property
    def conflicts(self) -> dict[str, tuple[str, ...]]:
        """By lane, those through the same junction that cross it or end in the same lane, without those that split
        from it at the start: one may not be on both at once. Symmetric."""
        ways = [lane for lane in self.lanes if lane.junction is not None]
        areas = np.array([lane_polygon(lane).buffer(-_LEAST_OVERLAP / 2.0) for lane in ways], dtype=object)
        tree = shapely.STRtree(areas)
        found: dict[str, list[str]] = {lane.id: [] for lane in self.lanes}
        for one, other in zip(*tree.query(areas, predicate="intersects"), strict=True):
            first, second = ways[one], ways[other]
            split = set(self.predecessors[first.id]) & set(self.predecessors[second.id])
            if one != other and first.junction == second.junction and not split:
                found[first.id].append(second.id)
        return {lane: tuple(sorted(others)) for lane, others in found.items()}

    def goes_first(self, lane_id: str, other_id: str) -> bool | None:
        """Whether traffic of one lane has right of way over that of another; None if neither has or it is not known."""
        own, others = self.lane(lane_id).yields_to, self.lane(other_id).yields_to
        waits = own is not None and other_id in own
        makes_wait = others is not None and lane_id in others
        return None if waits == makes_wait else makes_wait

    def light_of(self, lane_id: str) -> Light | None:
        """The light that rules a lane, a person's before any other; None where there is none."""
        ruling = sorted((light for light in self.lights if lane_id in light.lanes), key=lambda one: not one.by_hand)
        return ruling[0] if ruling else None

    def red_us(self, lane_id: str, end_us: int) -> NDArray[np.int64] | None:
        """From when until when (k, 2) the light of a lane is red, as far as `end_us`; None where it has no light."""
        light = self.light_of(lane_id)
        return None if light is None else light.spans("red", end_us)

    def route(self, start_id: str, goal_id: str, via: Sequence[str] = ()) -> tuple[str, ...]:
        """The lanes of the shortest way from one lane to another, each followed by a successor or a neighbour.

        One changes lanes only where the marking is known to allow it, to a lane for cars that runs the same way, on
        lanes of 20 m and more.

        Raises:
            InputError: no way leads there, or a lane is not in the map.
        """
        stops, found = [start_id, *via, goal_id], [start_id]
        for stop in stops:
            self.lane(stop)
        for goal in stops[1:]:
            found += find_route(self.by_id, found[-1], goal)[1:]
        return tuple(found)

    def route_line(self, lane_ids: Sequence[str]) -> Array:
        """The line (n, 3) along the centres of lanes that follow each other; changes of lanes are smooth.

        Raises:
            InputError: two lanes do not follow each other, or one is not in the map.
        """
        for lane_id in lane_ids:
            self.lane(lane_id)
        return line_along(self.by_id, lane_ids)

    @cached_property
    def _origin(self) -> Array:
        return self.lanes[0].center[0, :2] if self.lanes else np.zeros(2)

    @cached_property
    def _segments(self) -> Segments:
        return Segments([lane.center[:, :2] if lane.for_cars else None for lane in self.lanes])

    @cached_property
    def _areas(self) -> shapely.STRtree:
        moved = [shapely.transform(lane_polygon(lane), lambda points: points - self._origin) for lane in self.lanes]
        return shapely.STRtree(moved)
