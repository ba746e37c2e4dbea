"""The nearest of many polylines, for many points at once."""

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from olt_closed_loop.scenes.polylines import arc_lengths
from olt_generator.poses import Array

Found = tuple[NDArray[np.int64], Array, Array, Array]


class Segments:
    """A search tree of the segments of polylines.

    Args:
        lines: (n, 2) metres each; None for a line that is never found.
    """

    def __init__(self, lines: Sequence[Array | None]) -> None:
        known = [(index, line) for index, line in enumerate(lines) if line is not None and len(line) > 1]
        self._origin = known[0][1][0] if known else np.zeros(2)
        local = [line - self._origin for _, line in known]
        steps = np.concatenate([np.zeros((0, 2)), *(np.diff(line, axis=0) for line in local)])
        lengths = np.linalg.norm(steps, axis=1)
        along = np.concatenate([np.zeros(0), *(arc_lengths(line)[:-1] for line in local)])
        owners = np.repeat([index for index, _ in known], [len(line) - 1 for line in local]).astype(np.int64)
        kept = lengths > 0.0
        starts = np.concatenate([np.zeros((0, 2)), *(line[:-1] for line in local)])[kept]
        steps = steps[kept]
        self._starts, self._owners, self._along, self._lengths = starts, owners[kept], along[kept], lengths[kept]
        self._directions = steps / self._lengths[:, None]
        self._headings = np.arctan2(steps[:, 1], steps[:, 0])
        self._tree = shapely.STRtree(np.asarray(shapely.linestrings(np.stack([starts, starts + steps], axis=1))))

    def nearest(self, points: Array, headings: Array | None, reach: float) -> Found:
        """The nearest line (n,), metres along and to the left of it, and its heading, of points (n, 2).

        Of lines equally near it is the first. Where none is within `reach` metres, the line is -1 and the rest is not a
        number. With `headings` (n,) only segments within 90 degrees of them are taken.
        """
        local = points - self._origin
        geometries = shapely.points(local)
        if headings is None:
            asked, segments = self._tree.query_nearest(geometries, max_distance=reach)
        else:
            asked, segments = self._tree.query(geometries, predicate="dwithin", distance=reach)
            same_way = np.cos(self._headings[segments] - headings[asked]) >= 0.0
            asked, segments = asked[same_way], segments[same_way]
        away = local[asked] - self._starts[segments]
        ahead = np.clip(np.sum(away * self._directions[segments], axis=1), 0.0, self._lengths[segments])
        beside = away - ahead[:, None] * self._directions[segments]
        distances = np.linalg.norm(beside, axis=1)
        # Two lines that share a point are equally near, but for rounding.
        order = np.lexsort((segments, self._owners[segments], np.round(distances, 9), asked))
        at, first = np.unique(asked[order], return_index=True)
        chosen, best = segments[order[first]], order[first]
        left = self._directions[chosen][:, 0] * away[best, 1] - self._directions[chosen][:, 1] * away[best, 0]
        lanes = np.full(len(points), -1, dtype=np.int64)
        along, offsets, directions = (np.full(len(points), np.nan) for _ in range(3))
        lanes[at] = self._owners[chosen]
        along[at] = self._along[chosen] + ahead[best]
        offsets[at] = np.where(left < 0.0, -1.0, 1.0) * distances[best]
        directions[at] = self._headings[chosen]
        return lanes, along, offsets, directions
