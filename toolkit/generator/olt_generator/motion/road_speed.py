"""Signed speed of a vehicle from how the road ahead shifts from frame to frame.

Every cell of the road grid votes for the shifts with which it agrees. A cell may show no road: then it either stays in
the picture, as a vehicle ahead that keeps its distance does, or says anything. So cells that stay say little for
standstill, while cells that move as one and the same plane does say much for driving: nothing else moves so.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from olt_generator.motion.road_grid import OWN_LANE, SPACING_ALONG, CellMatches, find_peak
from olt_generator.poses import Array

# Independent pixels of a cell: how much a correlation says. Texture, noise and blur go together over decimetres.
PIXELS_OF_CELL = 12.0
BEST_CORRELATION = 0.99
# A cell is road, something that keeps its distance and so stays in the picture, or is anything else. What is not fixed
# to the vehicle keeps its distance for a while only, and hardly ever from a vehicle that reverses.
ROAD_SHARE, STAYING_SHARE, STAYING_BACKWARD_SHARE = 0.5, 0.25, 0.02
STAYING_SECONDS = 0.4
# A cell clearly agrees with a shift that is so many times as probable as any, and with those nearly so probable. Where
# it does not, something stands there, and what is seen beyond counts by this share.
CLEAR_PEAK, NEAR_PEAK, LEAST_OPEN = 10.0, 4.0, 0.05
# In the vehicle's own lane something may drive ahead; beside it anything may drive in any direction.
BESIDE_WEIGHT = 0.5

# Speeds that are told apart; a vehicle reverses slowly, but a camera that looks back may be met.
FASTEST = 60.0
SPEEDS: Array = np.concatenate(
    [np.arange(-FASTEST, -5.0, 0.5), np.arange(-5.0, 5.0, 0.1), np.arange(5.0, FASTEST, 0.5)]
)
_SIDES = SPEEDS > -1e-9, SPEEDS < 1e-9
# A course is another one where it differs by so many metres over a vote, and by this share of the speed.
RIVAL_METRES, RIVAL_SHARE = 0.15, 0.25
# Spread of the change of speed over a second, m/s: everyday driving.
SPEED_CHANGE = 1.5
# By how many times driving forward is more probable than backward, as a logarithm: once for a whole clip, and for each
# step, because a vehicle overtaken by others looks like one that reverses.
FORWARD_LOG_ODDS = 3.0
BACKWARD_STEP = 1.0
# Spread of one measurement: a share of the speed plus a share of the grid's spacing.
MEASUREMENT_SHARE = 0.02
# Votes for the speed found against the next best one, as a logarithm, from which a step counts as measured.
LEAST_LOG_ODDS = 2.0


def count_votes(matches: CellMatches, seconds: float) -> Array:
    """Log odds (shifts,) of every shift of the road against a road that shows nothing.

    A column of cells shows road from near until something stands on it, and what stands there seems to shift the more
    the farther its cells are, or keeps its distance. So a column counts up to where it agrees best, from near to far,
    and hardly beyond a cell that clearly agrees with another shift. `seconds` lie between the two pictures.
    """
    correlation = np.clip(matches.correlation, 0.0, BEST_CORRELATION)
    tried = np.isfinite(correlation)
    fit = np.where(tried, (1.0 - correlation**2) ** (-0.5 * PIXELS_OF_CELL), 0.0)
    count = np.maximum(tried.sum(axis=-1, keepdims=True), 1)
    # Probability that each cell gives to each shift, over that of a cell that says nothing.
    agrees = np.where(tried, fit * count / np.maximum(fit.sum(axis=-1, keepdims=True), 1.0), 1.0)
    middle = correlation.shape[-1] // 2
    stays = agrees[..., middle - 1 : middle + 2].max(axis=-1, keepdims=True)
    share = np.full(correlation.shape[-1], STAYING_SHARE)
    share[:middle] = STAYING_BACKWARD_SHARE
    share *= np.exp(-seconds / STAYING_SECONDS)
    otherwise = share * stays + (1.0 - ROAD_SHARE - share)
    odds = np.log((ROAD_SHARE * agrees + otherwise) / (ROAD_SHARE + otherwise[..., -1:]))
    best = agrees.max(axis=-1, keepdims=True)
    open_to = np.where(best > CLEAR_PEAK, np.clip(NEAR_PEAK * agrees / best, LEAST_OPEN, 1.0), 1.0)
    odds[:, 1:] *= np.cumprod(open_to[:, :-1], axis=1)
    weight = np.where(np.abs(matches.across) < OWN_LANE, 1.0, BESIDE_WEIGHT)
    return weight @ np.maximum(np.cumsum(odds, axis=1).max(axis=1), 0.0)


@dataclass(frozen=True)
class RoadSpeed:
    """Speed over every step.

    Attributes:
        speed: (n,) m/s, negative backward.
        sigma: (n,) its standard deviation; of a step that the road does not tell, what its neighbours leave open.
        log_odds: (n,) votes of the road for the speed, as a logarithm, against a road that shows nothing.
        path_log_odds: those of the whole course.
        direction_log_odds: how much more probable is a course that never goes backward than one never forward.
        rival_log_odds: those of the most probable course that is nowhere near this one.
    """

    speed: Array
    sigma: Array
    log_odds: Array
    path_log_odds: float
    direction_log_odds: float
    rival_log_odds: float


@dataclass(frozen=True)
class LongerVotes:
    """Votes taken over more than one step, for steps over which little is driven.

    Attributes:
        votes: (n, shifts) log odds about each step; nothing where none were taken.
        lasts: (n,) time over which they were taken, about the middle of the step, in seconds.
    """

    votes: Array
    lasts: Array


def estimate_speed(votes: Array, shifts: Array, seconds: Array, longer: LongerVotes | None = None) -> RoadSpeed:
    """The most probable course of the speed.

    A most probable path through the votes settles which shift is meant; its exact place is then measured, over the
    longer time where that tells it, and weighed against a random walk of the speed.

    Args:
        votes: (n, shifts) log odds of each step (`count_votes`).
        shifts: (shifts,) metres, evenly spaced.
        seconds: (n,) duration of each step.
        longer: more votes for some of the steps.
    """
    here = _votes_for(SPEEDS[None], votes, shifts, seconds)
    lasts = seconds
    if longer is not None:
        here += _votes_for(SPEEDS[None], longer.votes, shifts, longer.lasts)
    rough, course = _most_probable_path(here, seconds)
    weight = np.take_along_axis(here, np.searchsorted(SPEEDS, rough)[:, None], axis=1)[:, 0]
    if longer is not None:
        told = _votes_for(rough[:, None], longer.votes, shifts, longer.lasts)[:, 0] > LEAST_LOG_ODDS
        votes, lasts = np.where(told[:, None], longer.votes, votes), np.where(told, longer.lasts, seconds)
    forward, backward = (_most_probable_path(here[:, side], seconds, SPEEDS[side])[1] for side in _SIDES)
    near = np.abs(SPEEDS - rough[:, None]) < np.maximum(RIVAL_METRES / lasts, RIVAL_SHARE * np.abs(rough))[:, None]
    rival = _most_probable_path(np.where(near, -np.inf, here), seconds)[1]
    measured, sigma = (
        np.array([_measure_peak(row, shifts, expected) for row, expected in zip(votes, rough * lasts, strict=True)]).T
        / lasts
    )
    used = weight > LEAST_LOG_ODDS
    speed, deviation = _smooth_speeds(np.where(used, measured, rough), np.where(used, sigma, np.inf), seconds)
    return RoadSpeed(speed, deviation, weight, course, forward - backward, rival)


def _votes_for(speeds: Array, votes: Array, shifts: Array, lasts: Array) -> Array:
    """Votes (n, speeds) for speeds (1 or n, speeds), none for those that are beyond the shifts."""
    wanted = np.broadcast_to(speeds, (len(votes), speeds.shape[1])) * lasts[:, None]
    rows = [np.interp(row, shifts, vote, left=0.0, right=0.0) for row, vote in zip(wanted, votes, strict=True)]
    return np.array(rows)


def _most_probable_path(votes: Array, seconds: Array, speeds: Array = SPEEDS) -> tuple[Array, float]:
    """Viterbi path (n,) over speeds through their votes (n, speeds), and its log odds."""
    best = np.where(speeds < 0.0, -FORWARD_LOG_ODDS, 0.0)
    came_from = np.zeros((len(votes), len(speeds)), dtype=np.intp)
    change = (speeds[:, None] - speeds[None, :]) ** 2 / (2.0 * SPEED_CHANGE**2)
    for step, row in enumerate(votes):
        total = best[None, :] - change / seconds[step]
        came_from[step] = np.argmax(total, axis=1)
        best = total[np.arange(len(speeds)), came_from[step]] + row - BACKWARD_STEP * (speeds < 0.0)
    path = np.zeros(len(votes), dtype=np.intp)
    path[-1] = int(np.argmax(best))
    for step in range(len(votes) - 1, 0, -1):
        path[step - 1] = came_from[step, path[step]]
    return speeds[path], float(best.max())


def _measure_peak(votes: Array, shifts: Array, expected: float) -> tuple[float, float]:
    """Shift at the highest vote near the expected one, and its standard deviation, metres."""
    reach = max(2.0 * SPACING_ALONG, 0.1 * abs(expected))
    low, high = np.searchsorted(shifts, [expected - reach, expected + reach])
    peak = find_peak(votes, int(low), int(high))
    sigma = MEASUREMENT_SHARE * (abs(expected) + SPACING_ALONG)
    return (expected, sigma + reach) if peak is None else (float(shifts[0]) + peak * SPACING_ALONG, sigma)


def _smooth_speeds(measured: Array, sigma: Array, seconds: Array, rounds: int = 5) -> tuple[Array, Array]:
    """Minimise Huber's loss of the measurements plus the squares of the changes of speed; and what that leaves open."""
    between = 2.0 / (SPEED_CHANGE**2 * (seconds[1:] + seconds[:-1]))
    chain = np.zeros((2, len(measured)))
    chain[1, 1:] += between
    chain[1, :-1] += between
    chain[0, 1:] = -between
    speed, robust = measured, np.ones(len(measured))
    information = np.maximum(sigma**-2.0, 1e-9)
    for _ in range(rounds):
        banded = chain.copy()
        banded[1] += information * robust
        # A single step has no neighbours, and a single band.
        speed = solveh_banded(banded[-len(measured) :], information * robust * measured)
        robust = 1.0 / np.maximum(1.0, np.abs(measured - speed) * np.sqrt(information) / 2.0)
    dense = np.diag(chain[1] + information * robust) + np.diag(chain[0, 1:], 1) + np.diag(chain[0, 1:], -1)
    return speed, np.sqrt(np.diag(np.linalg.inv(dense)))
