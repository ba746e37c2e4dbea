"""Roundabouts: a ring of one lane that its arms lead into and out of."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from olt_closed_loop.scenes.maps.arms import Arm, crossing, far_end, lay_arm, stop_line
from olt_closed_loop.scenes.maps.courses import LEAD, Course, Place, connect, meet, turn_between
from olt_closed_loop.scenes.maps.cross_sections import check_bends, varying
from olt_closed_loop.scenes.maps.frames import mirrored
from olt_closed_loop.scenes.maps.lanes import Lane, Marking
from olt_closed_loop.scenes.maps.road_map import RoadMap
from olt_closed_loop.scenes.maps.surfaces import edges_of, outlines_of, paved_area
from olt_generator.errors import InputError

_OPENINGS = np.radians(np.arange(5.0, 80.5, 0.5))
"""Angles between an arm and where its ways meet the ring that are tried, the smallest first."""
_LONGEST_ARC = np.radians(90.0)
_SHORTEST_SECTION = 2.0
_NOTHING = Marking("none", True)


@dataclass(frozen=True)
class _Node:
    """A place on the ring: where an arm is left to, where one comes in from, or only where the ring is cut."""

    angle: float
    kind: Literal["exit", "entry", "cut"]
    arm: int = -1


def roundabout(
    arms: Sequence[Arm],
    radius: float = 18.0,
    ring_width: float = 5.0,
    turn_radius: float = 8.0,
    left_hand: bool = False,
    name: str = "roundabout",
) -> RoadMap:
    """A roundabout around the origin; those who come in yield to those on the ring.

    Lanes of arms are named as at junctions; the ring is `ring_0`, `ring_1`, ..., ways in are `arm0_in_0>ring_1`, ways
    out `ring_0>arm0_out_0`.

    Args:
        arms: two or more of at most one lane in each direction.
        radius: of the centre of the ring's lane, metres.
        ring_width: of the ring's lane, metres.
        turn_radius: least radius of the ways in and out, metres.
        left_hand: traffic keeps to the left (the mirror image at the x axis).
        name: id of the junction.

    Raises:
        InputError: an arm has more lanes, or the ring has no room for the arms.
    """
    _check(arms, radius, ring_width, turn_radius)
    arms = [replace(arm, control="yield") for arm in arms]
    nodes, mouths = _place_nodes(arms, radius, turn_radius)
    laid = [lay_arm(arm, f"arm{k}", mouths[k]) for k, arm in enumerate(arms)]
    lanes = {lane.id: lane for part, _ in laid for lane in part}
    areas: list[BaseGeometry] = []
    for lane, area in _ring(arms, nodes, mouths, radius, ring_width, name):
        lanes[lane.id] = lane
        areas.append(area)
        if lane.id.startswith("arm"):
            entered = lane.id.split(">")[0]
            lanes[entered] = replace(lanes[entered], successors=(lane.id,))
    conflicts = RoadMap(tuple(lanes.values())).conflicts
    for lane_id, lane in lanes.items():
        if lane.junction is not None:
            lanes[lane_id] = replace(lane, yields_to=conflicts[lane_id] if lane_id.startswith("arm") else ())
    area = paved_area(lanes.values(), areas)
    if area.geom_type != "Polygon":
        raise InputError("arms of the roundabout do not reach its ring; this is a fault of its layout")
    ends = [far_end(arm, course) for arm, (_, course) in zip(arms, laid, strict=True)]
    named = [(arm, f"arm{k}", mouths[k]) for k, arm in enumerate(arms)]
    across = [
        tuple(lane for lane in lanes if lane.startswith(f"arm{k}_in_0>") or lane.endswith(f">arm{k}_out_0"))
        for k in range(len(arms))
    ]
    found = RoadMap(
        tuple(lanes.values()),
        edges_of(area, ends),
        outlines_of(area),
        tuple(line for one in named if (line := stop_line(*one))),
        tuple(place for one, over in zip(named, across, strict=True) if (place := crossing(*one, over))),
    )
    return mirrored(found) if left_hand else found


def _check(arms: Sequence[Arm], radius: float, ring_width: float, turn_radius: float) -> None:
    if len(arms) < 2:
        raise InputError(f"a roundabout of {len(arms)} arms; give two or more")
    if not (any(arm.inbound for arm in arms) and any(arm.outbound for arm in arms)):
        raise InputError("nothing leads through the roundabout; give an arm a lane in and one a lane out")
    if not (3.0 <= ring_width <= 10.0 and 4.0 <= turn_radius <= 50.0 and ring_width + 2.0 <= radius <= 200.0):
        raise InputError(
            f"a roundabout of radius {radius:g} m, ring width {ring_width:g} m and turn radius {turn_radius:g} m; give "
            "a ring of 3 to 10 m, ways of 4 to 50 m and a radius of up to 200 m, 2 m more than the ring's width"
        )
    for k, arm in enumerate(arms):
        if max(arm.inbound, arm.outbound) > 1:
            raise InputError(f"arm {k} has more than one lane in a direction; the ring of a roundabout has one lane")
        if arm.control not in (None, "yield"):
            raise InputError(f"arm {k} has control {arm.control}; at a roundabout those who come in yield")


def _on_ring(angle: float, radius: float) -> Place:
    """The place on the ring at an angle, that looks counter-clockwise along it."""
    return Place(radius * float(np.cos(angle)), radius * float(np.sin(angle)), angle + np.pi / 2.0)


def _place_nodes(arms: Sequence[Arm], radius: float, turn_radius: float) -> tuple[list[_Node], list[float]]:
    """The places on the ring in the order of the drive, and how far from the centre each arm has its mouth."""
    order = sorted(range(len(arms)), key=lambda k: float(np.remainder(arms[k].heading, 2.0 * np.pi)))
    nodes, mouths = list[_Node](), [0.0] * len(arms)
    for k in order:
        arm, heading = arms[k], float(np.remainder(arms[k].heading, 2.0 * np.pi))
        if arm.outbound:
            opening, mouth = _opening(arm, radius, turn_radius, k, inbound=False)
            nodes.append(_Node(heading - opening, "exit", k))
            mouths[k] = max(mouths[k], mouth)
        if arm.inbound:
            opening, mouth = _opening(arm, radius, turn_radius, k, inbound=True)
            nodes.append(_Node(heading + opening, "entry", k))
            mouths[k] = max(mouths[k], mouth)
    whole: list[_Node] = []
    for node, after in zip(nodes, [*nodes[1:], replace(nodes[0], angle=nodes[0].angle + 2.0 * np.pi)], strict=True):
        gap = after.angle - node.angle
        if gap * radius < _SHORTEST_SECTION:
            raise InputError(
                f"the ring of {radius:g} m has no room between arms {node.arm} and {after.arm}; give a larger radius, "
                "a smaller turn_radius or arms farther apart"
            )
        count = int(np.ceil(gap / _LONGEST_ARC))
        whole += [node, *(_Node(node.angle + gap * i / count, "cut") for i in range(1, count))]
    return whole, mouths


def _opening(arm: Arm, radius: float, turn_radius: float, k: int, inbound: bool) -> tuple[float, float]:
    """The smallest angle between arm and node that gives a way its radius, and how far out the way then starts."""
    left = arm.inbound_left(0) if inbound else arm.outbound_left(0)
    heading = float(np.remainder(arm.heading, 2.0 * np.pi))
    for opening in _OPENINGS.tolist():
        if inbound:
            node = _on_ring(heading + opening, radius)
            turn = abs(turn_between(arm.inward(0.0, left), node))
            on_arm, on_ring = meet(arm.inward(0.0, left), node)
        else:
            node = _on_ring(heading - opening, radius)
            turn = abs(turn_between(node, arm.outward(0.0, left)))
            on_ring, on_arm = meet(node, arm.outward(0.0, left))
        tangent = turn_radius * np.tan(turn / 2.0)
        if on_ring - LEAD >= tangent:
            return opening, float(on_ring - LEAD - on_arm + arm.lead)
    raise InputError(f"arm {k} cannot meet a ring of {radius:g} m with ways of {turn_radius:g} m; give a larger radius")


def _ring(
    arms: Sequence[Arm], nodes: Sequence[_Node], mouths: Sequence[float], radius: float, ring_width: float, name: str
) -> list[tuple[Lane, BaseGeometry]]:
    """The lanes of the ring and the ways in and out, each with its pavement."""
    shoulder = max(arm.section.shoulder for arm in arms)
    half_ring, laid = ring_width / 2.0, list[tuple[Lane, BaseGeometry]]()
    for n, node in enumerate(nodes):
        here, nearest = _on_ring(node.angle, radius), (n + 1) % len(nodes)
        after = nodes[nearest]
        leaves = (f"ring_{n}>arm{after.arm}_out_0",) if after.kind == "exit" else ()
        course = connect(here, _on_ring(after.angle, radius))
        laid.append(
            _lane(f"ring_{n}", course, (half_ring, half_ring), (shoulder, shoulder), (f"ring_{nearest}", *leaves), name)
        )
        if node.kind == "cut":
            continue
        arm = arms[node.arm]
        half_arm, beside = arm.section.lane_width / 2.0, arm.section.paved_width(1) - arm.section.lane_width
        if node.kind == "entry":
            course = connect(arm.inward(mouths[node.arm], arm.inbound_left(0)), here, (arm.lead, LEAD))
            lane = f"arm{node.arm}_in_0>ring_{n}", course, (half_arm, half_ring), (beside, shoulder), (f"ring_{n}",)
        else:
            course = connect(here, arm.outward(mouths[node.arm], arm.outbound_left(0)), (LEAD, arm.lead))
            before = (n - 1) % len(nodes)
            out = f"arm{node.arm}_out_0"
            lane = f"ring_{before}>{out}", course, (half_ring, half_arm), (shoulder, beside), (out,)
        laid.append(_lane(*lane, name))
    return laid


def _lane(
    lane_id: str,
    course: Course,
    halves: tuple[float, float],
    shoulders: tuple[float, float],
    successors: tuple[str, ...],
    name: str,
) -> tuple[Lane, BaseGeometry]:
    """A lane whose half width and shoulder change along it, and its pavement."""
    outside = [half + shoulder for half, shoulder in zip(halves, shoulders, strict=True)]
    check_bends(course, outside, lane_id)
    half, outer = varying(course, *halves), varying(course, outside[0], outside[1])
    left, right = course.beside(half), course.beside(-half)
    pavement = shapely.Polygon(np.concatenate([left, course.beside(-outer, reverse=True)])[:, :2])
    lane = Lane(
        lane_id,
        course.beside(0.0),
        left,
        right,
        successors,
        "driving",
        left_neighbours=(),
        right_neighbours=(),
        left_marking=_NOTHING,
        right_marking=_NOTHING,
        junction=name,
    )
    return lane, pavement
