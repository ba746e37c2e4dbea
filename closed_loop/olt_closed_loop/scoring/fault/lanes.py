"""Whose lane a contact lies in.

A body's own lanes are those that hold its centre and run its way (within 60 degrees), and all that lead to them or on
from them. A contact that lies in the own lanes of one body and not of the other is in that body's lane. Where lanes
overlap, as they do at junctions and merges, near a marking, and where the map shows no lane, lanes decide nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from olt_closed_loop.rollouts.rollout_record import LaneLines
from olt_closed_loop.scenes.polylines import wrap
from olt_closed_loop.scoring.drivable import lane_area
from olt_closed_loop.scoring.moving_boxes import MovingBox
from olt_generator.poses import Array

SAME_WAY = np.deg2rad(60.0)
ALONG = np.deg2rad(30.0)
MARKING = 0.2
"""Metres on both sides of a marking within which a contact is in neither lane: maps and boxes are no better."""
_JOINT = 1.0
_CRACK = 0.1
_MEMORY_US = 3_000_000
_STEP_US = 250_000


@dataclass(frozen=True)
class LaneMap:
    """The lanes of a drive; areas are made when they are first asked for."""

    lanes: Sequence[LaneLines]
    origin: Array

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        """Lower and upper corners (n, 2) of the lanes, widened by the widest half of a lane."""
        centers = [lane.center[:, :2] - self.origin for lane in self.lanes]
        low, high = (np.array([reach(center, axis=0) for center in centers]) for reach in (np.min, np.max))
        return low - 5.0, high + 5.0

    @cached_property
    def _areas(self) -> dict[int, BaseGeometry]:
        return {}

    def area(self, lane: int) -> BaseGeometry:
        """The area of a lane relative to the origin."""
        if lane not in self._areas:
            self._areas[lane] = shapely.make_valid(lane_area(self.lanes[lane], self.origin))
        return self._areas[lane]

    def at(self, position: Array) -> list[int]:
        """The lanes that hold a position (2,)."""
        point = position - self.origin
        low, high = self._bounds
        near = np.flatnonzero(((low <= point) & (point <= high)).all(axis=1))
        return [int(lane) for lane in near if shapely.intersects_xy(self.area(int(lane)), *point)]

    def heading(self, lane: int, position: Array) -> float:
        """Direction of a lane beside a position (2,), radians."""
        line = shapely.LineString(self.lanes[lane].center[:, :2] - self.origin)
        along = shapely.line_locate_point(line, shapely.Point(position - self.origin))
        ahead, behind = (
            shapely.get_coordinates(shapely.line_interpolate_point(line, place))[0]
            for place in (min(along + 0.5, line.length), max(along - 0.5, 0.0))
        )
        return float(np.arctan2(*(ahead - behind)[::-1]))

    def with_way(self, pose: Array, most: float = SAME_WAY) -> list[int]:
        """The lanes that hold the centre of a pose (4,) and run its way, within an angle."""
        return [lane for lane in self.at(pose[:2]) if angle(self.heading(lane, pose[:2]) - pose[3]) <= most]

    @cached_property
    def _ends(self) -> tuple[Array, Array]:
        starts, ends = (np.array([lane.center[end, :2] for lane in self.lanes]) for end in (0, -1))
        return starts, ends

    def linked(self, lanes: Sequence[int]) -> set[int]:
        """Lanes with all those that lead on from them and all that lead to them."""
        starts, ends = self._ends
        found = set(lanes)
        for here, there in ((ends, starts), (starts, ends)):
            open_ = list(lanes)
            reached = set(lanes)
            while open_:
                gaps = np.linalg.norm(there - here[open_.pop()], axis=1)
                new = set(np.flatnonzero(gaps <= _JOINT).tolist()) - reached
                reached |= new
                open_ += sorted(new)
            found |= reached
        return found

    def own(self, body: MovingBox, time_us: int) -> set[int]:
        """A body's own lanes at a time."""
        return self.linked(self.with_way(body.at(np.array([time_us]))[0]))

    def was_on_lane(self, body: MovingBox, time_us: int) -> bool:
        """Whether a body drove along a lane, within 30 degrees, at some time in the 3 s before."""
        begin_us = max(time_us - _MEMORY_US, int(body.timestamps_us[0]))
        return any(self.with_way(pose, ALONG) for pose in body.at(np.arange(time_us, begin_us - 1, -_STEP_US)))

    def deep_in(self, point: Array, lanes: set[int]) -> bool:
        """Whether a point (2,) lies in the area of some lanes together, not within 0.2 m of its border."""
        low, high = self._bounds
        place = point - self.origin
        near = [lane for lane in lanes if (low[lane] <= place).all() and (place <= high[lane]).all()]
        # Sections of one lane meet without a crack.
        area = shapely.union_all([self.area(lane).buffer(_CRACK) for lane in near]).buffer(-_CRACK)
        spot = shapely.Point(place)
        return bool(area.contains(spot) and area.boundary.distance(spot) >= MARKING)

    def touches(self, point: Array, lanes: set[int]) -> bool:
        """Whether a point (2,) lies in one of some lanes, or less than 0.2 m beside it."""
        low, high = self._bounds
        place = point - self.origin
        near = [lane for lane in lanes if (low[lane] <= place).all() and (place <= high[lane]).all()]
        return any(self.area(lane).distance(shapely.Point(place)) < MARKING for lane in near)


def angle(turn: float) -> float:
    """Size of an angle, 0 to pi."""
    return float(abs(wrap(np.array(turn))))


def entered_on_red(lanes: LaneMap, body: MovingBox, time_us: int) -> bool | None:
    """Whether a body drove into a lane whose light was red; None where no light of its lanes was recorded.

    It is looked at the lane that runs the body's way at the time, and at when its centre came onto it.
    """
    answers = []
    for lane in lanes.with_way(body.at(np.array([time_us]))[0]):
        red_us = lanes.lanes[lane].red_us
        if red_us is None:
            continue
        times = np.arange(time_us, int(body.timestamps_us[0]) - 1, -20_000, dtype=np.int64)
        points = body.at(times, columns=2) - lanes.origin
        inside = shapely.intersects_xy(lanes.area(lane), *points.T)
        entry_us = int(times[np.argmin(inside) - 1]) if not inside.all() else int(times[-1])
        answers.append(bool(((red_us[:, 0] <= entry_us) & (entry_us < red_us[:, 1])).any()))
    return all(answers) if answers else None
