"""Metric scale of a motion whose shape is known, from the road below a camera of known height.

Pieces of road ahead are matched between frames some metres apart. If the road were the plane along which the camera
moves, every piece would give the same scale. A road that is tilted against the motion by an angle t, because the body
pitches or the road bends, seems to move by d^2 t / h more at distance d, so that near and far pieces differ:

    log(shift / motion) = scale + t (d_first + d_second) / h + r y / h + b d_first d_second / (2 h).

The third term is that of a road which falls by an angle r to the left, where a piece lies y to the left; the last one
that of a road which bends upward by b = 1 / radius, through the points below both places of the camera. The four are
told apart by the places of the pieces and by what is known beforehand: angles and bends are small and last about a
second, and the scale of a tracked motion changes little by little.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from olt_generator.motion.features import Gray
from olt_generator.motion.road_grid import CELL_METRES, SPACING_ALONG, RoadGrid, find_peak, road_frame
from olt_generator.poses import Array, invert

# Driven between the frames of a pair, in camera heights, and the most keyframes between them.
BASELINE_HEIGHTS = 2.5
MOST_STEPS_APART = 30
# Shifts are tried within this share of the expected one; weaker matches are none.
SEARCH_SHARE = 0.15
LEAST_CORRELATION = 0.5
# A cell is matched where it correlates nowhere better than by this; where it does so much better elsewhere, it shows no
# road, and neither does what lies behind it.
NO_BETTER = 0.02
CLEARLY_BETTER = 0.2
# Cells beside the lane say less: the next lane often lies a little higher or lower.
FARTHEST_ACROSS_LANE = 2.0

# Standard deviations: of the logarithm of scale of a cell, and of a rough measurement of one step; of tilt and roll in
# radians and of the bend in 1/m, which last for `TILT_SECONDS`; of the change of scale over a second, and of the scale
# at the start.
STATES = 4
CELL_SIGMA = 0.025
ROUGH_SIGMA = 0.05
TILT_SIGMA = 0.002
ROLL_SIGMA = 0.01
BEND_SIGMA = 0.001
TILT_SECONDS = 1.0
SCALE_CHANGE = 0.005
INITIAL_SCALE_SIGMA = 0.3
ROBUST_ROUNDS = 10


@dataclass(frozen=True)
class RoadMatches:
    """Pieces of road that were matched between two keyframes.

    Attributes:
        step: (m,) first keyframe of the pair.
        lever: (m,) sum of the distances in both frames, in camera heights: what a tilt is multiplied by.
        across: (m,) distance to the left, in camera heights: what a roll is multiplied by.
        bend: (m,) half the product of the distances in both frames over the camera's height, in metres: what the
            curvature of a crest or a dip is multiplied by.
        log_scale: (m,) logarithm of the shift of the road over the distance driven.
        sigma: (m,) standard deviation of `log_scale`.
    """

    step: NDArray[np.int64]
    lever: Array
    across: Array
    bend: Array
    log_scale: Array
    sigma: Array


@dataclass(frozen=True)
class PlaneScale:
    """Scale of a motion.

    Attributes:
        factor: (n,) by which each of the n steps must be multiplied to be metric.
        covariance: (n, n) of their logarithms, for the height as given.
        tilt, roll: (n,) angles by which the road rises ahead and falls to the left against the motion, radians.
        bend: (n,) curvature of the road upward, 1/m.
    """

    factor: Array
    covariance: Array
    tilt: Array
    roll: Array
    bend: Array


def measure_scale(
    grays: Sequence[Gray], times: Array, T_world_camera: Array, driven: Array, grid: RoadGrid, up: Array
) -> PlaneScale:
    """Hold a motion against that of the road.

    Args:
        grays: n + 1 keyframes.
        times: (n + 1,) seconds.
        T_world_camera: (n + 1, 4, 4) their poses, of about the right scale.
        driven: (n,) metres driven in each step as measured roughly, 0 at standstill.
        grid: where the camera sees the road.
        up: (3,) rough up direction in camera axes; only its roll about the motion matters.
    """
    moves = np.flatnonzero(driven > 0.0)
    length = np.linalg.norm(np.diff(T_world_camera[:, :3, 3], axis=0), axis=1)[moves]
    middle = float(grid.along.mean())
    matched = match_road(grays, T_world_camera, grid, up)
    matches = RoadMatches(
        np.concatenate([moves, matched.step]),
        np.concatenate([np.full(len(moves), 2.0 * middle / grid.height), matched.lever]),
        np.concatenate([np.zeros(len(moves)), matched.across]),
        np.concatenate([np.full(len(moves), middle**2 / (2.0 * grid.height)), matched.bend]),
        np.concatenate([np.log(driven[moves] / length), matched.log_scale]),
        np.concatenate([np.full(len(moves), ROUGH_SIGMA), matched.sigma]),
    )
    return separate_tilt(matches, times)


def match_road(grays: Sequence[Gray], T_world_camera: Array, grid: RoadGrid, up: Array) -> RoadMatches:
    """Match the road between every keyframe and the next one some metres on; arguments as of `measure_scale`."""
    # A cell more to either side: what is lighter or darker than its surroundings is told by these.
    grid = grid.narrowed(FARTHEST_ACROSS_LANE + CELL_METRES[1])
    rows: list[tuple[float, ...]] = []
    positions = T_world_camera[:, :3, 3]
    for start, position in enumerate(positions[:-1]):
        later = positions[start + 1 : start + 1 + MOST_STEPS_APART]
        far = np.linalg.norm(later - position, axis=1) >= BASELINE_HEIGHTS * grid.height
        if not far.any():
            continue
        end = start + 1 + int(np.argmax(far))
        T_start_end = invert(T_world_camera[start]) @ T_world_camera[end]
        backward = T_start_end[2, 3] < 0.0
        first, second = (end, start) if backward else (start, end)
        motion = invert(T_start_end) if backward else T_start_end
        for distance, across, log_scale, correlation in _match_cells(grays[first], grays[second], motion, grid, up):
            before = distance + float(np.linalg.norm(motion[:3, 3])) * np.exp(log_scale)
            places = (before + distance) / grid.height, across / grid.height, before * distance / (2.0 * grid.height)
            rows.append((start, *places, log_scale, correlation))
    step, lever, across, bend, log_scale, correlation = np.array(rows).reshape(-1, 6).T
    return RoadMatches(step.astype(np.int64), lever, across, bend, log_scale, CELL_SIGMA / np.sqrt(correlation))


def _match_cells(
    first: Gray, second: Gray, T_first_second: Array, grid: RoadGrid, up: Array
) -> Iterator[tuple[float, float, float, float]]:
    """Distances ahead and to the left in the second frame, logarithm of shift over motion, and correlation of cells.

    Of every column of cells those count that lie before the first one which moves otherwise: there something stands.
    """
    driven = float(np.linalg.norm(T_first_second[:3, 3]))
    motion = T_first_second[:3, 3] / driven
    axes = road_frame(motion, up, motion)
    found = grid.match(grid.rectify(first, axes), grid.rectify(second, axes.rotated(T_first_second[:3, :3].T)))
    low, high = np.searchsorted(grid.shifts, [(1.0 - SEARCH_SHARE) * driven, (1.0 + SEARCH_SHARE) * driven])
    for across, column in zip(found.across, np.nan_to_num(found.correlation, nan=-1.0), strict=True):
        if abs(across) > FARTHEST_ACROSS_LANE:
            continue
        for along, scores in zip(found.along, column, strict=True):
            peak = find_peak(scores, int(low), int(high))
            best = scores[low : high + 1].max()
            if peak is not None and best > LEAST_CORRELATION and best > scores.max() - NO_BETTER:
                shift = grid.shifts[0] + peak * SPACING_ALONG
                yield float(along), float(across), float(np.log(shift / driven)), float(best)
            elif scores.max() > max(LEAST_CORRELATION, best + CLEARLY_BETTER):
                break


def separate_tilt(matches: RoadMatches, times: Array) -> PlaneScale:
    """The most probable scale and tilt over every step between the times (n + 1,), in seconds."""
    steps = len(times) - 1
    rows = np.arange(len(matches.step))
    A = csc_matrix(
        (
            np.concatenate([np.ones(len(rows)), matches.lever, matches.across, matches.bend]),
            (np.tile(rows, STATES), np.concatenate([STATES * matches.step + state for state in range(STATES)])),
        ),
        (len(rows), STATES * steps),
    )
    prior = _prior_information(0.5 * (times[1:] + times[:-1]))
    robust = np.ones(len(rows))
    for _ in range(ROBUST_ROUNDS):
        state = _solve(A, robust * matches.sigma**-2, prior, matches.log_scale)[0]
        missed = 0.5 * (matches.log_scale - A @ state) / matches.sigma
        robust = 1.0 / (1.0 + missed**2) ** 2
    state, solver = _solve(A, robust * matches.sigma**-2, prior, matches.log_scale)
    each = np.zeros((STATES * steps, steps))
    each[STATES * np.arange(steps), np.arange(steps)] = 1.0
    covariance = each.T @ solver.solve(each)
    return PlaneScale(np.exp(state[::STATES]), covariance, *(state[index::STATES] for index in range(1, STATES)))


def _solve(A: csc_matrix, information: Array, prior: csc_matrix, target: Array) -> tuple[Array, SuperLU]:
    """Weighted least squares with a prior about 0, and the factors of its normal equations."""
    solver = splu((A.T @ A.multiply(information[:, None]) + prior).tocsc())
    return solver.solve(A.T @ (information * target)), solver


def _prior_information(times: Array) -> csc_matrix:
    """Information (4 n, 4 n) on scale, tilt, roll and bend in turn: a random walk, and processes that forget."""
    gaps, n = np.diff(times), len(times)
    kept = np.exp(-gaps[:, None] / np.array([np.inf, TILT_SECONDS, TILT_SECONDS, TILT_SECONDS]))
    fresh = np.array([0.0, TILT_SIGMA, ROLL_SIGMA, BEND_SIGMA]) * np.sqrt(1.0 - kept**2)
    fresh[:, 0] = SCALE_CHANGE * np.sqrt(gaps)
    # Row k of each: (state k + 1 - kept * state k) / spread; the first rows are the state at the first time.
    rows = np.arange(STATES * n)
    later = np.concatenate([[INITIAL_SCALE_SIGMA, TILT_SIGMA, ROLL_SIGMA, BEND_SIGMA], fresh.ravel()])
    before = -(kept / fresh).ravel()
    columns = np.concatenate([rows, rows[:-STATES]])
    A = csc_matrix((np.concatenate([1.0 / later, before]), (np.concatenate([rows, rows[STATES:]]), columns)))
    return csc_matrix(A.T @ A)
