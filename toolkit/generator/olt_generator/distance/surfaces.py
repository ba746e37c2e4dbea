"""Which surface each pixel of a driving clip shows: parallax where it is decisive, priors and edges where it is not.

What is certain comes first: pixels that agree with the road, and colours of the sky. The plane sweep then covers only
the rows that show something else. Its evidence is spread over the picture up to the edges in it. Below the horizon, a
thing that contradicts the still world, nearer than its foot on the road or fixed in the picture, moves, and is put
where its foot is.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.distance.background import FAR_DISTANCE, road_distance
from olt_generator.distance.ground_contact import contact_distance
from olt_generator.distance.plane_sweep import Match, PlaneSweep, local_contrast
from olt_generator.distance.sky import LabelledImage, SkyColours

# Frames, spread over the clip, that teach the colours of the sky.
MOST_EXAMPLES = 3

# Grey levels of contrast without which a pixel has nothing to compare, and the window over which it is taken.
LEAST_CONTRAST = 2.0
CONTRAST_WINDOW = (7, 7)

# The evidence of a pixel is full where its best distance matches this much better than all others, in normalised grey
# levels after a margin for noise, and it fades as the best match itself gets as bad as what no frame sees.
MARGIN, FULL_ADVANTAGE = 3.0, 10.0
WORST_MATCH = 25.0
# Evidence that counts as a measurement.
MEASURED = 0.3

# How many times nearer than the background something is that is surely not sky, or still may be, with the evidence
# that each takes; and metres to the farthest road whose colours are surely not those of the sky.
SURELY_NEAR, NEAR_EVIDENCE = 2.0, 0.3
PERHAPS_FAR, FAR_EVIDENCE = 1.4, 0.15
TEACHING_ROAD = 60.0
# Probability above which colours decide on sky, and the weight of it against parallax.
CERTAIN_SKY, SKY_WEIGHT = 0.7, 0.3

# Mismatch up to which a textured pixel may show the road, with the weight of that, and up to which it surely does.
ROAD_MISMATCH, ROAD_WEIGHT = 18.0, 0.6
CERTAIN_ROAD_MISMATCH = 12.0
# Mismatch up to which the background explains a pixel well enough not to sweep for its sake.
EXPLAINED_MISMATCH = 15.0
# Rows are swept where more than this share of the pixels is open, and some rows around them.
OPEN_SHARE = 0.05
ROW_STEP = 16

# How far knowledge spreads, and the difference in colour that stops it (Min et al., Fast Global Image Smoothing Based
# on Weighted Least Squares, 2014). The trace keeps the sum of weights above 0.
SPREAD, EDGE = 30.0, 8.0
TRACE = 1e-4
# How many times nearer than the background a point must be not to be taken for it: 16 cm of height over the road for a
# camera at 1.5 m.
LEAST_RATIO = 1.12

# What moves: nearer than its foot by this factor, or matched better by staying in place by this many grey levels, and
# well by itself. Farther feet are too close to the horizon to be told.
FLOATING = 1.6
STILL_ADVANTAGE, STILL_MISMATCH = 6.0, 15.0
FARTHEST_CONTACT = 40.0


@dataclass(frozen=True)
class Surfaces:
    """The surfaces of one frame at reduced size.

    Attributes:
        ratio: (h, w) float32, how many times nearer than the background, 1 for the background itself.
        knowledge: (h, w) float32, the weight of what speaks for it, here and nearby; 0 where nothing does.
        measured: (h, w) bool, where the pixel's own parallax gave the ratio.
        moving: (h, w) bool, where something moves.
    """

    ratio: NDArray[np.float32]
    knowledge: NDArray[np.float32]
    measured: NDArray[np.bool_]
    moving: NDArray[np.bool_]


class SurfaceFinder:
    """Finds the surfaces of a clip's frames, from its pictures (h, w, 3) uint8, in grey (h, w), and their sweep."""

    def __init__(self, images: list[NDArray[np.uint8]], grey: list[NDArray[np.uint8]], sweep: PlaneSweep) -> None:
        self._images, self._sweep, self._background = images, sweep, sweep.background
        self._textured = [local_contrast(picture, CONTRAST_WINDOW)[1] > LEAST_CONTRAST for picture in grey]
        self._road = road_distance(sweep.camera, sweep.T_rig_camera)
        self._above = self._road >= FAR_DISTANCE
        self._sky = SkyColours(self._examples())

    def find(self, index: int) -> Surfaces:
        """The surfaces of frame `index`; all background, unknown, where the camera hardly moved."""
        mismatch = self._sweep.background_mismatch(index)
        if mismatch is None:
            ones, zeros = np.ones(self._above.shape, np.float32), np.zeros(self._above.shape, np.float32)
            return Surfaces(ones, zeros, zeros > 0.0, zeros > 0.0)
        textured = self._textured[index]
        sky = np.where(self._above, self._sky.probability(self._images[index]), np.float32(0.0))
        certain = (sky > CERTAIN_SKY) | (~self._above & textured & (mismatch < CERTAIN_ROAD_MISMATCH))
        log_ratio, evidence, still = self._sweep_open_rows(index, certain | (mismatch < EXPLAINED_MISMATCH))
        near = log_ratio > np.log(LEAST_RATIO)
        on_road = ~self._above & ~near & textured & (mismatch < ROAD_MISMATCH)
        weight = np.where(self._above & near, evidence * (1.0 - sky), evidence)
        weight = weight + SKY_WEIGHT * sky + ROAD_WEIGHT * on_road
        log_ratio[certain] = 0.0
        ratio, knowledge = _spread(self._images[index], log_ratio, weight.astype(np.float32))
        ratio, moving = self._stand_on_road(ratio, still & textured & ~self._above)
        return Surfaces(ratio, knowledge, near & ~certain & (evidence > MEASURED), moving)

    def _examples(self) -> Iterator[LabelledImage]:
        """What parallax says about the colours of some frames; frames in which it says nothing are left out."""
        count = len(self._images)
        for index in np.unique(np.linspace(0, count - 1, min(count, MOST_EXAMPLES)).round().astype(int)):
            match = self._sweep.match(index, 0, self._sweep.camera.height)
            if match is None:
                continue
            evidence, ratio = _evidence(match, self._textured[index]), self._background / match.distance
            if not (evidence > 0.0).any():
                continue
            is_near = self._above & (ratio > SURELY_NEAR) & (evidence > NEAR_EVIDENCE)
            is_far = self._above & (ratio < PERHAPS_FAR) & (evidence > FAR_EVIDENCE)
            open_sky = self._above & np.logical_and.accumulate(~self._textured[index] | is_far, axis=0)
            yield self._images[index], is_far | open_sky, is_near | (self._road < TEACHING_ROAD)

    def _sweep_open_rows(
        self, index: int, explained: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
        """Logarithm of the ratio, its evidence, and what keeps its place in the picture (h, w); 0 in rows not swept."""
        log_ratio, evidence = np.zeros(explained.shape, np.float32), np.zeros(explained.shape, np.float32)
        still = np.zeros(explained.shape, np.bool_)
        open_rows = np.flatnonzero((~explained).mean(axis=1) > OPEN_SHARE)
        if len(open_rows) == 0:
            return log_ratio, evidence, still
        # Some rows around them, too, and in steps, so that few sizes occur.
        top, bottom = (open_rows[0] // ROW_STEP - 1) * ROW_STEP, (open_rows[-1] // ROW_STEP + 2) * ROW_STEP
        rows = slice(max(0, int(top)), min(len(explained), int(bottom)))
        match = self._sweep.match(index, rows.start, rows.stop)
        if match is not None:
            log_ratio[rows] = np.log(self._background[rows] / match.distance)
            evidence[rows] = _evidence(match, self._textured[index][rows])
            advantage = match.mismatch - match.mismatch_still
            still[rows] = (advantage > STILL_ADVANTAGE) & (match.mismatch_still < STILL_MISMATCH)
        return log_ratio, evidence, still

    def _stand_on_road(
        self, ratio: NDArray[np.float32], still: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """The ratio (h, w) with what moves put where its foot is, and what moves (h, w)."""
        goes_along = _without_specks(still, 3)
        stands = (ratio > 1.0) | goes_along
        foot = contact_distance(stands, self._road, self._sweep.camera, self._sweep.T_rig_camera)
        floats = (ratio > 1.0) & (FLOATING * self._background / ratio < foot) & (foot < FARTHEST_CONTACT)
        moving = (goes_along & (foot < FARTHEST_CONTACT)) | _without_specks(floats, 5)
        return np.where(moving, np.maximum(self._background / foot, 1.0), ratio).astype(np.float32), moving


def _without_specks(mask: NDArray[np.bool_], size: int) -> NDArray[np.bool_]:
    """The mask (h, w) without parts narrower than `size` pixels."""
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((size, size), np.uint8)) > 0


def _evidence(match: Match, textured: NDArray[np.bool_]) -> NDArray[np.float32]:
    """How clearly (rows, w) the best distance is the best, 0 to 1; 0 where there is no texture to compare."""
    advantage = np.clip((match.runner_up - match.mismatch - MARGIN) / FULL_ADVANTAGE, 0.0, 1.0)
    return (textured * advantage * np.clip(1.0 - match.mismatch / WORST_MATCH, 0.0, 1.0)).astype(np.float32)


def _spread(
    image: NDArray[np.uint8], log_ratio: NDArray[np.float32], weight: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The ratio (h, w) as weighted mean over each pixel's surroundings up to the edges of the image, and its weight."""
    # One thread: how several share the rows shows in the last bits of the smoother.
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        smoother = cv2.ximgproc.createFastGlobalSmootherFilter(image, SPREAD, EDGE)
        knowledge = np.asarray(smoother.filter(weight), np.float32)
        ratio = np.exp(smoother.filter(weight * log_ratio) / (knowledge + np.float32(TRACE)))
    finally:
        cv2.setNumThreads(threads)
    is_background = ratio < LEAST_RATIO
    return np.where(is_background, np.float32(1.0), ratio), knowledge
