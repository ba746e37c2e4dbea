"""Who goes first where ways through a junction meet (right-hand traffic)."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from olt_closed_loop.scenes.maps.lanes import Control

# Whose traffic goes first by what its arm shows; equal numbers are settled by where they come from.
_RANKS: dict[Control | None, int] = {"priority": 0, "light": 0, None: 1, "yield": 2, "stop": 2}


class Way(NamedTuple):
    """A way through a junction: its lane, the arms it leads from and to, and how it turns."""

    lane: str
    start: int
    end: int
    turn: str


def yielding(
    ways: Sequence[Way],
    conflicts: Mapping[str, Sequence[str]],
    controls: Sequence[Control | None],
    turns: Mapping[tuple[int, int], str],
    from_left: bool = False,
) -> dict[str, tuple[str, ...]]:
    """The lanes to which each way yields.

    What an arm shows decides first. Among equals who turns left yields to oncoming traffic, who turns yields to who
    goes straight beside it, and else one gives way to the right.

    Args:
        ways: all ways.
        conflicts: by lane, those with which it conflicts.
        controls: by arm.
        turns: by pair of arms, how one turns from the first into the second.
        from_left: give way to the left instead, which is the right in the mirror.
    """
    by_lane = {way.lane: way for way in ways}
    return {
        way.lane: tuple(
            other
            for other in conflicts[way.lane]
            if other in by_lane and _yields(way, by_lane[other], controls, turns, from_left)
        )
        for way in ways
    }


def _yields(
    way: Way,
    other: Way,
    controls: Sequence[Control | None],
    turns: Mapping[tuple[int, int], str],
    from_left: bool,
) -> bool:
    ranks = _RANKS[controls[way.start]], _RANKS[controls[other.start]]
    if ranks[0] != ranks[1]:
        return ranks[0] > ranks[1]
    if way.start == other.start:
        return way.turn != "straight" and other.turn == "straight"
    met = turns[way.start, other.start]
    if met == "straight":
        return way.turn == "left" and other.turn != "left"
    return met == ("left" if from_left else "right")
