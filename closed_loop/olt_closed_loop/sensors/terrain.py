"""Where rays meet the ground: a level plane, or hills that change along one direction.

Along that direction a ray is a straight line over the profile of the hills, and which piece of the profile it meets
first depends on its slope alone: one table by slope, made for the camera's place, answers for all rays.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Hills
from olt_closed_loop.sensors.textures import FloatImage
from olt_generator.poses import Array

FARTHEST = 1e5
"""Metres from which ground is painted as if it were no farther."""

_STEEPEST = 1e9
_GRAZING = 1e-4
# Metres along the profile below which a piece of it is left out.
_NEAREST = 1e-6


class GroundHits(NamedTuple):
    """Where rays (n,) meet the ground: metres along each, inf for those that do not; and sine of the angle to it.

    `height` is that of the camera over level ground, metres; None over hills.
    """

    distance: FloatImage
    sine: FloatImage
    height: float | None

    def along(self, rays: NDArray[np.intp], across: FloatImage) -> FloatImage:
        """Size of pixels along their rays, from that `across` (n,), of the rays of index (n,), metres."""
        if self.height is None:
            return across / self.sine[rays]
        away = np.minimum(self.distance[rays], np.float32(FARTHEST))
        return across * away / np.float32(max(self.height, 0.1))


def meet_ground(hills: Hills | None, position: Array, rays: FloatImage) -> GroundHits:
    """World rays (3, ...) from `position` (3,), above the ground, against hills, or the plane z = 0 for None."""
    if hills is not None:
        return meet_hills(hills, position, rays)
    fall = np.maximum(-rays[2], np.float32(1e-9))
    distance = np.where(rays[2] < 0.0, np.float32(position[2]) / fall, np.float32(np.inf))
    return GroundHits(distance, fall, float(position[2]))


def meet_hills(hills: Hills, position: Array, rays: FloatImage) -> GroundHits:
    """World rays (3, ...) from `position` (3,), above the ground, against hills."""
    x, y, z = rays
    cos, sin = np.float32(np.cos(hills.direction)), np.float32(np.sin(hills.direction))
    along = x * cos + y * sin
    slope = z / np.maximum(np.abs(along), np.float32(1.0 / _STEEPEST))
    distance, grade = np.empty_like(slope), np.empty_like(slope)
    for sign, side in ((1.0, along >= 0.0), (-1.0, along < 0.0)):
        reached, fallen, grade[side] = _meet_profile(*_profile(hills, position, sign), slope[side])
        # Of the two equal quotients the one whose numbers are the larger.
        flat, steep = np.abs(along[side]), np.abs(z[side])
        distance[side] = np.where(flat > steep, reached / np.maximum(flat, 1e-9), fallen / np.maximum(steep, 1e-9))
    # The normal of the ground leans against its grade.
    sine = (grade * np.abs(along) - z) / np.sqrt(1.0 + grade * grade)
    return GroundHits(distance, np.maximum(sine, np.float32(_GRAZING)), None)


def _profile(hills: Hills, position: Array, sign: float) -> tuple[Array, Array]:
    """Places (n,) from the camera along one side of the hills, the first one 0, and heights (n,) above the camera."""
    known = hills.start + hills.step * np.arange(len(hills.heights))
    ahead = (known - float(hills.along(position))) * sign
    beyond = np.argsort(ahead)[np.count_nonzero(ahead <= _NEAREST) :]
    places = np.concatenate([[0.0], ahead[beyond]])
    heights = np.concatenate([[float(hills.height(position))], hills.heights[beyond]]) - position[2]
    # A level piece at the end, which goes on.
    return np.append(places, places[-1] + hills.step), np.append(heights, heights[-1])


def _meet_profile(places: Array, heights: Array, slope: FloatImage) -> tuple[Array, Array, Array]:
    """Where lines from (0, 0) with slopes (m,) meet the profile: place, how far they fell or rose, and its grade there.

    Lines that never meet it reach infinitely far.
    """
    seen_at = np.append(-np.inf, heights[1:] / places[1:])
    piece = np.searchsorted(np.maximum.accumulate(seen_at), slope, side="left")
    last = np.clip(piece, 1, len(places) - 1)
    length = places[last] - places[last - 1]
    before, after = (slope * places[end] - heights[end] for end in (last - 1, last))
    share = np.clip(before / np.maximum(before - after, 1e-12), 0.0, 1.0)
    grade = (heights[last] - heights[last - 1]) / length
    # What passes over all of it meets the level ground beyond, if it falls.
    beyond, falls = piece >= len(places), slope < 0.0
    far = heights[-1] / np.where(falls, slope, np.float32(-1.0))
    reached = np.where(beyond, far, places[last - 1] + share * length)
    met = ~beyond | (falls & (far >= places[-1]))
    return np.where(met, reached, np.inf), np.where(met, np.abs(slope * reached), np.inf), grade
