"""A contact of the ego with somebody, as the rules of fault look at it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import shapely

from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scenes.polylines import length_of, points_along, without_repeats
from olt_closed_loop.scoring.drivable import DrivableArea
from olt_closed_loop.scoring.fault.driver import (
    WANDER,
    could_avoid,
    foreseen_at,
    in_the_way_at,
    look_back,
    since,
    speed_at,
    visible_at,
)
from olt_closed_loop.scoring.fault.lanes import LaneMap, angle
from olt_closed_loop.scoring.moving_boxes import MovingBox
from olt_generator.poses import Array

STANDING_US = 2_000_000
STANDING_SPEED = 0.04
"""Metres a second between the means of the first and the second half of two seconds, up to which a box stands."""
BACKED_M = 0.4
CROSSING = np.deg2rad(60.0)
"""Between headings; of those who cross, lanes do not tell who goes first."""
LEAVING = np.deg2rad(15.0)
"""Between headings; who drifts out of its lane seldom does so at a larger angle."""
CLOSING_M = 0.5
CLOSING_US = 2_000_000
SWERVES = 2.0
"""Times as much as the other that somebody must turn to have left its course."""
_SWERVE_US = 4_000_000
_SHORTEST_WAY = 5.0
_FAR = 1000.0
_STEP_US = 20_000

Side = Literal["front", "rear", "lateral"]
Who = Literal["ego", "agent"]


@dataclass(frozen=True)
class Site:
    """What the scene tells of the place of a contact; None where it does not.

    Attributes:
        lanes: the lanes.
        drivable: outlines of the drivable area.
        recorded: the way (n, 2 or more) that was recorded, metres.
    """

    lanes: LaneMap | None = None
    drivable: DrivableArea | None = None
    recorded: Array | None = None

    def offset(self, positions: Array) -> Array:
        """Metres (n,) of positions (n, 2) beside the recorded way, straight on beyond its ends; 0 where none is known.

        A way that is shorter than a car tells no direction.
        """
        way = np.zeros((1, 2)) if self.recorded is None else without_repeats(self.recorded[:, :2])
        length = length_of(way)
        if length < _SHORTEST_WAY:
            return np.zeros(len(positions))
        first, last = (
            points_along(way, np.array(ends)) for ends in ([0.0, _SHORTEST_WAY], [length - _SHORTEST_WAY, length])
        )
        before, after = (_FAR / _SHORTEST_WAY * (end[1] - end[0]) for end in (first, last))
        line = shapely.LineString(np.vstack([way[0] - before, way, way[-1] + after]) - way[0])
        return np.asarray(shapely.distance(line, shapely.points(positions - way[0])))


@dataclass(frozen=True)
class Encounter:
    """The ego and an agent at the moment at which they touch.

    Attributes:
        ego, agent: the two, over time.
        label: what the agent is.
        contact_us: when they touch.
        free_us: since when the policy drives the ego.
        side: the side of the ego that the contact presses on.
        direction: unit vector (2,) from the ego to the agent across the contact.
        point: where they touch (2,), metres.
        site: what the scene tells of the place.
        others: boxes that may hide the agent.
    """

    ego: MovingBox
    agent: MovingBox
    label: str
    contact_us: int
    free_us: int
    side: Side
    direction: Array
    point: Array
    site: Site
    others: Sequence[MovingBox]

    @cached_property
    def turn(self) -> float:
        """Angle between the headings, 0 (the same way) to pi (head-on)."""
        ego, agent = (box.at(np.array([self.contact_us]))[0, 3] for box in (self.ego, self.agent))
        return angle(agent - ego)

    @cached_property
    def ego_stands(self) -> bool:
        """Whether the ego stood for two seconds."""
        return _stands(self.ego, self.contact_us)

    @cached_property
    def agent_stands(self) -> bool:
        """Whether the agent stood for two seconds, or for all the time that it was there."""
        return _stands(self.agent, self.contact_us)

    @cached_property
    def closing_share(self) -> float:
        """Share of the ego in closing the gap between two that drive beside each other.

        It is measured across the course of the one that kept its course, over the last half metre or two seconds.
        Where both kept theirs or neither did, nobody can tell whose course counts: it is the larger share of both.
        """
        begin_us = max(self.contact_us - CLOSING_US, int(self.ego.timestamps_us[0]), int(self.agent.timestamps_us[0]))
        times = np.arange(self.contact_us, begin_us - 1, -_STEP_US, dtype=np.int64)
        boxes = {"agent": (self.ego,), "ego": (self.agent,), None: (self.ego, self.agent)}[self.swerved]
        return max(self._share_across(box.at(times[:1])[0, 3], times) for box in boxes)

    @cached_property
    def swerved(self) -> Who | None:
        """Who left its course, by turning far more than the other; None where that is not clear."""
        ego, agent = (_swerve(box, self.contact_us) for box in (self.ego, self.agent))
        return "agent" if agent > SWERVES * ego else "ego" if ego > SWERVES * agent else None

    def _share_across(self, course: float, times: np.ndarray) -> float:
        across = np.array([-np.sin(course), np.cos(course)])
        across = across if across @ self.direction > 0.0 else -across
        ways = [
            sign * ((_carried(box, self.point, times[:1]) - _carried(box, self.point, times)) @ across)
            for sign, box in ((1.0, self.ego), (-1.0, self.agent))
        ]
        closed = ways[0] + ways[1]
        far = np.flatnonzero(closed >= CLOSING_M)
        at = int(far[0]) if len(far) else int(np.argmax(closed))
        return float(ways[0][at] / closed[at]) if closed[at] > 0.0 else 0.5

    @cached_property
    def ego_backs(self) -> bool:
        """Whether the ego moves against its heading, faster than who stands."""
        return not self.ego_stands and _advance(self.ego, self.contact_us, STANDING_US // 4) < 0.0

    @cached_property
    def agent_backs(self) -> bool:
        """Whether the agent moved against its heading by more than noise in the last second."""
        return _advance(self.agent, self.contact_us, STANDING_US // 2) < -BACKED_M

    @cached_property
    def lane_owner(self) -> Who | None:
        """In whose own lane the contact lies; None where lanes do not tell."""
        lanes = self.site.lanes
        if lanes is None or CROSSING < self.turn < np.pi - CROSSING:
            return None
        own = {who: lanes.own(box, self.contact_us) for who, box in self._bodies}
        for (who, _), (other, their_box) in (self._bodies, self._bodies[::-1]):
            if not lanes.deep_in(self.point, own[who]) or lanes.touches(self.point, own[other]):
                continue
            # Who comes at an angle from where the map shows no lane may have one that is not drawn.
            drifts = not LEAVING < self.turn < np.pi - LEAVING
            if drifts or lanes.was_on_lane(their_box, self.contact_us):
                return who
        return None

    @property
    def ego_off_lanes(self) -> bool:
        """Whether the ego is off the lanes of a map that has some, with its centre and where it touches.

        Where the map has outlines of the drivable area, part of it must be outside of them too.
        """
        lanes, drivable, pose = self.site.lanes, self.site.drivable, self.ego.at(np.array([self.contact_us]))
        if lanes is None or lanes.at(pose[0, :2]) or lanes.at(self.point):
            return False
        return drivable is None or bool(drivable.leaves(pose, self.ego.half_size)[0])

    @cached_property
    def ego_left_its_way(self) -> bool:
        """Whether the ego moved away from the recorded way in the last four seconds, by more than wandering."""
        begin_us = max(self.contact_us - _SWERVE_US, int(self.ego.timestamps_us[0]))
        start, end = self.site.offset(self.ego.at(np.array([begin_us, self.contact_us]), columns=2))
        return bool(end - start > WANDER)

    @property
    def _bodies(self) -> tuple[tuple[Who, MovingBox], tuple[Who, MovingBox]]:
        return ("ego", self.ego), ("agent", self.agent)

    @cached_property
    def seen_in_the_way_us(self) -> int | None:
        """Since when the agent was in the ego's way and to be seen; None if it never was."""
        return since(self._visible & self._in_the_way, self._times)

    @cached_property
    def foreseen_us(self) -> int | None:
        """Since when the contact was to be seen coming; None if it never was."""
        return since(self._visible & self._on_course, self._times)

    @cached_property
    def on_course_us(self) -> int | None:
        """Since when the agent was on a course of contact, to be seen or not."""
        return since(self._on_course, self._times)

    @cached_property
    def entered_us(self) -> int | None:
        """When the ego came into the agent's way; None if it was there ever since both are known, or never."""
        entered_us = since(in_the_way_at(self.agent, self.ego, self._times), self._times)
        return None if entered_us == self._times[0] else entered_us

    def ego_could_avoid(self, aware_us: int | None, or_stand: bool = False) -> bool:
        """Whether the ego could have braked in time from when the risk showed, or, if that is enough, have stood."""
        if aware_us is None:
            return False
        return could_avoid(self.ego, self.agent, aware_us, self.contact_us, self.free_us, or_stand)

    def agent_could_avoid(self, aware_us: int | None) -> bool:
        """Whether the agent could have."""
        return aware_us is not None and could_avoid(self.agent, self.ego, aware_us, self.contact_us, aware_us)

    def seconds_before(self, time_us: int | None) -> float:
        """Seconds from a time to the contact; 0 for none."""
        return 0.0 if time_us is None else (self.contact_us - time_us) * 1e-6

    @cached_property
    def ego_speed(self) -> float:
        """The ego's speed in m/s over the half second before the contact."""
        return speed_at(self.ego, self.contact_us)

    @cached_property
    def _times(self) -> np.ndarray:
        return look_back(self.ego, self.agent, self.contact_us)

    @cached_property
    def _in_the_way(self) -> np.ndarray:
        return in_the_way_at(self.ego, self.agent, self._times)

    @cached_property
    def _on_course(self) -> np.ndarray:
        return foreseen_at(self.ego, self.agent, self._times) | self._in_the_way

    @cached_property
    def _visible(self) -> np.ndarray:
        return visible_at(self.ego, self.agent, self.others, self._times)


def _stands(box: MovingBox, time_us: int) -> bool:
    """Whether no corner of a box moves, noise set aside, over the two seconds before a time."""
    begin_us = max(time_us - STANDING_US, int(box.timestamps_us[0]))
    span = time_us - begin_us
    if span < 2:
        return True
    times = np.linspace(begin_us, time_us, 42).round().astype(np.int64)
    points = corners(box.at(times), box.half_size) - box.poses[0, :2]
    first, second = points[:21].mean(axis=0), points[21:].mean(axis=0)
    return float(np.linalg.norm(second - first, axis=-1).max()) < STANDING_SPEED * 0.5e-6 * span


def _advance(box: MovingBox, time_us: int, span_us: int) -> float:
    """Metres that a box moved along its heading in the time before a time."""
    start, end = box.at(np.array([max(time_us - span_us, int(box.timestamps_us[0])), time_us]))
    return float((end[:2] - start[:2]) @ [np.cos(end[3]), np.sin(end[3])])


def _swerve(box: MovingBox, time_us: int) -> float:
    """Range of a box's heading over the four seconds before a time, radians; a hundredth at least."""
    begin_us = max(time_us - _SWERVE_US, int(box.timestamps_us[0]))
    return max(float(np.ptp(box.at(np.linspace(begin_us, time_us, 41).round().astype(np.int64))[:, 3])), 0.01)


def _carried(box: MovingBox, point: Array, times: np.ndarray) -> Array:
    """Where (n, 2) the body's point that is at `point` at the first of the times (n,) was at each of them."""
    poses = box.at(times)
    turn = poses[:, 3] - poses[0, 3]
    arm = point - poses[0, :2]
    cos, sin = np.cos(turn), np.sin(turn)
    return poses[:, :2] + np.stack([cos * arm[0] - sin * arm[1], sin * arm[0] + cos * arm[1]], axis=-1)
