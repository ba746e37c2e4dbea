"""Situations of traffic that comes towards the ego, of parked cars, and off the road."""

import numpy as np

from olt_closed_loop.situations.motions import Motion
from olt_closed_loop.situations.roads import WIDTH, left_hand, two_way
from olt_closed_loop.situations.situation import Situation

_STILL = ((0.0, 0.0),)
_CRUISE = Motion((0.0, 0.0))
_ROAD, _LEFT = two_way(), left_hand()
_AHEAD = "braking does not help against who comes on; AlpaSim and nuPlan count every contact ahead"

ONCOMING = (
    Situation(
        "drifts into the oncoming lane at 8 m/s, head-on with a car at 25 m/s", True, "oncoming lane",
        Motion((0.0, 0.0), speed=((0.0, 8.0),), shifts=((2.0, 5.0, WIDTH),)),
        Motion((200.0, WIDTH), np.pi, ((0.0, 25.0),)), lanes=_ROAD,
    ),
    Situation(
        "overtakes a parked car and meets an oncoming one", True, "oncoming lane",
        Motion((0.0, 0.0), shifts=((2.0, 4.0, WIDTH),)), Motion((120.0, WIDTH), np.pi),
        others=(("automobile", Motion((55.0, -0.3), speed=_STILL)),), lanes=_ROAD,
    ),
    Situation(
        "stops in the oncoming lane and is hit head-on", True, "oncoming lane",
        Motion((0.0, 0.0), speed=((0.0, 10.0), (2.5, 10.0), (4.0, 0.0)), shifts=((1.5, 3.5, WIDTH),)),
        Motion((110.0, WIDTH), np.pi), lanes=_ROAD,
        why="standing is no excuse in the lane of others; nuPlan lets every contact of a standing ego pass",
    ),
    Situation(
        "hits an oncoming car with a corner that is 1.3 m over the marking", True, "oncoming lane",
        Motion((0.0, 0.0), shifts=((2.0, 4.0, 2.2),)), Motion((120.0, WIDTH), np.pi), lanes=_ROAD,
    ),
    Situation(
        "an oncoming car is over the marking by 1.3 m", False, "lane of the ego", _CRUISE,
        Motion((120.0, WIDTH), np.pi, shifts=((3.5, 5.5, 2.2),)), lanes=_ROAD, why=_AHEAD,
    ),
    Situation(
        "a car drives against its lane", False, "lane of the ego", _CRUISE,
        Motion((120.0, 0.0), np.pi), lanes=_ROAD, why=_AHEAD,
    ),
    Situation(
        "an oncoming car overtakes a lorry in its lane", False, "lane of the ego", _CRUISE,
        Motion((140.0, WIDTH), np.pi, ((0.0, 14.0),), shifts=((1.5, 3.5, WIDTH),)),
        others=(("heavy_truck", Motion((110.0, WIDTH), np.pi, ((0.0, 8.0),))),), lanes=_ROAD, why=_AHEAD,
    ),
    Situation(
        "head-on in the lane of the other, where traffic keeps to the left", True, "oncoming lane",
        Motion((0.0, 0.0), shifts=((2.0, 4.5, -WIDTH),)), Motion((120.0, -WIDTH), np.pi), lanes=_LEFT,
    ),
    Situation(
        "an oncoming car comes over, where traffic keeps to the left", False, "lane of the ego", _CRUISE,
        Motion((120.0, -WIDTH), np.pi, shifts=((3.0, 5.0, -WIDTH),)), lanes=_LEFT, why=_AHEAD,
    ),
    Situation(
        "head-on, without a map", True, "cannot be excluded", _CRUISE, Motion((120.0, 0.0), np.pi),
        why="nothing tells whose lane it is",
    ),
    Situation(
        "an oncoming car swerves into it, without a map", False, "came too late", _CRUISE,
        Motion((120.0, WIDTH), np.pi, shifts=((4.6, 5.8, WIDTH),)), why=_AHEAD,
    ),
)  # fmt: skip

PARKED = (
    Situation(
        "clips the corner of a parked car", True, "avoidable", _CRUISE,
        Motion((60.0, -1.7), speed=_STILL), lanes=_ROAD,
    ),
    Situation(
        "a door is opened 0.6 s before", False, "came too late", _CRUISE,
        Motion((60.0, -0.8), np.pi / 2, _STILL, seen=(5.3, 10.0)), "other_vehicle", lanes=_ROAD,
        others=(("automobile", Motion((59.0, -2.8), speed=_STILL)),),
        why="a driver needs 1.15 s until it brakes; AlpaSim and nuPlan count every contact ahead",
    ),
    Situation(
        "a door has long been open", True, "avoidable", _CRUISE,
        Motion((60.0, -0.8), np.pi / 2, _STILL), "other_vehicle", lanes=_ROAD,
        others=(("automobile", Motion((59.0, -2.8), speed=_STILL)),),
    ),
    Situation(
        "leaves the road into a car on the verge", True, "off the lanes",
        Motion((0.0, 0.0), shifts=((2.0, 5.0, -6.0),)), Motion((70.0, -6.0), speed=_STILL), lanes=_ROAD,
    ),
    Situation(
        "a parked car pulls out in front of it", False, "came too late", _CRUISE,
        Motion((60.0, -2.9), speed=((0.0, 0.0), (5.0, 0.0), (6.0, 2.5)), shifts=((5.0, 6.5, 2.2),)), lanes=_ROAD,
        why="a driver needs 1.15 s until it brakes; AlpaSim and nuPlan count every contact ahead",
    ),
    Situation(
        "pulls out in front of a car from behind", True, "cut in",
        Motion((0.0, -3.2), speed=((0.0, 0.0), (4.0, 0.0), (6.0, 5.0)), shifts=((4.4, 5.8, 3.2),)),
        Motion((-82.5, 0.0), speed=((0.0, 14.0),)), lanes=_ROAD,
        why="the car behind had no time to brake; AlpaSim and nuPlan let every hit from behind pass",
    ),
)  # fmt: skip
