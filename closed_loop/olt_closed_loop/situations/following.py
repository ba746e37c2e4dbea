"""Situations of standing, following, cutting in and reversing."""

import numpy as np

from olt_closed_loop.situations.motions import Motion
from olt_closed_loop.situations.roads import WIDTH, two_way
from olt_closed_loop.situations.situation import Situation

_STILL = ((0.0, 0.0),)
_CRUISE = Motion((0.0, 0.0))
_STANDS = Motion((0.0, 0.0), speed=_STILL)
_ROAD, _WIDE = two_way(), two_way(lanes=2)
_TOUCHED = "AlpaSim counts every contact ahead or aside, whoever moved"

STANDING = (
    Situation("stands and is hit from behind", False, "standing", _STANDS, Motion((-60.0, 0.0)), lanes=_ROAD),
    Situation(
        "stands and is hit in front by a car from the other lane", False, "standing", _STANDS,
        Motion((60.0, WIDTH), np.pi, shifts=((3.5, 5.5, WIDTH),)), lanes=_ROAD, why=_TOUCHED,
    ),
    Situation(
        "stands and is hit in the left side", False, "standing", _STANDS,
        Motion((0.0, 60.0), -np.pi / 2), why=_TOUCHED,
    ),
    Situation(
        "stands and is hit in the right side", False, "standing", _STANDS,
        Motion((0.0, -60.0), np.pi / 2), why=_TOUCHED,
    ),
    Situation(
        "stands, its pose noisy by 1 cm, and is touched in front at 1 m/s", False, "standing",
        Motion((0.0, 0.0), speed=_STILL, noise=0.01), Motion((10.0, 0.0), np.pi, ((0.0, 1.0),)),
        why=_TOUCHED + "; nuPlan takes the noise of 0.1 m/s for driving",
    ),
    Situation(
        "stands and a person walks into its side", False, "standing", _STANDS,
        Motion((0.0, 8.0), -np.pi / 2, ((0.0, 1.2),)), "person", why=_TOUCHED,
    ),
    Situation(
        "stands behind a car that is pushed into it", False, "standing", _STANDS,
        Motion((-8.0, 0.0), speed=((0.0, 0.0), (5.0, 0.0), (5.2, 5.0), (7.0, 3.0))),
        others=(("automobile", Motion((-67.0, 0.0), speed=((0.0, 10.8), (5.0, 10.8), (5.2, 5.0), (7.0, 3.0)))),),
        lanes=_ROAD,
    ),
    Situation(
        "creeps at 0.09 m/s into a standing person", True, "vulnerable",
        Motion((0.0, 0.0), speed=((0.0, 0.09),)), Motion((3.2, 0.0), speed=_STILL), "person", lanes=_ROAD,
    ),
    Situation(
        "creeps at 0.06 m/s into a standing car", True, "avoidable",
        Motion((0.0, 0.0), speed=((0.0, 0.06),)), Motion((5.2, 0.0), speed=_STILL), lanes=_ROAD,
    ),
    Situation(
        "a car appears over it", None, "appeared in contact", _CRUISE,
        Motion((1.0, 0.3), seen=(5.0, 10.0)), lanes=_ROAD,
        why="the two were never apart: nobody moved into anybody",
    ),
    Situation(
        "a car is away for 4 s and back on the other side of the road", None, "away", _CRUISE,
        Motion((50.0, 15.0), -np.pi / 2, ((0.0, 3.0),)), lanes=_ROAD, away=(3.0, 7.0),
        why="nobody saw the car on the way of the ego",
    ),
)  # fmt: skip

FOLLOWING = (
    Situation(
        "drives into a standing queue", True, "avoidable", _CRUISE, Motion((60.0, 0.0), speed=_STILL), lanes=_ROAD,
    ),
    Situation(
        "follows 5 m behind a car that brakes hard", True, "avoidable", _CRUISE,
        Motion((9.8, 0.0), speed=((0.0, 10.0), (5.0, 10.0), (6.4, 0.0))), lanes=_ROAD,
    ),
    Situation(
        "is hit from behind by a faster car", False, "rear-ended", _CRUISE,
        Motion((-35.0, 0.0), speed=((0.0, 16.0),)), lanes=_ROAD,
    ),
    Situation(
        "stops hard without cause and is hit from behind", False, "rear-ended",
        Motion((0.0, 0.0), speed=((0.0, 10.0), (5.0, 10.0), (6.4, 0.0))), Motion((-12.0, 0.0)), lanes=_ROAD,
        why="who follows keeps its distance; what stopping costs is seen in the progress",
    ),
    Situation(
        "is hit from behind by a cyclist", False, "rear-ended",
        Motion((0.0, 0.0), speed=((0.0, 3.0),)), Motion((-16.0, 0.0), speed=((0.0, 6.0),)), "rider", lanes=_ROAD,
    ),
    Situation(
        "a car cuts in 20 m ahead, slows to 4 m/s, and is run into", True, "avoidable", _CRUISE,
        Motion((25.0, -WIDTH), speed=((0.0, 10.0), (2.0, 10.0), (4.0, 4.0)), shifts=((1.5, 4.0, WIDTH),)), lanes=_WIDE,
    ),
    Situation(
        "a car cuts in 1 m ahead and brakes hard", False, "came too late", _CRUISE,
        Motion((5.8, -WIDTH), speed=((0.0, 10.0), (5.4, 10.0), (6.4, 3.0)), shifts=((5.0, 6.2, WIDTH),)), lanes=_WIDE,
        why="a driver needs 1.15 s until it brakes; AlpaSim and nuPlan count every contact ahead",
    ),
    Situation(
        "cuts in 5 m ahead of a car that is 8 m/s faster", True, "cut in",
        Motion((0.0, 0.0), shifts=((4.0, 6.0, -WIDTH),)),
        Motion((-51.0, -WIDTH), speed=((0.0, 18.0),)), lanes=_WIDE,
        why="the car behind had no time to brake; nuPlan lets every hit from behind pass",
    ),
    Situation(
        "cuts in 3 m ahead of a car that is 5 m/s faster", True, "cut in",
        Motion((0.0, 0.0), shifts=((4.0, 6.0, -WIDTH),)),
        Motion((-33.0, -WIDTH), speed=((0.0, 15.0),)), lanes=_WIDE,
        why="the car behind had no time to brake; nuPlan lets every hit from behind pass",
    ),
    Situation(
        "cuts in 25 m ahead of a car that is 8 m/s faster and does not brake", False, "rear-ended",
        Motion((0.0, 0.0), shifts=((2.0, 4.0, -WIDTH),)),
        Motion((-55.0, -WIDTH), speed=((0.0, 18.0),)), lanes=_WIDE,
        why="the car behind had seconds to brake",
    ),
    Situation(
        "cuts in 1 m beside a car", True, "lane of the agent",
        Motion((0.0, 0.0), shifts=((4.0, 6.0, -WIDTH),)), Motion((1.0, -WIDTH)), lanes=_WIDE,
    ),
    Situation(
        "drifts into the car beside it", True, "lane of the agent",
        Motion((0.0, 0.0), shifts=((2.0, 9.0, -WIDTH),)), Motion((1.0, -WIDTH)), lanes=_WIDE,
    ),
    Situation(
        "a car drifts into it", False, "lane of the ego", _CRUISE,
        Motion((1.0, -WIDTH), shifts=((2.0, 9.0, WIDTH),)), lanes=_WIDE, why=_TOUCHED,
    ),
    Situation(
        "a car drifts into it, without a map", False, "moved over", _CRUISE,
        Motion((1.0, -WIDTH), shifts=((2.0, 9.0, WIDTH),)), why=_TOUCHED + "; nuPlan needs lanes",
    ),
    Situation(
        "drifts into the car beside it, without a map", True, "moved over",
        Motion((0.0, 0.0), shifts=((2.0, 9.0, -WIDTH),)), Motion((1.0, -WIDTH)),
        why="it closed the gap; nuPlan needs lanes",
    ),
)  # fmt: skip

REVERSING = (
    Situation(
        "drives backwards into a standing car", True, "reversing",
        Motion((0.0, 0.0), speed=((0.0, -1.5),)), Motion((-14.0, 0.0), speed=_STILL), lanes=_ROAD,
        why="who drives backwards gives way; AlpaSim lets every contact behind pass",
    ),
    Situation(
        "drives backwards into a person who walks past", True, "reversing",
        Motion((0.0, 0.0), speed=((0.0, -1.5),)), Motion((-11.0, -6.0), np.pi / 2, ((0.0, 1.1),)), "person",
        lanes=_ROAD, why="who drives backwards gives way; AlpaSim and nuPlan let every contact behind pass",
    ),
    Situation(
        "stands and a car backs into its front", False, "standing", _STANDS,
        Motion((14.0, 0.0), speed=((0.0, -1.5),)), lanes=_ROAD, why=_TOUCHED,
    ),
    Situation(
        "drives on slowly while the car ahead backs into it", False, "agent reversed",
        Motion((0.0, 0.0), speed=((0.0, 2.0),)),
        Motion((15.0, 0.0), speed=((0.0, 2.0), (4.0, 2.0), (5.0, -3.0))), lanes=_ROAD,
        why="standing would not have helped: the car comes on",
    ),
    Situation(
        "a car backs out of a driveway into its side", False, "came too late", _CRUISE,
        Motion((60.0, -5.5), -np.pi / 2, ((0.0, 0.0), (5.2, 0.0), (5.8, -4.0))), lanes=_ROAD,
        why="it began to move when nobody could brake any more",
    ),
)  # fmt: skip
