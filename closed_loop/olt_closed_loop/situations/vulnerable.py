"""Situations with people, cyclists and animals."""

import numpy as np

from olt_closed_loop.situations.motions import Motion
from olt_closed_loop.situations.roads import WIDTH, two_way
from olt_closed_loop.situations.situation import Situation

_STILL = ((0.0, 0.0),)
_CRUISE = Motion((0.0, 0.0))
_ROAD = two_way()
_LATE = "a driver needs 1.15 s until it brakes; AlpaSim and nuPlan count every contact ahead"

VULNERABLE = (
    Situation(
        "a person crosses in plain view", True, "vulnerable", _CRUISE,
        Motion((60.0, -7.0), np.pi / 2, ((0.0, 1.2),)), "person", lanes=_ROAD,
        why="it was in view for seconds; at nuPlan's sample it is past the bumper",
    ),
    Situation(
        "a person steps out from behind a van", False, "unavoidable", _CRUISE,
        Motion((60.0, -17.4), np.pi / 2, ((0.0, 3.0),)), "person",
        others=(("heavy_truck", Motion((53.5, -3.6), speed=_STILL)),), lanes=_ROAD, why=_LATE,
    ),
    Situation(
        "a person steps off the kerb 0.7 s before", False, "unavoidable", _CRUISE,
        Motion((60.0, -2.4), np.pi / 2, ((0.0, 0.0), (5.1, 0.0), (5.2, 2.5))), "person", lanes=_ROAD, why=_LATE,
    ),
    Situation(
        "a person stands on the road", True, "vulnerable", _CRUISE, Motion((60.0, 0.5), speed=_STILL), "person",
        lanes=_ROAD,
    ),
    Situation(
        "drives at 3 m/s towards a person who walks towards it", True, "vulnerable",
        Motion((0.0, 0.0), speed=((0.0, 3.0),)), Motion((24.0, 0.0), np.pi, ((0.0, 1.2),)), "person", lanes=_ROAD,
    ),
    Situation(
        "overtakes a cyclist and drifts into it", True, "vulnerable",
        Motion((0.0, 0.9), shifts=((4.0, 6.5, -1.6),)), Motion((27.0, -1.2), speed=((0.0, 5.0),)), "rider", lanes=_ROAD,
        why="it moved over; nuPlan lets every contact aside within a lane pass",
    ),
    Situation(
        "overtakes a cyclist, who swerves into it", False, "unavoidable", Motion((0.0, 0.9)),
        Motion((27.0, -1.5), speed=((0.0, 5.0),), shifts=((5.2, 5.9, 1.8),)), "rider", lanes=_ROAD,
        why="it swerved when nobody could brake any more; AlpaSim counts every contact aside",
    ),
    Situation(
        "runs into a cyclist ahead", True, "vulnerable", _CRUISE, Motion((30.0, -0.5), speed=((0.0, 4.0),)), "rider",
        lanes=_ROAD,
    ),
    Situation(
        "a deer jumps onto the road", False, "unavoidable", _CRUISE,
        Motion((60.0, -4.5), np.pi / 2, ((0.0, 0.0), (5.1, 0.0), (5.4, 8.0))), "animal", lanes=_ROAD, why=_LATE,
    ),
    Situation(
        "a deer stands on the road", True, "vulnerable", _CRUISE,
        Motion((60.0, 0.0), np.pi / 2, _STILL), "animal", lanes=_ROAD,
    ),
    Situation(
        "meets a cyclist in the oncoming lane", True, "oncoming lane",
        Motion((0.0, 0.0), shifts=((2.0, 4.0, WIDTH),)), Motion((90.0, WIDTH), np.pi, ((0.0, 5.0),)), "rider",
        lanes=_ROAD,
    ),
)  # fmt: skip
