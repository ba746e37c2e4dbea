"""The defensive driver: what somebody who pays attention sees coming, and when braking would still have helped.

It is the performance model of UN Regulation 157 for vehicles that cut in (2021/389, annex 4, appendix 3): a risk is
perceived 0.4 s after it shows, braking begins 0.75 s after that, and reaches 0.774 g within 0.6 s; the first 0.375 m
that somebody moves sideways are wandering. It brakes on the path that was driven, and does not swerve.
"""

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scenes.polylines import arc_lengths
from olt_closed_loop.scoring.contacts import TOUCH
from olt_closed_loop.scoring.moving_boxes import MovingBox, separations
from olt_generator.poses import Array

PERCEPTION, DELAY, RAMP = 0.4, 0.75, 0.6
"""Seconds until a risk is perceived, from then to the brake, and to full braking."""
DECELERATION = 0.774 * 9.81
"""m/s2."""
WANDER = 0.375
"""Metres that somebody may move sideways without meaning anything by it."""
LOOK_BACK_US = 6_000_000
EYE_HEIGHT = 1.2
"""Metres; what is lower hides nobody."""

_GRID_US = 100_000
_STEP_US = 20_000
_AFTER_US = 5_000_000
_MOTION_US = 500_000
_NEAR = 0.01
_MISSES = 5

Times = NDArray[np.int64]
Flags = NDArray[np.bool_]


def time_to_stop(speed: float) -> float:
    """Seconds from a risk that shows to standing, from a speed in m/s."""
    return PERCEPTION + DELAY + 0.5 * RAMP + speed / DECELERATION


def speed_at(box: MovingBox, time_us: int) -> float:
    """Speed in m/s over the half second before a time."""
    times = np.array([max(time_us - _MOTION_US, int(box.timestamps_us[0])), time_us])
    if times[1] <= times[0]:
        return 0.0
    start, end = box.at(times, columns=2)
    return float(np.hypot(*(end - start)) / (times[1] - times[0]) * 1e6)


def could_avoid(
    body: MovingBox, other: MovingBox, aware_us: int, contact_us: int, free_us: int, or_stand: bool = False
) -> bool:
    """Whether `body`, aware of the risk at `aware_us`, would not have touched `other` if it had braked.

    Args:
        body: who brakes, on the path that it drove.
        other: who moves as it did.
        aware_us: when the risk showed.
        contact_us: when they touched.
        free_us: before this time `body` was not in control and does not brake.
        or_stand: whether it is enough to stand when they touch.
    """
    brake_us = max(aware_us + round((PERCEPTION + DELAY) * 1e6), free_us)
    end_us = min(contact_us + _AFTER_US, int(other.timestamps_us[-1]), int(body.timestamps_us[-1]))
    if brake_us >= contact_us:
        return False
    times = np.append(np.arange(brake_us, end_us, _STEP_US, dtype=np.int64), end_us)
    was_there, speed = _braked(body, brake_us, times)
    gaps, _ = separations(body.at(was_there), body.half_size, other.at(times), other.half_size)
    harmless = (gaps.max(axis=1) >= TOUCH) | (or_stand & (speed == 0.0))
    return bool(harmless.all())


def _braked(body: MovingBox, brake_us: int, times: Times) -> tuple[Times, Array]:
    """Where the body would be at times (n,) if it had braked from the first on.

    Returns:
        When (n,) it really was there, and its speed (n,) in m/s when it brakes.
    """
    start = body.timestamps_us[0]
    ways = arc_lengths(body.poses[:, :2])
    driven = np.interp(times - start, body.timestamps_us - start, ways)
    seconds = (times - brake_us) * 1e-6
    deceleration = DECELERATION * np.minimum(seconds / RAMP, 1.0)
    slower = cumulative_trapezoid(deceleration, seconds, initial=0.0)
    speed = np.maximum(speed_at(body, brake_us) - slower, 0.0)
    braked = np.minimum(driven[0] + cumulative_trapezoid(speed, seconds, initial=0.0), driven)
    # Where the body stood, several times have one place: the last of them is taken, which changes nothing.
    was_there = start + np.interp(braked, ways, body.timestamps_us - start).astype(np.int64)
    return np.minimum(was_there, times), speed


def look_back(first: MovingBox, second: MovingBox, contact_us: int) -> Times:
    """Times (n,) every 0.1 s up to the contact, in order, over at most 6 s in which both are there."""
    begin_us = max(contact_us - LOOK_BACK_US, int(first.timestamps_us[0]), int(second.timestamps_us[0]))
    return contact_us - _GRID_US * np.arange((contact_us - begin_us) // _GRID_US, -1, -1, dtype=np.int64)


def foreseen_at(driver: MovingBox, other: MovingBox, times: Times) -> Flags:
    """At which times (n,) the other was on a course of contact with the way that the driver then drove.

    The other is taken to keep its velocity, or its velocity and turn rate, and to need 0.375 m more than its size.
    """
    earlier, later = np.triu_indices(len(times))
    ahead = 1e-6 * (times[later] - times[earlier]).astype(np.float64)
    now, velocity, turn_rate = _motion(other, times)
    places = driver.at(times)[later]
    foreseen = np.zeros(len(times), dtype=bool)
    straight = np.zeros_like(turn_rate)
    for turning in (straight, turn_rate) if turn_rate.any() else (straight,):
        predicted = _extrapolate(now[earlier], velocity[earlier], turning[earlier], ahead)
        foreseen[earlier[_touches(places, driver, predicted, other)]] = True
    return foreseen


def in_the_way_at(driver: MovingBox, other: MovingBox, times: Times) -> Flags:
    """At which times (n,) the other was within 0.375 m of the strip that the driver then drove over."""
    earlier, later = np.triu_indices(len(times))
    in_the_way = np.zeros(len(times), dtype=bool)
    touched = _touches(driver.at(times)[later], driver, other.at(times)[earlier], other)
    in_the_way[earlier[touched]] = True
    return in_the_way


def since(flags: Flags, times: Times) -> int | None:
    """From which of the times (n,) on a flag holds until the last; None where it does not hold at the last.

    Noise makes it miss now and then: up to half a second of misses in a row count for nothing.
    """
    if not flags[-1]:
        return None
    gaps = np.flatnonzero(np.convolve(~flags, np.ones(_MISSES + 1), "valid") > _MISSES)
    begin = gaps[-1] + _MISSES + 1 if len(gaps) else 0
    return int(times[begin + np.argmax(flags[begin:])])


def visible_at(driver: MovingBox, other: MovingBox, occluders: Sequence[MovingBox], times: Times) -> Flags:
    """At which times (n,) some of the other's corners or its centre can be seen from the driver's centre.

    What is lower than the eye hides nobody, and what is not a box (walls, trees) is not known.
    """
    eyes, places = driver.at(times)[:, :2], other.at(times)
    targets = np.concatenate([corners(places, other.half_size), places[:, None, :2]], axis=1)
    low, high = np.minimum(eyes, targets.min(axis=1)).min(axis=0), np.maximum(eyes, targets.max(axis=1)).max(axis=0)
    hidden = np.zeros(targets.shape[:2], dtype=bool)
    for box in occluders:
        there = box.covers(times)
        if box is other or 2.0 * box.half_size[2] < EYE_HEIGHT or not there.any():
            continue
        blocks = box.at(times[there])
        if np.any(blocks[:, :2].max(axis=0) < low - box.radius) or np.any(
            blocks[:, :2].min(axis=0) > high + box.radius
        ):
            continue
        origin = eyes[there][:, None]
        sights = shapely.linestrings(np.stack([np.zeros_like(targets[there]), targets[there] - origin], axis=2))
        outlines = np.asarray(shapely.polygons(corners(blocks, box.half_size) - origin))
        hidden[there] |= np.asarray(shapely.intersects(sights, outlines[:, None]))
    return ~np.asarray(hidden.all(axis=1))


def _motion(box: MovingBox, times: Times) -> tuple[Array, Array, Array]:
    """Poses (n, 4), velocities (n, 2) and turn rates (n,) over the half second before times (n,).

    Where less of a box is known, they are those of its first 0.1 s.
    """
    first, last = int(box.timestamps_us[0]), int(box.timestamps_us[-1])
    begin = np.maximum(times - _MOTION_US, first)
    end = np.maximum(times, min(first + _GRID_US, last))
    start, stop = box.at(begin), box.at(end)
    seconds = np.maximum((end - begin) * 1e-6, 1e-6)
    change = (stop - start) / seconds[:, None]
    return box.at(times), change[:, :2], change[:, 3]


def _extrapolate(now: Array, velocity: Array, turn_rate: Array, seconds: Array) -> Array:
    """Poses (n, 4) after some seconds (n,) at constant speed and turn rate."""
    turn = turn_rate * seconds
    along = seconds * np.sinc(turn / np.pi)
    aside = seconds * np.sin(0.5 * turn) * np.sinc(0.5 * turn / np.pi)
    poses = now.copy()
    poses[:, 0] += along * velocity[:, 0] - aside * velocity[:, 1]
    poses[:, 1] += aside * velocity[:, 0] + along * velocity[:, 1]
    poses[:, 3] += turn
    return poses


def _touches(own: Array, driver: MovingBox, theirs: Array, other: MovingBox) -> Flags:
    """Which boxes (n,) touch when the driver's is 0.375 m larger on all sides."""
    half = driver.half_size + np.array([WANDER, WANDER, 0.0])
    # Centres farther apart than both radii are not worth a look.
    touches = np.hypot(*(theirs - own)[:, :2].T) < np.hypot(*half[:2]) + other.radius + _NEAR
    gaps, _ = separations(own[touches], half, theirs[touches], other.half_size)
    touches[touches] = gaps.max(axis=1) < _NEAR
    return touches
