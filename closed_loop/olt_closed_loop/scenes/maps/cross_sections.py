"""Lanes beside each other along a course: driving lanes, cycle lane, shoulder and sidewalk on either side."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from olt_closed_loop.scenes.maps.courses import Course
from olt_closed_loop.scenes.maps.lanes import Lane, LaneType, Marking, Pattern
from olt_generator.errors import InputError
from olt_generator.poses import Array

PAVED: tuple[LaneType | None, ...] = (None, "driving", "cycle", "shoulder")


@dataclass(frozen=True)
class CrossSection:
    """Widths of what lies beside each other, the same on both sides of the line between the directions.

    Attributes:
        lane_width: of a driving lane, metres.
        cycle_width, shoulder, sidewalk_width: of what lies outside of the driving lanes, in this order; 0 for none.
        wear: share of the paint that is gone, 0 to 1.
        speed_limit: m/s, None for none known.
    """

    lane_width: float = 3.5
    cycle_width: float = 0.0
    shoulder: float = 0.5
    sidewalk_width: float = 0.0
    wear: float = 0.0
    speed_limit: float | None = None

    def __post_init__(self) -> None:
        if not 2.0 <= self.lane_width <= 8.0:
            raise InputError(f"lane_width is {self.lane_width:g} m; a driving lane is 2 to 8 m wide")
        for name in ("cycle_width", "shoulder", "sidewalk_width"):
            if not 0.0 <= getattr(self, name) <= 10.0:
                raise InputError(f"{name} is {getattr(self, name):g} m; give 0 (none) to 10")
        if not 0.0 <= self.wear <= 1.0:
            raise InputError(f"wear is {self.wear:g}; give a share of 0 to 1")

    def strips(self, lanes: int) -> list[tuple[str, LaneType, float]]:
        """Name, type and width of what lies on one side of the dividing line, from the inside out."""
        driving: list[tuple[str, LaneType, float]] = [(str(i), "driving", self.lane_width) for i in range(lanes)]
        outside: tuple[tuple[LaneType, float], ...] = (
            ("cycle", self.cycle_width),
            ("shoulder", self.shoulder),
            ("sidewalk", self.sidewalk_width),
        )
        return driving + [(kind, kind, width) for kind, width in outside if width > 0.0]

    def lane_offset(self, lane: int) -> float:
        """Distance of a driving lane's centre from the dividing line, metres."""
        return (lane + 0.5) * self.lane_width

    def paved_width(self, lanes: int) -> float:
        """Metres from the dividing line to the edge of the pavement."""
        return lanes * self.lane_width + self.cycle_width + self.shoulder

    def whole_width(self, lanes: int) -> float:
        """Metres from the dividing line to the outer edge of the sidewalk."""
        return self.paved_width(lanes) + self.sidewalk_width


def lay_side(
    course: Course, section: CrossSection, lanes: int, prefix: str, divider: Marking, against: bool, offset: float = 0.0
) -> list[Lane]:
    """The lanes on one side of a dividing line, named `<prefix>_<number or kind>`, in right-hand traffic.

    Args:
        course: along which they run.
        section: their widths.
        lanes: driving lanes.
        prefix: of their names.
        divider: marking on the dividing line.
        against: whether traffic runs against the course; then they lie on its left.
        offset: of the dividing line to the left of the course, metres.
    """
    side, laid, inner = 1.0 if against else -1.0, list[Lane](), 0.0
    for name, kind, width in section.strips(lanes):
        left, center, right = (
            course.beside(offset + side * (inner + part * width), reverse=against) for part in (0.0, 0.5, 1.0)
        )
        limit = section.speed_limit if kind == "driving" else None
        laid.append(Lane(f"{prefix}_{name}", center, left, right, type=kind, speed_limit=limit))
        inner += width
    return _with_neighbours(laid, section.wear, divider)


def divider_between(lanes: int, opposite: int, wear: float) -> Marking:
    """The line between two directions: to be crossed where each has one lane, a double one else."""
    if opposite == 0:
        return Marking("solid", False, wear)
    return Marking("dashed", True, wear) if lanes == opposite == 1 else Marking("double", False, wear)


def join_directions(forward: list[Lane], backward: list[Lane]) -> list[Lane]:
    """The lanes of both directions; the innermost ones are neighbours."""
    if not (forward and backward and forward[0].for_cars and backward[0].for_cars):
        return forward + backward
    first = replace(forward[0], left_neighbours=(backward[0].id,))
    second = replace(backward[0], left_neighbours=(forward[0].id,))
    return [first, *forward[1:], second, *backward[1:]]


def _with_neighbours(lanes: list[Lane], wear: float, divider: Marking) -> list[Lane]:
    borders = [_border(one.type, other.type, wear) for one, other in pairwise(lanes)]
    lefts = [divider, *borders]
    outermost = "kerb" if lanes and lanes[-1].type == "sidewalk" else "none"
    if lanes and lanes[-1].type in ("driving", "cycle"):
        outermost = "solid"
    rights = [*borders, Marking(outermost, False, wear)]
    names: list[tuple[str, ...]] = [(), *((lane.id,) for lane in lanes), ()]
    return [
        replace(
            lane,
            left_marking=lefts[i],
            right_marking=rights[i],
            left_neighbours=names[i],
            right_neighbours=names[i + 2],
        )
        for i, lane in enumerate(lanes)
    ]


def _border(inner: LaneType | None, outer: LaneType | None, wear: float) -> Marking:
    """The marking between two kinds of lanes."""
    if inner == outer == "driving":
        return Marking("dashed", True, wear)
    pattern: Pattern = "kerb" if outer == "sidewalk" else "solid"
    return Marking(pattern, False, wear)


def check_bends(course: Course, widths: Sequence[float], where: str) -> None:
    """Refuse a course so tight that a border so many metres beside it would cross itself.

    Raises:
        InputError: it is.
    """
    least = max(map(abs, widths)) + 0.25
    if course.tightest < least:
        raise InputError(f"{where}: a bend has a radius of {course.tightest:.2f} m; this width needs {least:.2f} m")


def varying(course: Course, first: float, last: float) -> Array:
    """Values (n,) along a course that change from one to another."""
    return np.interp(course.stations, course.stations[[0, -1]], (first, last))
