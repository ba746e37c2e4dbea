"""People who direct traffic, with arms and signs that a camera sees.

Who stops traffic holds both arms out to the sides and stands still, or shows a red sign; who waves it through swings
one arm to and fro before the body, or shows a green sign. Sleeves are those of a padded jacket, and each hand that is
held out has a white gauntlet and a lit wand in it.
"""

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.suite.courses import TIMES, Course, Size, go, stand
from olt_generator.poses import Array

ARM: Size = (0.18, 0.78, 0.18)
SIGN: Size = (0.06, 0.75, 0.75)
SHOULDER, REACH = 1.4, 0.6
"""Metres: height of an arm that is held out, and from the middle of the body to that of the arm."""
SIGN_HEIGHT, SIGN_OFFSET = 1.55, 0.55
"""Metres: of a sign's lower edge over the ground, and from the middle of the body to that of the sign."""
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
    stops, times_us = is_held(held), np.round(TIMES * 1e6).astype(np.int64)
    swing = np.where(stops, 0.0, _SWING * np.sin(2.0 * np.pi * _WAVES_PER_SECOND * TIMES))
    place = (float(x[0]), float(y[0]))
    agents = [body, held_out("officer_arm_left", place, facing + np.pi / 2 + swing, times_us)]
    # The right arm hangs, which the body shows, while the left one waves.
    for index, part in enumerate(_runs(stops)):
        turn = np.full(len(part), facing - np.pi / 2)
        agents.append(held_out(f"officer_arm_right_{index}", place, turn, times_us[part]))
    return agents


def held_out(name: str, place: tuple[float, float], directions: Array, times_us: NDArray[np.int64]) -> Agent:
    """An arm of who stands at a place (x, y), held out in directions (n,), radians, at times (n,)."""
    x, y = place[0] + REACH * np.cos(directions), place[1] + REACH * np.sin(directions)
    poses = np.column_stack([x, y, np.full_like(x, SHOULDER), directions - np.pi / 2])
    return Agent(name, "arm", *ARM, times_us, poses)


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
                    np.full(count, offset + SIGN_OFFSET),
                    np.pi,
                    SIGN,
                    SIGN_HEIGHT,
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
