"""How far the turn of a step is off, told by the road alone.

Once the rotation of a step is taken out, the road shifts along the drive and nowhere sideways. If the rotation is off
by an angle about the vertical, pieces of road move sideways the more the farther they are: by that angle times their
distance. So the road tells the turn where most of what is seen drives through the same bend as the vehicle itself.
"""

from collections.abc import Iterator

import cv2
import numpy as np

from olt_generator.motion.road_grid import (
    LEAST_CONTRAST,
    LEAST_SEEN,
    SPACING_ACROSS,
    SPACING_ALONG,
    RoadGrid,
    RoadPicture,
    find_peak,
)

# Cells are looked for so many samples to both sides, and along the drive about where the speed has them.
SEARCH_ACROSS = 4
SEARCH_ALONG = 2
LEAST_CORRELATION = 0.6
LEAST_CELLS = 8
# Standard deviation of the place of a cell across, metres.
ACROSS_SIGMA = 0.03
ROUNDS = 10
# Cells that agree with the turn to two deviations; fewer tell nothing.
LEAST_AGREEING = 0.6


def measure_turn(first: RoadPicture, second: RoadPicture, grid: RoadGrid, driven: float) -> float | None:
    """Angle in radians, to the left, by which the second picture was turned too little; None if the road does not tell.

    Args:
        first, second: the road as the grid sees it at both ends of a step, with the rotation as it was found taken out.
        grid: the grid.
        driven: metres, negative backward.
    """
    places = np.array(list(_place_cells(first, second, grid, round(driven / SPACING_ALONG)))).reshape(-1, 2)
    if len(places) < LEAST_CELLS:
        return None
    distance, aside = places.T
    A = np.stack([np.ones(len(distance)), distance], axis=-1)
    weight = np.ones(len(distance))
    missed = np.zeros(len(distance))
    slope = 0.0
    for _ in range(ROUNDS):
        offset, slope = np.linalg.lstsq(A * weight[:, None], aside * weight, rcond=None)[0]
        missed = (aside - offset - slope * distance) / ACROSS_SIGMA
        weight = 1.0 / (1.0 + missed**2)
    return float(slope) if np.mean(np.abs(missed) < 2.0) > LEAST_AGREEING else None


def _place_cells(first: RoadPicture, second: RoadPicture, grid: RoadGrid, shift: int) -> Iterator[tuple[float, float]]:
    """Distance ahead of the first camera and displacement to the left, metres, of cells that are found."""
    length, width = grid.cell
    rows, columns = first.detail.shape
    for column in range(SEARCH_ACROSS, columns - width - SEARCH_ACROSS + 1, width):
        for start in range(0, rows - length + 1, length):
            low, high = start + shift - SEARCH_ALONG, start + shift + length + SEARCH_ALONG
            cell = second.detail[start : start + length, column : column + width]
            seen = second.seen[start : start + length, column : column + width].mean()
            if low < 0 or high > rows or seen < LEAST_SEEN or cell.std() < LEAST_CONTRAST:
                continue
            around = first.detail[low:high, column - SEARCH_ACROSS : column + width + SEARCH_ACROSS]
            scores = cv2.matchTemplate(around, cell, cv2.TM_CCOEFF_NORMED)
            row, place = divmod(int(np.argmax(scores)), scores.shape[1])
            peak = find_peak(scores[row], 0, 2 * SEARCH_ACROSS)
            if scores[row, place] > LEAST_CORRELATION and peak is not None:
                yield float(grid.along[start + shift + length // 2]), (peak - SEARCH_ACROSS) * SPACING_ACROSS
