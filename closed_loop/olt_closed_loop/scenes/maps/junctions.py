"""Junctions of any number of arms at any angles, with everything that leads through them."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np
import shapely

from olt_closed_loop.scenes.maps.arms import Arm, crossing, far_end, lay_arm, stop_line
from olt_closed_loop.scenes.maps.courses import Course, connect, meet, turn_between
from olt_closed_loop.scenes.maps.cross_sections import check_bends, varying
from olt_closed_loop.scenes.maps.frames import mirrored
from olt_closed_loop.scenes.maps.lanes import Lane, LaneType, Marking
from olt_closed_loop.scenes.maps.right_of_way import Way, yielding
from olt_closed_loop.scenes.maps.road_map import RoadMap
from olt_closed_loop.scenes.maps.surfaces import edges_of, outlines_of, paved_area
from olt_generator.errors import InputError

LEAST_RADIUS = 4.0
_LEAST_ANGLE = np.radians(25.0)
_STRAIGHT_ON = np.radians(30.0)
_HARDLY_TURNS = np.radians(10.0)
_KERB_RADIUS = 1.0
_NOTHING = Marking("none", True)


def junction(arms: Sequence[Arm], turn_radius: float = 8.0, left_hand: bool = False, name: str = "junction") -> RoadMap:
    """A junction around the origin.

    Arms are numbered as given, lanes from the dividing line outwards: `arm0_in_0`, `arm0_out_0`, and the ways through
    are `arm0_in_0>arm1_out_0`. Left-hand traffic is the mirror image at the x axis, so arms are seen in the mirror too.

    Args:
        arms: two or more, at least 25 degrees between two of them.
        turn_radius: least radius of the centre of a way that turns, metres.
        left_hand: traffic keeps to the left.
        name: id of the junction.

    Raises:
        InputError: the arms are too few or too close, the radius is below 4 m, or a way cannot be laid.
    """
    order = _check_arms(arms, turn_radius)
    turns = {(i, j): _turn(arms[i], arms[j]) for i, j in permutations(range(len(arms)), 2)}
    pairs = list(_pair_lanes(arms, turns))
    if not pairs:
        raise InputError("nothing leads through the junction; give lanes in and out, and turns from one to the other")
    mouths = _mouths(arms, order, pairs, turn_radius)
    laid = [lay_arm(arm, f"arm{k}", mouths[k]) for k, arm in enumerate(arms)]
    ways, through = [], []
    for start, end, kind in pairs:
        lane = _way(arms, mouths, start, end, kind, name)
        ways.append(Way(lane.id, start[0], end[0], turns[start[0], end[0]]))
        through.append(lane)
    kerbs = _kerbs(arms, order, mouths)
    through += _corners(arms, kerbs)
    road_map = RoadMap((*_linked([lane for lanes, _ in laid for lane in lanes], through), *through))
    yields = yielding(ways, road_map.conflicts, [arm.control for arm in arms], turns, from_left=left_hand)
    lanes = tuple(replace(lane, yields_to=yields.get(lane.id)) for lane in road_map.lanes)
    middle = shapely.Polygon(np.concatenate([kerb.points for kerb in kerbs.values()]))
    if not middle.is_valid:
        raise InputError("the kerbs of the junction cross each other; give its arms more room between them")
    area = paved_area(lanes, [middle])
    if not isinstance(area, shapely.Polygon) or area.interiors:
        raise InputError("arms of the junction run into each other; make them shorter or bend them less")
    ends = [far_end(arm, course) for arm, (_, course) in zip(arms, laid, strict=True)]
    named = [(arm, f"arm{k}", mouths[k]) for k, arm in enumerate(arms)]
    across = [tuple(way.lane for way in ways if k in (way.start, way.end)) for k in range(len(arms))]
    found = RoadMap(
        lanes,
        edges_of(area, ends),
        outlines_of(area),
        tuple(line for one in named if (line := stop_line(*one))),
        tuple(place for one, over in zip(named, across, strict=True) if (place := crossing(*one, over))),
    )
    return mirrored(found) if left_hand else found


def _check_arms(arms: Sequence[Arm], turn_radius: float) -> list[int]:
    """The arms in counter-clockwise order."""
    if not LEAST_RADIUS <= turn_radius <= 100.0:
        raise InputError(f"turn_radius is {turn_radius:g} m; ways through a junction have 4 to 100 m")
    if len(arms) < 2:
        raise InputError(f"a junction of {len(arms)} arms; give two or more")
    headings = np.remainder([arm.heading for arm in arms], 2.0 * np.pi)
    order = np.argsort(headings, kind="stable")
    between = np.diff(headings[order], append=headings[order[0]] + 2.0 * np.pi)
    if between.min() < _LEAST_ANGLE:
        one = int(np.argmin(between))
        other = (one + 1) % len(arms)
        raise InputError(
            f"arms {order[one]} and {order[other]} are {np.degrees(between[one]):.0f} degrees apart; give 25 or more"
        )
    return order.tolist()


def _turn(start: Arm, end: Arm) -> str:
    angle = turn_between(start.inward(0.0), end.outward(0.0))
    return "straight" if abs(angle) <= _STRAIGHT_ON else ("left" if angle > 0.0 else "right")


LaneOfArm = tuple[int, str]
Pair = tuple[LaneOfArm, LaneOfArm, LaneType]


def _pair_lanes(arms: Sequence[Arm], turns: dict[tuple[int, int], str]) -> Iterator[Pair]:
    """Which inbound lanes lead to which outbound lanes: (arm, lane), (arm, lane), kind."""
    driving = [pair for pair in permutations(range(len(arms)), 2) for pair in _lanes_between(arms, *pair, turns)]
    driving += _left_out(arms, driving, turns)
    for i, lane, j, target in sorted(driving):
        yield (i, str(lane)), (j, str(target)), "driving"
    for (i, j), turn in turns.items():
        if arms[i].section.cycle_width and arms[j].section.cycle_width and turn in set(arms[i].turns) - {"left"}:
            yield (i, "cycle"), (j, "cycle"), "cycle"


Link = tuple[int, int, int, int]


def _lanes_between(arms: Sequence[Arm], i: int, j: int, turns: dict[tuple[int, int], str]) -> list[Link]:
    """The lanes that lead from one arm to another: the outermost to the right, the innermost to the left."""
    inbound, outbound, turn = arms[i].inbound, arms[j].outbound, turns[i, j]
    if inbound == 0 or outbound == 0 or turn not in arms[i].turns:
        return []
    if turn == "right":
        return [(i, inbound - 1, j, outbound - 1)]
    if turn == "left":
        return [(i, 0, j, 0)]
    return [(i, lane, j, lane) for lane in range(min(inbound, outbound))]


def _left_out(arms: Sequence[Arm], links: list[Link], turns: dict[tuple[int, int], str]) -> list[Link]:
    """Links for lanes that none of the others serves: they go where the lane beside them goes, or come from there."""
    added: list[Link] = []
    for k, arm in enumerate(arms):
        for side, count in ((0, arm.inbound), (2, arm.outbound)):
            served = {link[side + 1] for link in links if link[side] == k}
            for lane in sorted(set(range(count)) - served) if served else ():
                beside = min(served, key=lambda other: (abs(other - lane), other))
                likely = [link for link in links if link[side : side + 2] == (k, beside)]
                link = list(min(likely, key=lambda one: (turns[one[0], one[2]] != "straight", one)))
                link[side + 1] = lane
                added.append((link[0], link[1], link[2], link[3]))
    return sorted(set(added) - set(links))


def _position(arm: Arm, lane: str, inbound: bool) -> tuple[float, float]:
    """How far left of the dividing line a lane has its centre, and its width."""
    section, lanes = arm.section, arm.inbound if inbound else arm.outbound
    if lane == "cycle":
        left, width = lanes * section.lane_width + section.cycle_width / 2.0, section.cycle_width
    else:
        left, width = section.lane_offset(int(lane)), section.lane_width
    return (left if inbound else -left), width


def _mouths(arms: Sequence[Arm], order: list[int], pairs: Sequence[Pair], radius: float) -> list[float]:
    """How far from the centre each arm ends, so that every way and every kerb has room."""
    mouths = [arm.lead + 2.0 for arm in arms]

    def make_room(i: int, j: int, lefts: tuple[float, float], least: float) -> None:
        start, end = arms[i].inward(0.0, lefts[0]), arms[j].outward(0.0, lefts[1])
        turn = abs(turn_between(start, end))
        if turn < _HARDLY_TURNS:
            aside = abs(lefts[0] + arms[i].offset + lefts[1] + arms[j].offset) + 10.0 * turn
            # A quintic shift by `aside` over a length has a radius of at least length^2 / (5.8 aside).
            needed = [0.5 * np.sqrt(5.8 * aside * least) + 1.0] * 2
        else:
            ahead, behind = meet(start, end)
            needed = [least * np.tan(turn / 2.0) - ahead, least * np.tan(turn / 2.0) - behind]
        for k, room in zip((i, j), needed, strict=True):
            mouths[k] = max(mouths[k], float(room) + arms[k].lead)

    for (i, lane), (j, target), _ in pairs:
        make_room(i, j, (_position(arms[i], lane, True)[0], _position(arms[j], target, False)[0]), radius)
    for i, j in zip(order, [*order[1:], order[0]], strict=True):
        least = _KERB_RADIUS + _sidewalk_width(arms[i], arms[j])
        make_room(i, j, (arms[i].inbound_edge, arms[j].outbound_edge), least)
    return mouths


def _way(
    arms: Sequence[Arm], mouths: Sequence[float], start: LaneOfArm, end: LaneOfArm, kind: LaneType, name: str
) -> Lane:
    """The lane that leads through the junction."""
    (i, lane), (j, target) = start, end
    (left_in, width_in), (left_out, width_out) = _position(arms[i], lane, True), _position(arms[j], target, False)
    course = connect(arms[i].inward(mouths[i], left_in), arms[j].outward(mouths[j], left_out), _leads(arms, i, j))
    lane_id = f"arm{i}_in_{lane}>arm{j}_out_{target}"
    check_bends(course, [width_in / 2.0, width_out / 2.0], lane_id)
    half = varying(course, width_in / 2.0, width_out / 2.0)
    lines = course.beside(0.0), course.beside(half), course.beside(-half)
    return Lane(
        lane_id,
        *lines,
        (f"arm{j}_out_{target}",),
        kind,
        left_neighbours=(),
        right_neighbours=(),
        left_marking=_NOTHING,
        right_marking=_NOTHING,
        junction=name,
    )


def _leads(arms: Sequence[Arm], i: int, j: int) -> tuple[float, float]:
    return arms[i].lead, arms[j].lead


def _linked(lanes: list[Lane], through: list[Lane]) -> list[Lane]:
    """The lanes of the arms with the ways that follow them."""
    after: dict[str, list[str]] = {}
    for way in through:
        after.setdefault(way.id.split(">")[0], []).append(way.id)
    return [replace(lane, successors=tuple(after.get(lane.id, ()))) for lane in lanes]


def _kerbs(arms: Sequence[Arm], order: list[int], mouths: Sequence[float]) -> dict[tuple[int, int], Course]:
    """The kerbs from each arm to the next one, counter-clockwise around the junction."""
    return {
        (i, j): connect(
            arms[i].inward(mouths[i], arms[i].inbound_edge),
            arms[j].outward(mouths[j], arms[j].outbound_edge),
            _leads(arms, i, j),
        )
        for i, j in zip(order, [*order[1:], order[0]], strict=True)
    }


def _sidewalk_width(start: Arm, end: Arm) -> float:
    """The larger width of the sidewalks that meet at the corner between two arms; 0 unless both have one."""
    widths = start.section.sidewalk_width, end.section.sidewalk_width
    return max(widths) if min(widths) > 0.0 else 0.0


def _corners(arms: Sequence[Arm], kerbs: dict[tuple[int, int], Course]) -> Iterator[Lane]:
    """The sidewalks around the corners."""
    for (i, j), kerb in kerbs.items():
        if _sidewalk_width(arms[i], arms[j]) == 0.0:
            continue
        whole = varying(kerb, arms[i].section.sidewalk_width, arms[j].section.sidewalk_width)
        yield Lane(
            f"arm{i}_in_sidewalk>arm{j}_out_sidewalk",
            kerb.beside(-0.5 * whole),
            kerb.beside(0.0),
            kerb.beside(-whole),
            (f"arm{j}_out_sidewalk",),
            "sidewalk",
            left_neighbours=(),
            right_neighbours=(),
            left_marking=Marking("kerb", False),
            right_marking=Marking("none", False),
        )
