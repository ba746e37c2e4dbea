"""Roads without junctions: straight or bent, of several lanes in each direction, that may lose or gain one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely

from olt_closed_loop.scenes.maps.courses import Course, Place, connect, follow
from olt_closed_loop.scenes.maps.cross_sections import (
    CrossSection,
    check_bends,
    divider_between,
    join_directions,
    lay_side,
)
from olt_closed_loop.scenes.maps.frames import mirrored
from olt_closed_loop.scenes.maps.lanes import Lane, LaneType, Marking
from olt_closed_loop.scenes.maps.road_map import RoadMap
from olt_closed_loop.scenes.maps.surfaces import edges_of, outlines_of, paved_area
from olt_generator.errors import InputError

_STRAIGHT_BESIDE = 2.0


@dataclass(frozen=True)
class LaneChange:
    """Where the outermost lane of the forward direction ends in the one beside it, or a new one branches off.

    Attributes:
        start, end: stations between which it does, metres.
        lanes: forward lanes after it: one less (a lane drop) or one more (a lane gained).
    """

    start: float
    end: float
    lanes: int


def carriageway(
    length: float,
    forward: int = 1,
    backward: int = 1,
    section: CrossSection | None = None,
    bends: Sequence[tuple[float, float]] = ((0.0, 0.0),),
    change: LaneChange | None = None,
    left_hand: bool = False,
) -> RoadMap:
    """A road from the origin along the x axis: lanes `forward_0`, `backward_0`, ... from the dividing line outwards.

    With a change of lanes, those behind it are `after_0`, ..., and the ways between `forward_1>after_0`, ...; who
    shifts there yields to who goes straight on.

    Args:
        length: metres.
        forward, backward: driving lanes in each direction.
        section: widths; those of `CrossSection` by default.
        bends: (station, curvature in 1/m, positive to the left) knots; the curvature runs linearly between them.
        change: of the number of forward lanes, on a straight stretch.
        left_hand: traffic keeps to the left (the mirror image at the x axis, bends too).

    Raises:
        InputError: a number is out of its range, a bend too tight, the change not on a straight stretch, or the road
            runs into itself.
    """
    section = section or CrossSection()
    _check(length, forward, backward, bends, change)
    whole = _course(Place(0.0, 0.0, 0.0), 0.0, length, bends)
    most = max(forward, backward, change.lanes if change else 0)
    check_bends(whole, [section.whole_width(most)], "the road")
    divider = divider_between(forward, backward, section.wear)
    against = lay_side(whole, section, backward, "backward", divider, against=True)
    if change is None:
        along, last = lay_side(whole, section, forward, "forward", divider, against=False), forward
        lanes = join_directions(along, against)
    else:
        lanes, last = [*_changing(section, forward, change, length, bends, divider), *against], change.lanes
    area = paved_area(lanes)
    if not isinstance(area, shapely.Polygon) or area.interiors:
        raise InputError("the road runs into itself; make it shorter or bend it less")
    near, far = ((backward, forward), (backward, last))
    ends = [
        np.stack([whole.beside(section.paved_width(lanes[0]))[at], whole.beside(-section.paved_width(lanes[1]))[at]])
        for at, lanes in ((0, near), (-1, far))
    ]
    found = RoadMap(tuple(lanes), edges_of(area, ends), outlines_of(area))
    return mirrored(found) if left_hand else found


def _check(
    length: float, forward: int, backward: int, bends: Sequence[tuple[float, float]], change: LaneChange | None
) -> None:
    if not 10.0 <= length <= 20_000.0:
        raise InputError(f"a road is {length:g} m long; give 10 to 20000")
    if not (0 <= forward <= 6 and 0 <= backward <= 6 and forward + backward):
        raise InputError(f"a road has {forward} lanes forward and {backward} backward; give 0 to 6, not 0 and 0")
    knots = np.array(bends, dtype=np.float64)
    if knots.ndim != 2 or knots.shape[1] != 2 or not np.isfinite(knots).all() or np.any(np.diff(knots[:, 0]) <= 0.0):
        raise InputError("bends of a road are (station, curvature), finite, by increasing station")
    if change is None:
        return
    if abs(change.lanes - forward) != 1 or change.lanes < 1 or forward < 1:
        raise InputError(f"a road of {forward} forward lanes changes to {change.lanes}; give one more or one less")
    if not (change.start >= 10.0 and change.start + 20.0 <= change.end <= length - 10.0):
        raise InputError(
            f"lanes change from {change.start:g} to {change.end:g} m of {length:g} m; give 20 m or more, and 10 m of "
            "road before and behind"
        )
    around = np.linspace(change.start - _STRAIGHT_BESIDE, change.end + _STRAIGHT_BESIDE, 200)
    if np.any(np.interp(around, *knots.T) != 0.0):
        raise InputError(f"the road bends between {change.start:g} and {change.end:g} m, where its lanes change")


def _course(start: Place, first: float, last: float, bends: Sequence[tuple[float, float]]) -> Course:
    """The reference line from one station to another, from a place."""
    knots = np.array(bends, dtype=np.float64).T
    stations = [first, *(knot for knot in knots[0] if first < knot < last), last]
    curvatures = np.interp(stations, *knots)
    pieces = [
        (station[1] - station[0], bend[0], bend[1])
        for station, bend in zip(pairwise(stations), pairwise(curvatures), strict=True)
    ]
    return follow(start, pieces)


def _changing(
    section: CrossSection,
    forward: int,
    change: LaneChange,
    length: float,
    bends: Sequence[tuple[float, float]],
    divider: Marking,
) -> list[Lane]:
    """The forward lanes before, within and behind a change."""
    before = _course(Place(0.0, 0.0, 0.0), 0.0, change.start, bends)
    x, y = before.points[-1].tolist()
    start = Place(x, y, float(before.headings[-1]))
    end = start.at(change.end - change.start)
    behind = _course(end, change.end, length, bends)
    first = lay_side(before, section, forward, "forward", divider, against=False)
    last = lay_side(behind, section, change.lanes, "after", divider, against=False)
    strips = [_centers(section, lanes) for lanes in (forward, change.lanes)]
    pairs = [(str(lane), str(min(lane, change.lanes - 1))) for lane in range(forward)]
    pairs += [(str(forward - 1), str(lane)) for lane in range(forward, change.lanes)]
    pairs += [(name, name) for name in strips[0] if not name.isdigit()]
    ways = [_shift(section, start, end, strips, pair) for pair in pairs]
    ways = _marked(ways, min(forward, change.lanes), divider)
    names: dict[str, list[str]] = {}
    for way in ways:
        names.setdefault(way.id.split(">")[0], []).append(way.id)
    return [*(replace(lane, successors=tuple(names[lane.id])) for lane in first), *ways, *last]


def _centers(section: CrossSection, lanes: int) -> dict[str, tuple[float, float]]:
    """By lane, how far right of the dividing line its centre is, and half its width."""
    found, inner = dict[str, tuple[float, float]](), 0.0
    for name, _, width in section.strips(lanes):
        found[name] = (inner + width / 2.0, width / 2.0)
        inner += width
    return found


def _shift(
    section: CrossSection,
    start: Place,
    end: Place,
    strips: Sequence[dict[str, tuple[float, float]]],
    pair: tuple[str, str],
) -> Lane:
    """The lane that leads from one lane before the change to one behind it; without markings."""
    (right, half), (target, _) = strips[0][pair[0]], strips[1][pair[1]]
    course = connect(start.at(0.0, -right), end.at(0.0, -target))
    lane_id = f"forward_{pair[0]}>after_{pair[1]}"
    check_bends(course, [half], lane_id)
    drops = pair[1] < pair[0]
    kinds: dict[str, LaneType] = {"cycle": "cycle", "shoulder": "shoulder", "sidewalk": "sidewalk"}
    return Lane(
        lane_id,
        course.beside(0.0),
        course.beside(half),
        course.beside(-half),
        (f"after_{pair[1]}",),
        kinds.get(pair[0], "driving"),
        left_neighbours=(),
        right_neighbours=(),
        junction="change",
        yields_to=(f"forward_{pair[1]}>after_{pair[1]}",) if drops else (),
        speed_limit=section.speed_limit if pair[0].isdigit() else None,
    )


def _marked(ways: Sequence[Lane], straight: int, divider: Marking) -> list[Lane]:
    """The ways with their markings; the first `straight` ones lead straight on, the next one shifts."""
    nothing, wear = Marking("none", True), divider.wear
    dashed, solid, kerb = Marking("dashed", True, wear), Marking("solid", False, wear), Marking("kerb", False)
    marked = []
    for n, way in enumerate(ways):
        left = divider if n == 0 else dashed if n < straight else nothing
        right = dashed if n < straight - 1 else nothing if n == straight - 1 else solid
        if n > straight:
            left, right = (kerb if way.type == "sidewalk" else solid), nothing
        marked.append(replace(way, left_marking=left, right_marking=right))
    return marked
