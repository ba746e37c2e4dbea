"""Metric scale of a motion whose shape is known, from the road below a camera of known height.

Pieces of road ahead are matched between frames some metres apart. If the road were the plane along which the camera
moves, every piece would give the same scale. A road that is tilted against the motion by an angle t, because the body
pitches or the road bends, seems to move by d^2 t / h more at distance d, so that near and far pieces differ:

    log(shift / motion) = scale + t (d_first + d_second) / h.

Scale and tilt are told apart by the distances of the pieces and by what is known beforehand: tilts are small and last
about a second, and the scale of a tracked motion changes little by little.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from olt_generator.motion.features import Gray
from olt_generator.motion.road_scale import (
    MIN_OVERLAP_SHARE,
    SPACING_ALONG,
    RoadStrip,
    correlate,
    find_peak,
    road_frame,
)
from olt_generator.poses import Array, invert

# Driven between the frames of a pair, in camera heights, and the most keyframes between them.
BASELINE_HEIGHTS = 2.5
MOST_STEPS_APART = 30
PIECES = 4
# Shifts are tried within this share of the expected one; weaker matches are none.
SEARCH_SHARE = 0.15
LEAST_CORRELATION = 0.5

# Standard deviations: of the logarithm of scale of a piece, and of a rough measurement of one step; of the tilt in
# radians, which lasts for `TILT_SECONDS`; of the change of scale over a second, and of the scale at the start.
PIECE_SIGMA = 0.015
ROUGH_SIGMA = 0.05
TILT_SIGMA = 0.002
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
        log_scale: (m,) logarithm of the shift of the road over the distance driven.
        sigma: (m,) standard deviation of `log_scale`.
    """

    step: NDArray[np.int64]
    lever: Array
    log_scale: Array
    sigma: Array


@dataclass(frozen=True)
class PlaneScale:
    """Scale of a motion.

    Attributes:
        factor: (n,) by which each of the n steps must be multiplied to be metric.
        sigma: relative standard deviation of the mean scale, for the height as given.
        tilt: (n,) angle by which the road ahead rises against the motion, radians.
    """

    factor: Array
    sigma: float
    tilt: Array


def measure_scale(
    grays: Sequence[Gray], times: Array, T_world_camera: Array, driven: Array, strip: RoadStrip, up: Array
) -> PlaneScale:
    """Hold a motion against that of the road.

    Args:
        grays: n + 1 keyframes.
        times: (n + 1,) seconds.
        T_world_camera: (n + 1, 4, 4) their poses, of about the right scale.
        driven: (n,) metres driven in each step as measured roughly, 0 at standstill.
        strip: where the camera sees the road.
        up: (3,) rough up direction in camera axes; only its roll about the motion matters.
    """
    moves = np.flatnonzero(driven > 0.0)
    length = np.linalg.norm(np.diff(T_world_camera[:, :3, 3], axis=0), axis=1)[moves]
    lever = np.full(len(moves), 2.0 * float(strip.along.mean()) / strip.height)
    matched = match_road(grays, T_world_camera, strip, up)
    matches = RoadMatches(
        np.concatenate([moves, matched.step]),
        np.concatenate([lever, matched.lever]),
        np.concatenate([np.log(driven[moves] / length), matched.log_scale]),
        np.concatenate([np.full(len(moves), ROUGH_SIGMA), matched.sigma]),
    )
    return separate_tilt(matches, times)


def match_road(grays: Sequence[Gray], T_world_camera: Array, strip: RoadStrip, up: Array) -> RoadMatches:
    """Match pieces of road between every keyframe and the next one some metres on; arguments as of `measure_scale`."""
    rows: list[tuple[int, float, float, float]] = []
    positions = T_world_camera[:, :3, 3]
    for start, position in enumerate(positions[:-1]):
        later = positions[start + 1 : start + 1 + MOST_STEPS_APART]
        far = np.linalg.norm(later - position, axis=1) >= BASELINE_HEIGHTS * strip.height
        if not far.any():
            continue
        end = start + 1 + int(np.argmax(far))
        T_start_end = invert(T_world_camera[start]) @ T_world_camera[end]
        backward = T_start_end[2, 3] < 0.0
        first, second = (end, start) if backward else (start, end)
        motion = invert(T_start_end) if backward else T_start_end
        driven = float(np.linalg.norm(motion[:3, 3]))
        for distance, shift, correlation in _match_pieces(grays[first], grays[second], motion, strip, up):
            rows.append((start, (2.0 * distance + shift) / strip.height, float(np.log(shift / driven)), correlation))
    step, lever, log_scale, correlation = np.array(rows).reshape(-1, 4).T
    return RoadMatches(step.astype(np.int64), lever, log_scale, PIECE_SIGMA / np.sqrt(correlation))


def _match_pieces(
    first: Gray, second: Gray, T_first_second: Array, strip: RoadStrip, up: Array
) -> Iterator[tuple[float, float, float]]:
    """Distance in the second frame and shift, both in metres, and correlation of every piece that is found."""
    driven = float(np.linalg.norm(T_first_second[:3, 3]))
    motion = T_first_second[:3, 3] / driven
    axes = road_frame(motion, up, motion)
    before = strip.rectify(first, axes)
    after = strip.rectify(second, axes.rotated(T_first_second[:3, :3].T))
    nearest, farthest = (round((1.0 + side * SEARCH_SHARE) * driven / SPACING_ALONG) for side in (-1.0, 1.0))
    length = (len(strip.along) - farthest) // PIECES
    for start in range(0, PIECES * length, max(length, 1)):
        piece = after.part(start, length)
        scores = np.array(
            [
                correlate(before.part(start + shift, length), piece, MIN_OVERLAP_SHARE * piece.seen.size)
                for shift in range(nearest, farthest + 1)
            ]
        )
        peak = find_peak(scores, 1, len(scores) - 2)
        if peak is not None and scores.max() > LEAST_CORRELATION:
            distance = float(strip.along[start : start + length].mean())
            yield distance, (nearest + peak) * SPACING_ALONG, float(scores.max())


def separate_tilt(matches: RoadMatches, times: Array) -> PlaneScale:
    """The most probable scale and tilt over every step between the times (n + 1,), in seconds."""
    steps = len(times) - 1
    rows = np.arange(len(matches.step))
    A = csc_matrix(
        (
            np.concatenate([np.ones(len(rows)), matches.lever]),
            (np.tile(rows, 2), np.concatenate([2 * matches.step, 2 * matches.step + 1])),
        ),
        (len(rows), 2 * steps),
    )
    prior = _prior_information(0.5 * (times[1:] + times[:-1]))
    robust = np.ones(len(rows))
    for _ in range(ROBUST_ROUNDS):
        state = _solve(A, robust * matches.sigma**-2, prior, matches.log_scale)[0]
        missed = 0.5 * (matches.log_scale - A @ state) / matches.sigma
        robust = 1.0 / (1.0 + missed**2) ** 2
    state, solver = _solve(A, robust * matches.sigma**-2, prior, matches.log_scale)
    mean = np.tile([1.0 / steps, 0.0], steps)
    return PlaneScale(np.exp(state[::2]), float(np.sqrt(mean @ solver.solve(mean))), state[1::2])


def _solve(A: csc_matrix, information: Array, prior: csc_matrix, target: Array) -> tuple[Array, SuperLU]:
    """Weighted least squares with a prior about 0, and the factors of its normal equations."""
    solver = splu((A.T @ A.multiply(information[:, None]) + prior).tocsc())
    return solver.solve(A.T @ (information * target)), solver


def _prior_information(times: Array) -> csc_matrix:
    """Information (2 n, 2 n) on scale and tilt in turn: a random walk, and a stationary process that forgets."""
    gaps, n = np.diff(times), len(times)
    kept = np.exp(-gaps / TILT_SECONDS)
    change, fresh = SCALE_CHANGE * np.sqrt(gaps), TILT_SIGMA * np.sqrt(1.0 - kept**2)
    # Row k of each: (state k + 1 - kept * state k) / spread; the rows 0 and 1 are the state at the first time.
    rows, even = np.arange(2 * n), np.arange(2 * n - 2)
    later = np.concatenate([[INITIAL_SCALE_SIGMA, TILT_SIGMA], np.stack([change, fresh], axis=-1).ravel()])
    before = np.stack([-1.0 / change, -kept / fresh], axis=-1).ravel()
    A = csc_matrix(
        (np.concatenate([1.0 / later, before]), (np.concatenate([rows, even + 2]), np.concatenate([rows, even])))
    )
    return csc_matrix(A.T @ A)
