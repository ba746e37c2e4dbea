"""Arms of junctions: the roads that lead to a centre, and where they end before it.

An arm is laid outwards from its mouth, where it meets the junction. Seen outwards, the lanes that leave the junction
lie on its right and those that lead to it on its left (right-hand traffic; left-hand traffic is the mirror image).
"""

from dataclasses import dataclass, field

import numpy as np

from olt_closed_loop.scenes.maps.courses import Course, Place, follow
from olt_closed_loop.scenes.maps.cross_sections import (
    CrossSection,
    check_bends,
    divider_between,
    join_directions,
    lay_side,
)
from olt_closed_loop.scenes.maps.lanes import Control, Crossing, Lane, StopLine
from olt_generator.errors import InputError
from olt_generator.poses import Array

Turn = str
TURNS: tuple[Turn, ...] = ("left", "straight", "right")
CROSSING_ROOM = 4.5
"""Metres inside of the mouth that a crossing needs: a metre to the stop line, 3 m of crossing, half a metre."""
_CROSSING = (1.0, 4.0)
_STRAIGHT, _EASING = 15.0, 15.0


@dataclass(frozen=True)
class Arm:
    """A road that leads to a junction.

    Attributes:
        heading: direction from the junction along the arm, radians.
        inbound, outbound: driving lanes towards the junction and away from it.
        length: metres from its mouth to its far end.
        section: widths of its lanes and what lies beside them.
        offset: of its dividing line to the left of the centre, seen outwards, metres.
        bend: curvature of its far part, 1/m, positive to the left seen outwards.
        control: what tells its traffic who goes first: priority, yield, stop or light. None for nothing, which means to
            give way to the right (in left-hand traffic too).
        crossing: whether people on foot cross at its mouth.
        turns: what traffic from this arm may do: left, straight, right.
    """

    heading: float
    inbound: int = 1
    outbound: int = 1
    length: float = 80.0
    section: CrossSection = field(default_factory=CrossSection)
    offset: float = 0.0
    bend: float = 0.0
    control: Control | None = None
    crossing: bool = False
    turns: tuple[Turn, ...] = TURNS

    def __post_init__(self) -> None:
        if not (0 <= self.inbound <= 6 and 0 <= self.outbound <= 6 and self.inbound + self.outbound):
            raise InputError(f"an arm has {self.inbound} lanes in and {self.outbound} out; give 0 to 6, not 0 and 0")
        if not 5.0 <= self.length <= 2000.0:
            raise InputError(f"an arm is {self.length:g} m long; give 5 to 2000")
        if not np.isfinite([self.heading, self.offset, self.bend]).all():
            raise InputError("heading, offset and bend of an arm are finite numbers")
        if unknown := set(self.turns) - set(TURNS):
            raise InputError(f"turns {', '.join(sorted(unknown))} of an arm are not known; give {', '.join(TURNS)}")

    @property
    def lead(self) -> float:
        """Metres at the mouth along which ways through the junction are straight."""
        return CROSSING_ROOM if self.crossing else 0.3

    def outward(self, distance: float, left: float = 0.0) -> Place:
        """The place at a distance from the centre, and to the left of the dividing line, that looks outwards."""
        return Place(0.0, 0.0, self.heading).at(distance, self.offset + left)

    def inward(self, distance: float, left: float = 0.0) -> Place:
        """The place at a distance from the centre, and to the left of the dividing line, that looks inwards."""
        return self.outward(distance, left)._replace(heading=self.heading + np.pi)

    def inbound_left(self, lane: int) -> float:
        """How far to the left of the dividing line an inbound lane has its centre."""
        return self.section.lane_offset(lane)

    def outbound_left(self, lane: int) -> float:
        """How far to the left of the dividing line an outbound lane has its centre."""
        return -self.section.lane_offset(lane)

    @property
    def inbound_edge(self) -> float:
        """How far to the left of the dividing line the pavement of the inbound side ends."""
        return self.section.paved_width(self.inbound)

    @property
    def outbound_edge(self) -> float:
        """How far to the left of the dividing line the pavement of the outbound side ends."""
        return -self.section.paved_width(self.outbound)


def lay_arm(arm: Arm, name: str, mouth: float) -> tuple[list[Lane], Course]:
    """The lanes `<name>_in_*` and `<name>_out_*` of an arm whose mouth is so far from the centre, and its course.

    Raises:
        InputError: it bends too tightly for its width.
    """
    straight = min(_STRAIGHT, arm.length)
    easing = min(_EASING, arm.length - straight)
    bend = arm.bend if arm.length > straight else 0.0
    rest = arm.length - straight - easing
    course = follow(arm.outward(mouth), [(straight, 0.0, 0.0), (easing, 0.0, bend), (rest, bend, bend)])
    widths = [arm.section.whole_width(lanes) for lanes in (arm.inbound, arm.outbound)]
    check_bends(course, widths, name)
    divider = divider_between(arm.inbound, arm.outbound, arm.section.wear)
    out = lay_side(course, arm.section, arm.outbound, f"{name}_out", divider, against=False)
    into = lay_side(course, arm.section, arm.inbound, f"{name}_in", divider, against=True)
    return join_directions(out, into), course


def far_end(arm: Arm, course: Course) -> Array:
    """The line (2, 3) across the pavement at the far end of an arm."""
    return np.stack([course.beside(edge)[-1] for edge in (arm.inbound_edge, arm.outbound_edge)])


def stop_line(arm: Arm, name: str, mouth: float) -> StopLine | None:
    """The line at the mouth at which its traffic waits, where it may have to."""
    if arm.control in (None, "priority") or arm.inbound == 0:
        return None
    across = (0.0, arm.inbound * arm.section.lane_width)
    points = np.array([[*arm.outward(mouth, left)[:2], 0.0] for left in across])
    return StopLine(f"{name}_stop", points, tuple(f"{name}_in_{i}" for i in range(arm.inbound)), arm.control)


def crossing(arm: Arm, name: str, mouth: float, lanes: tuple[str, ...]) -> Crossing | None:
    """The crossing inside of the mouth, from one edge of the pavement to the other."""
    if not arm.crossing:
        return None
    near, far = (mouth - distance for distance in _CROSSING)
    corners = [(far, arm.outbound_edge), (near, arm.outbound_edge), (near, arm.inbound_edge), (far, arm.inbound_edge)]
    outline = np.array([[*arm.outward(distance, left)[:2], 0.0] for distance, left in corners])
    return Crossing(f"{name}_crossing", outline, lanes, zebra=True)
