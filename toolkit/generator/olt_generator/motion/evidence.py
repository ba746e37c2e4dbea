"""Whether what a video shows of its motion agrees, and how far the motion may be off where it does not."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.doubts import Doubt
from olt_generator.motion.road_speed import LEAST_LOG_ODDS, RoadSpeed
from olt_generator.motion.road_structure import Plane

# A course of the speed is in doubt where another one has more than this share of its votes.
LARGEST_RIVAL = 0.6
# A direction is in doubt where the opposite one is less improbable than this, as a logarithm, for a step.
LEAST_DIRECTION_LOG_ODDS = 3.0
# A speed is in doubt where fewer of its steps than this are told by the road.
LEAST_TOLD = 0.5
# A road's texture and its points are in doubt where they put it at heights that differ by more, as a logarithm, or
# where the points lie scattered: fewer than this share of them on one plane.
LARGEST_DIFFERENCE = 0.25
LEAST_ON_PLANE = 0.3
# A picture is upside down where points lie on a plane above the camera so many times better than on the road.
UPSIDE_DOWN = 2.0
# Hardly anybody drives faster, m/s; a time lapse does.
FASTEST_CAR = 50.0
# A standstill is in doubt where something speaks against it in more than this share of the steps.
LARGEST_AGAINST_STANDSTILL = 0.1
# Nobody reverses faster, m/s; and no camera that looks ahead looks farther to the side, radians.
FASTEST_REVERSE = 6.0
FARTHEST_ASIDE = np.radians(45.0)
# Spread of the logarithm of the speed where it is in doubt: a factor of two either way.
DOUBTFUL_LOG_SCALE = 0.7


@dataclass(frozen=True)
class Evidence:
    """What was found out of a motion, each by other means.

    Attributes:
        road: how the texture of the road ahead shifts.
        moves: (n,) steps in which the vehicle moves.
        below, above: where the followed points lie; None where too few could be placed.
        aside: angle between the direction of travel and where the mounting says that ahead is, radians.
    """

    road: RoadSpeed
    moves: NDArray[np.bool_]
    below: Plane | None
    above: Plane | None
    aside: float


def find_doubts(evidence: Evidence) -> Iterator[Doubt]:
    """Everything that does not agree."""
    road, moves = evidence.road, evidence.moves
    mean = float(np.mean(road.speed[moves]))
    if evidence.aside > FARTHEST_ASIDE:
        why = f"the camera travels at {np.degrees(evidence.aside):.0f} degrees to where it looks, so it looks aside"
        yield Doubt("view direction", why)
    elif mean < -FASTEST_REVERSE and np.mean(road.speed[moves] < 0.0) > 0.9:
        why = f"the whole video drives backward at {-mean:.0f} m/s, so the camera looks back"
        yield Doubt("view direction", why)
    fastest = float(np.percentile(np.abs(road.speed[moves]), 90.0))
    if fastest > FASTEST_CAR:
        yield Doubt(
            "times", f"the vehicle drives at {fastest:.0f} m/s, so frames may be farther apart than the file says"
        )
    told = float(np.mean(road.log_odds[moves] > LEAST_LOG_ODDS))
    if told < LEAST_TOLD:
        yield Doubt("speed", f"the road could be followed in only {told:.0%} of the steps that move")
    rival = road.rival_log_odds / max(road.path_log_odds, 1e-9)
    if rival > LARGEST_RIVAL:
        why = f"another course of the speed has {rival:.0%} of its votes; what moves by itself may cover the road"
        yield Doubt("speed", why)
    if abs(road.direction_log_odds) < LEAST_DIRECTION_LOG_ODDS * np.count_nonzero(moves):
        why = f"the road tells forward from backward by a factor of only exp({abs(road.direction_log_odds):.1f})"
        yield Doubt("direction", why)
    yield from _doubt_structure(evidence)


def doubt_standstill(against: float) -> Iterator[Doubt]:
    """What speaks against standing: the share of the steps in which what cannot move then does, or no road is seen."""
    if against > LARGEST_AGAINST_STANDSTILL:
        why = (
            f"the vehicle seems to stand in {against:.0%} of the steps although no road tells it, or what is near moves"
        )
        yield Doubt("standstill", f"{why}; something may cover the road")


def _doubt_structure(evidence: Evidence) -> Iterator[Doubt]:
    below, above = evidence.below, evidence.above
    if below is None:
        return
    if above is not None and above.share > UPSIDE_DOWN * below.share:
        why = (
            f"{above.share:.0%} of the points above the camera lie on one plane, of those below it {below.share:.0%}; "
            "turn the video if it is upside down"
        )
        yield Doubt("upright", why)
    elif below.share < LEAST_ON_PLANE:
        yield Doubt("road", f"only {below.share:.0%} of the {below.points} points below the camera lie on one plane")
    elif abs(below.place) > LARGEST_DIFFERENCE and below.share_at_road < 0.5 * below.share:
        why = (
            f"the points below the camera lie on a plane {np.exp(below.place):.2f} times as far down as the texture of "
            "the road says"
        )
        yield Doubt("road", why)
