"""Situations of crossing, turning, merging and roundabouts."""

import numpy as np

from olt_closed_loop.situations.motions import Motion
from olt_closed_loop.situations.roads import CROSSING, RING, WIDTH, junction, merge, roundabout, two_way
from olt_closed_loop.situations.situation import Situation

_CRUISE = Motion((0.0, 0.0))
_FROM_SOUTH = Motion((CROSSING, -63.0), np.pi / 2)
_ROAD = two_way()
_GREEN, _RED = (), ((0.0, 10.0),)
_SIDE = "AlpaSim counts every contact ahead or aside"

CROSSINGS = (
    Situation(
        "crosses in front of traffic and is hit in the side", True, "avoidable", _CRUISE, _FROM_SOUTH, lanes=_ROAD,
        why="nothing shows that the ego had the right of way, and it could have braked; nuPlan lets it pass",
    ),
    Situation(
        "crosses slowly in front of a fast car and is hit in the side", True, "avoidable",
        Motion((40.0, 0.0), speed=((0.0, 3.0),)), Motion((CROSSING, -105.0), np.pi / 2, ((0.0, 15.0),)), lanes=_ROAD,
        why="nothing shows that the ego had the right of way, and it could have braked; nuPlan lets it pass",
    ),
    Situation(
        "stops in the way of a fast crossing car 2.2 s before", True, "avoidable",
        Motion((0.0, 0.0), speed=((0.0, 10.0), (3.0, 10.0), (4.2, 0.0))),
        Motion((36.0, -198.0), np.pi / 2, ((0.0, 30.0),)), lanes=_ROAD,
        why="the car had no time to brake; nuPlan lets every contact of a standing ego pass",
    ),
    Situation(
        "drives into the side of a crossing car", True, "avoidable", _CRUISE,
        Motion((CROSSING, -55.0), np.pi / 2), lanes=junction(),
    ),
    Situation(
        "drives into the side of a crossing car, without a map", True, "avoidable", _CRUISE,
        Motion((CROSSING, 55.0), -np.pi / 2),
    ),
    Situation(
        "is hit in the side by a car that runs a red light", False, "red light", _CRUISE, _FROM_SOUTH,
        lanes=junction(_GREEN, _RED), why="the lights tell who may drive; " + _SIDE,
    ),
    Situation(
        "runs a red light and is hit in the side", True, "red light", _CRUISE, _FROM_SOUTH,
        lanes=junction(_RED, _GREEN), why="the lights tell who may drive; nuPlan lets it pass",
    ),
    Situation(
        "drives into a car that ran a red light and stands in the way", True, "avoidable", _CRUISE,
        Motion((CROSSING, -25.0), np.pi / 2, ((0.0, 12.0), (2.0, 12.0), (2.2, 0.0))),
        lanes=junction(_GREEN, _RED),
    ),
    Situation(
        "a car starts from the side road 1.3 s before", False, "came too late", _CRUISE,
        Motion((CROSSING, -6.5), np.pi / 2, ((0.0, 0.0), (4.5, 0.0), (6.0, 7.0))), lanes=junction(),
        why="it began to move when nobody could brake any more; " + _SIDE,
    ),
    Situation(
        "an oncoming car turns left across its lane 1.2 s before", False, "lane of the ego", _CRUISE,
        Motion((116.0, WIDTH), np.pi, ((0.0, 10.0), (4.0, 10.0), (5.0, 8.0)), turns=((4.9, 6.0, 1.2),)),
        lanes=junction(), why="it turned when nobody could brake any more; " + _SIDE,
    ),
    Situation(
        "turns left across the lane of an oncoming car", True, "oncoming lane",
        Motion((0.0, 0.0), speed=((0.0, 10.0), (4.0, 10.0), (5.0, 6.0)), turns=((5.2, 7.0, 1.57),)),
        Motion((122.0, WIDTH), np.pi), lanes=junction(),
    ),
    Situation(
        "turns right in front of a cyclist beside it", True, "vulnerable",
        Motion((0.0, 0.0), speed=((0.0, 10.0), (3.0, 8.0), (5.0, 5.0)), turns=((5.5, 7.0, -1.57),)),
        Motion((17.0, -2.2), speed=((0.0, 5.0),)), "rider", lanes=_ROAD,
        why="who turns gives way to who goes on",
    ),
)  # fmt: skip

_ON_RING = Motion(
    (CROSSING - RING, RING + 15.0),
    -np.pi / 2,
    ((0.0, 8.0),),
    turns=((1.75, 1.75 + np.pi / 2 * RING / 8.0, np.pi / 2),),
)
_ENTERS = Motion((20.0, -6.0), speed=((0.0, 8.0),), shifts=((3.0, 5.5, 5.5),))
MERGING = (
    Situation(
        "enters a roundabout in front of a car that circulates", True, "lane of the agent",
        _ENTERS,
        _ON_RING,
        lanes=roundabout(),
    ),
    Situation(
        "circulates in a roundabout and is hit by a car that enters", False, "lane of the ego",
        _ON_RING,
        _ENTERS,
        lanes=roundabout(), why="the ring is the ego's lane; " + _SIDE,
    ),
    Situation(
        "merges into the car beside it", True, "moved over",
        Motion((0.0, -WIDTH), speed=((0.0, 15.0),), shifts=((4.0, 8.0, WIDTH),)),
        Motion((1.0, 0.0), speed=((0.0, 15.0),)), lanes=merge(),
    ),
    Situation(
        "a car merges into its side", False, "moved over", Motion((0.0, 0.0), speed=((0.0, 15.0),)),
        Motion((1.0, -WIDTH), speed=((0.0, 15.0),), shifts=((4.0, 8.0, WIDTH),)), lanes=merge(),
        why="the one that merges gives way; " + _SIDE,
    ),
)  # fmt: skip
