"""People who direct traffic, with arms and signs that a camera sees.

Who stops traffic holds both arms out to the sides and stands still, or shows a red sign; who waves it through swings
one arm to and fro before the body, or shows a green sign.
"""

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.suite.courses import TIMES, Course, Size, go, stand

_ARM: Size = (0.13, 0.75, 0.13)
_SHOULDER, _ARM_OFFSET = 1.38, 0.62
_SIGN: Size = (0.06, 0.75, 0.75)
_SIGN_HEIGHT, _SIGN_OFFSET = 1.55, 0.55
_WAVES_PER_SECOND, _SWING = 0.8, 0.9


def officer(course: Course, station: float, offset: float, held: tuple[tuple[float, float], ...]) -> list[Agent]:
    """Somebody who faces those that come along a course, and directs them by arms.

    Args:
        course: of those who are directed.
        station, offset: where on it, metres.
        held: (from, until) seconds in which they must stop.
    """
    body = stand("officer", "person", course, station, offset, turn=np.pi)
    x, y, heading = course.locate(station, offset)
    facing = float(heading[0]) + np.pi
    stops = is_held(held)
    swing = np.where(stops, 0.0, _SWING * np.sin(2.0 * np.pi * _WAVES_PER_SECOND * TIMES))
    agents = [body]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        # The right arm hangs while the left one waves.
        turn = swing if side == "left" else np.zeros_like(swing)
        angle = facing + sign * np.pi / 2 + turn
        reach = np.where(stops | (side == "left"), _ARM_OFFSET, 0.2)
        places = np.column_stack([x + reach * np.cos(angle), y + reach * np.sin(angle)])
        height = np.where(stops | (side == "left"), _SHOULDER, 0.9)
        poses = np.column_stack([places, height, angle - np.pi / 2])
        agents.append(Agent(f"officer_arm_{side}", "arm", *_ARM, np.round(TIMES * 1e6).astype(np.int64), poses))
    return agents


def flagger(course: Course, station: float, offset: float, held: tuple[tuple[float, float], ...]) -> list[Agent]:
    """A worker who faces those that come along a course and shows a red sign while they must stop, else a green one."""
    agents = [stand("flagger", "person", course, station, offset, turn=np.pi)]
    stops = is_held(held)
    for label, shown in (("sign_stop", stops), ("sign_go", ~stops)):
        for index, part in enumerate(_runs(shown)):
            count = len(part)
            agents.append(
                go(
                    f"{label}_{index}",
                    label,
                    course,
                    np.full(count, station),
                    np.full(count, offset + _SIGN_OFFSET),
                    np.pi,
                    _SIGN,
                    _SIGN_HEIGHT,
                    TIMES[part],
                )
            )
    return agents


def is_held(held: tuple[tuple[float, float], ...]) -> NDArray[np.bool_]:
    """At which of TIMES (n,) some span of seconds holds."""
    return np.any([(start <= TIMES) & (end > TIMES) for start, end in held], axis=0) if held else TIMES < -1.0


def _runs(flags: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Indices of the stretches in which a flag holds, two samples or more."""
    indices = np.flatnonzero(flags)
    parts = np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1)
    return [part for part in parts if len(part) >= 2]
