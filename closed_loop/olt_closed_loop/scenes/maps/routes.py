"""Ways along lanes: the shortest sequence of lanes, and the line along them."""

import heapq
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from olt_closed_loop.scenes.maps.lanes import Lane
from olt_closed_loop.scenes.polylines import length_of, resample, without_repeats
from olt_generator.errors import InputError
from olt_generator.poses import Array

SHORTEST_CHANGE = 20.0
"""Metres that a lane must be long to change to the one beside it."""
_CHANGE_COST = 30.0


def find_route(lanes: Mapping[str, Lane], start: str, goal: str) -> list[str]:
    """The ids of the lanes of the shortest way; a change of lanes counts as 30 m.

    Raises:
        InputError: no way leads there.
    """
    reached: dict[str, str | None] = {}
    open_: list[tuple[float, str, str | None]] = [(0.0, start, None)]
    while open_:
        cost, lane_id, before = heapq.heappop(open_)
        if lane_id in reached:
            continue
        reached[lane_id] = before
        if lane_id == goal:
            return list(_trace(reached, goal))[::-1]
        lane = lanes[lane_id]
        length = length_of(lane.center)
        following = [(cost + length, other) for other in lane.successors if other in lanes]
        changes = [(cost + _CHANGE_COST, other) for other in lane_changes(lanes, lane)]
        for one in following + changes:
            heapq.heappush(open_, (*one, lane_id))
    raise InputError(f"no way leads from lane {start:.80} to lane {goal:.80}; give an end that can be reached")


def _trace(reached: Mapping[str, str | None], goal: str) -> Iterator[str]:
    lane: str | None = goal
    while lane is not None:
        yield lane
        lane = reached[lane]


def lane_changes(lanes: Mapping[str, Lane], lane: Lane) -> list[str]:
    """The lanes to which one may change from a lane."""
    if length_of(lane.center) < SHORTEST_CHANGE:
        return []
    sides = ((lane.left_neighbours, lane.left_marking), (lane.right_neighbours, lane.right_marking))
    beside = [other for names, marking in sides if names and marking and marking.crossable for other in names]
    return [other for other in beside if other in lanes and lanes[other].for_cars and _same_way(lane, lanes[other])]


def _same_way(lane: Lane, other: Lane) -> bool:
    """Whether two lanes run the same way, by the lines between their ends."""
    one, two = (line.center[-1, :2] - line.center[0, :2] for line in (lane, other))
    return bool(one @ two > 0.0)


def line_along(lanes: Mapping[str, Lane], lane_ids: Sequence[str]) -> Array:
    """The line (n, 3) along the centres of lanes that follow each other or lie beside each other.

    Raises:
        InputError: two of them do neither.
    """
    pieces = [_piece(lanes[group[0]], lanes[group[-1]]) for group in _groups(lanes, lane_ids)]
    return without_repeats(np.concatenate(pieces))


def _groups(lanes: Mapping[str, Lane], lane_ids: Sequence[str]) -> list[list[str]]:
    """Lanes beside each other, through which one changes, together."""
    groups = [[lane_ids[0]]]
    for before, after in pairwise(lane_ids):
        lane = lanes[before]
        if after in lane.successors:
            groups.append([after])
        elif after in (*(lane.left_neighbours or ()), *(lane.right_neighbours or ())) and _same_way(lane, lanes[after]):
            groups[-1].append(after)
        else:
            raise InputError(f"lane {after:.80} neither follows lane {before:.80} nor runs beside it")
    return groups


def _piece(first: Lane, last: Lane) -> Array:
    """The centre of a lane, or the smooth change from one lane to another along their whole length."""
    if first.id == last.id:
        return first.center
    count = max(len(first.center), len(last.center), 1 + int(length_of(first.center)))
    share = np.linspace(0.0, 1.0, count)[:, None]
    blend = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return (1.0 - blend) * resample(first.center, count) + blend * resample(last.center, count)
