"""Metric speed of a camera from the road ahead, whose distance follows from the height of the camera.

A strip of road is rectified in both frames of a step, with the rotation already taken out. The two pictures, metric
and seen from above, then differ by a shift along the direction of travel, which is the distance driven. The shift is
found by normalised correlation of all pixels, not of corners: asphalt has few corners, and lines that run along the
road, on which corners slide, say nothing about the shift and do no harm.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.ndimage import uniform_filter1d

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.motion.features import Gray
from olt_generator.poses import Array

# The strip, in camera heights ahead of the camera: nearer is bonnet, farther is a few pixels a metre.
NEAREST_HEIGHTS = 3.5
FARTHEST_HEIGHTS = 12.0
HALF_WIDTH_METRES = 1.5
SPACING_ALONG = 0.05
SPACING_ACROSS = 0.1
# Brightness changes over more than this length are light and shade of the lens, not road.
DETAIL_METRES = 1.0
MIN_OVERLAP_HEIGHTS = 2.0
MIN_OVERLAP_SHARE = 0.1

SPEEDS: Array = np.arange(0.0, 50.0, 0.25)
# How many times more probable a perfect match is than none, as a logarithm.
MATCH_LOG_ODDS = 10.0
# Spread of the change of speed over a second, m/s: everyday driving.
SPEED_CHANGE = 1.5
# Spread of one road measurement: a share of the speed plus a share of the strip's spacing.
MEASUREMENT_SHARE = 0.02
# A peak that stands out of the other correlations by less than this is no measurement.
MIN_WEIGHT = 0.2


@dataclass(frozen=True)
class RoadFrame:
    """Axes of the road strip in one camera, each (3,): along the drive, to the left, and up from the road."""

    along: Array
    left: Array
    up: Array

    def rotated(self, rotation: Array) -> "RoadFrame":
        """The same axes in a camera turned by `rotation` (3, 3)."""
        return RoadFrame(rotation @ self.along, rotation @ self.left, rotation @ self.up)


def road_frame(travel: Array, up: Array, direction: Array) -> RoadFrame:
    """Axes of the road in camera coordinates, from the `direction` (3,) of a step.

    The road contains the usual direction of `travel` (3,); of the rough `up` (3,) only the roll about it matters.
    """
    normal = _unit(up - (up @ travel) * travel)
    along = _unit(direction - (direction @ normal) * normal)
    return RoadFrame(along, np.cross(normal, along), normal)


class RoadStrip:
    """The strip of road that one camera matches between frames."""

    def __init__(
        self, camera: Camera, height: float, axes: RoadFrame, hidden: NDArray[np.bool_], length_heights: float
    ) -> None:
        """Lay the strip, `length_heights` camera heights long, where the road becomes visible.

        Height is that of the camera above the road in metres; hidden pixels (H, W) show no road, such as the bonnet.

        Raises:
            InputError: no road is in view.
        """
        self.camera, self.height, self.hidden = camera, height, hidden
        ahead = np.arange(NEAREST_HEIGHTS * height, FARTHEST_HEIGHTS * height, SPACING_ALONG)
        _, visible = self._locate(axes, ahead, np.zeros(1))
        if not visible.any():
            raise InputError("odometry: the camera sees no road ahead, so speed is unknown; check its pitch and height")
        nearest = ahead[int(np.argmax(visible[:, 0]))]
        self.along = nearest + np.arange(0.0, length_heights * height, SPACING_ALONG)
        self.across = np.arange(-HALF_WIDTH_METRES, HALF_WIDTH_METRES + 1e-9, SPACING_ACROSS)

    @property
    def shifts(self) -> int:
        """How many displacements are tried; longer ones leave too little overlap to match."""
        return round((self.along[-1] - self.along[0] - MIN_OVERLAP_HEIGHTS * self.height) / SPACING_ALONG)

    def match(self, first: Gray, second: Gray, axes: RoadFrame, R_second_first: Array) -> Array:
        """Correlation (shifts,) of the strip for displacements 0, 0.05, ... metres; -1 where too little is seen."""
        before, after = self.rectify(first, axes), self.rectify(second, axes.rotated(R_second_first))
        rows, least = len(self.along), MIN_OVERLAP_SHARE * before.seen.size
        return np.array(
            [
                correlate(before.part(shift, rows - shift), after.part(0, rows - shift), least)
                for shift in range(self.shifts)
            ]
        )

    def rectify(self, gray: Gray, axes: RoadFrame) -> "RoadPicture":
        """The strip seen from above."""
        pixels, seen = self._locate(axes, self.along, self.across)
        table = pixels.astype(np.float32)
        picture = cv2.remap(gray, table[..., 0], table[..., 1], cv2.INTER_LINEAR).astype(np.float64)
        window = round(DETAIL_METRES / SPACING_ALONG)
        share = np.maximum(uniform_filter1d(seen.astype(np.float64), window, axis=0), 1e-6)
        mean = uniform_filter1d(np.where(seen, picture, 0.0), window, axis=0) / share
        return RoadPicture(np.where(seen, picture - mean, 0.0), seen)

    def _locate(self, axes: RoadFrame, along: Array, across: Array) -> tuple[Array, NDArray[np.bool_]]:
        points = along[:, None, None] * axes.along + across[:, None] * axes.left - self.height * axes.up
        pixels, inside = self.camera.project(points)
        column, row = np.moveaxis(np.where(inside[..., None], np.rint(pixels), 0.0).astype(np.intp), -1, 0)
        return pixels, inside & ~self.hidden[row, column]


@dataclass(frozen=True)
class RoadPicture:
    """Grey levels (along, across) of a strip without their local mean, 0 where the strip is not `seen`."""

    detail: Array
    seen: NDArray[np.bool_]

    def part(self, start: int, length: int) -> "RoadPicture":
        """Some of the rows along the strip."""
        return RoadPicture(self.detail[start : start + length], self.seen[start : start + length])


def correlate(a: RoadPicture, b: RoadPicture, least: float) -> float:
    """Normalised correlation of two pictures of one size, -1 where they share fewer than `least` pixels."""
    if np.count_nonzero(a.seen & b.seen) < least:
        return -1.0
    # Unseen pixels are 0 and count only in the energy of the other picture, where they are taken out.
    shared_a, shared_b = a.detail * b.seen, b.detail * a.seen
    energy = float(np.sqrt(np.vdot(shared_a, shared_a) * np.vdot(shared_b, shared_b)))
    return float(np.vdot(shared_a, shared_b)) / energy if energy > 0.0 else 0.0


def estimate_speed(scores: Array, seconds: Array, moving: NDArray[np.bool_]) -> Array:
    """Speed (n,) over every step in m/s that agrees best with the road and with what a vehicle can do.

    The most probable path through the correlations settles which peak is meant; a peak's exact place is then
    measured and weighed against a random walk of the speed.

    Args:
        scores: (n, shifts) correlation of each step (`RoadStrip.match`); rows of steps at standstill are not read.
        seconds: (n,) duration of each step.
        moving: (n,) whether the vehicle moves in the step; elsewhere the speed is 0.

    Raises:
        InputError: no step shows a road that matches.
    """
    rough = _most_probable_speeds(scores, seconds, moving)
    measured, weight = _measure_peaks(scores, seconds, rough)
    used = moving & (weight > MIN_WEIGHT) & (measured > 0.0)
    if not used.any():
        raise InputError(
            "odometry: the road ahead shows nothing that can be followed from frame to frame, so speed is unknown; "
            "give a clip with a visible, textured road"
        )
    measured, weight = np.where(moving, measured, 0.0), np.where(moving, weight, 1.0)
    return np.where(moving, np.maximum(_smooth_speeds(measured, weight, seconds), 0.0), 0.0)


def _most_probable_speeds(scores: Array, seconds: Array, moving: NDArray[np.bool_]) -> Array:
    """Viterbi path (n,) over `SPEEDS`."""
    best = np.zeros(len(SPEEDS))
    came_from = np.zeros((len(scores), len(SPEEDS)), dtype=np.intp)
    change = (SPEEDS[:, None] - SPEEDS[None, :]) ** 2 / (2.0 * SPEED_CHANGE**2)
    for step in range(len(scores)):
        total = best[None, :] - change / seconds[step]
        came_from[step] = np.argmax(total, axis=1)
        shifts = SPEEDS * seconds[step] / SPACING_ALONG
        here = np.interp(shifts, np.arange(scores.shape[1]), scores[step], right=-1.0)
        match = here if moving[step] else -SPEEDS
        best = total[np.arange(len(SPEEDS)), came_from[step]] + MATCH_LOG_ODDS * match
    path = np.zeros(len(scores), dtype=np.intp)
    path[-1] = int(np.argmax(best))
    for step in range(len(scores) - 1, 0, -1):
        path[step - 1] = came_from[step, path[step]]
    return SPEEDS[path]


def _measure_peaks(scores: Array, seconds: Array, rough: Array) -> tuple[Array, Array]:
    """Speed (n,) at the correlation peak nearest to the rough speed, and how far it stands out, as a weight (n,)."""
    measured, weight = np.zeros(len(scores)), np.zeros(len(scores))
    for step, row in enumerate(scores):
        expected = rough[step] * seconds[step] / SPACING_ALONG
        reach = max(2.0, 0.1 * expected)
        low = int(np.clip(expected - reach, 1, len(row) - 2))
        high = int(np.clip(expected + reach, low, len(row) - 2))
        peak = find_peak(row, low, high)
        if peak is not None:
            measured[step] = peak * SPACING_ALONG / seconds[step]
            weight[step] = max(0.0, row[round(peak)] - float(np.median(row[row > -1.0])))
    return measured, weight


def find_peak(scores: Array, low: int, high: int) -> float | None:
    """Place of the highest of the scores (n,) between two indices, by a parabola; None where it is no peak."""
    peak = low + int(np.argmax(scores[low : high + 1]))
    left, middle, right = scores[peak - 1 : peak + 2]
    curvature = left - 2.0 * middle + right
    if not (left <= middle >= right and curvature < 0.0):
        return None
    return peak + 0.5 * float((left - right) / curvature)


def _smooth_speeds(measured: Array, weight: Array, seconds: Array, rounds: int = 5) -> Array:
    """Minimise Huber's loss of the measurements plus the squares of the changes of speed; a tridiagonal system."""
    if len(measured) == 1:
        return measured
    sigma = MEASUREMENT_SHARE * (np.abs(measured) + SPACING_ALONG / seconds)
    between = 2.0 / (SPEED_CHANGE**2 * (seconds[1:] + seconds[:-1]))
    speed = measured
    robust = np.ones(len(measured))
    for _ in range(rounds):
        information = np.maximum(weight * robust / sigma**2, 1e-9)
        banded = np.zeros((2, len(measured)))
        banded[1] = information
        banded[1, 1:] += between
        banded[1, :-1] += between
        banded[0, 1:] = -between
        speed = solveh_banded(banded, information * measured)
        robust = 1.0 / np.maximum(1.0, np.abs(measured - speed) / (2.0 * sigma))
    return speed


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)
