"""Where the points that were followed lie: an account of the road that does not come from its texture.

The motion and the points that were followed together give a distance to each point. If speed and direction are right,
what lies lowest is the road, one camera height below the camera. If they are not, it lies on a plane somewhere else, or
on none at all: the points then belong to vehicles, or the picture is upside down.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.motion.bundle_adjustment import AdjustedPoses, track_residuals
from olt_generator.motion.track_equations import FeatureTracks
from olt_generator.poses import Array

# Points are used where the directions to them differ by so many times their noise, and agree to so many.
LEAST_PARALLAX = 8.0
LARGEST_RESIDUAL = 3.0
# Points so far to the side and so far ahead, in camera heights, may lie on the road.
FARTHEST_ACROSS, FARTHEST_ALONG = 3.0, 15.0
# The heights of a plane's points scatter by so much, as a logarithm; planes are looked for over this range of heights.
PLANE_WIDTH = 0.3
SEARCHED = np.log([0.001, 5.0])
LEAST_POINTS = 20


@dataclass(frozen=True)
class Plane:
    """Heights of points, as logarithms of camera heights below (or above) the camera.

    Attributes:
        points: how many there are.
        place: where most of them lie together; 0 is the road.
        share: of the points that lie there.
        share_at_road: of the points that lie where the road should be.
    """

    points: int
    place: float
    share: float
    share_at_road: float


def find_planes(
    tracks: FeatureTracks, adjusted: AdjustedPoses, metric: Array, ray_sigma: float, T_rig_camera: Array
) -> tuple[Plane | None, Plane | None]:
    """The planes below and above the camera on which points lie; None where there are too few.

    Args:
        tracks, adjusted: points that were followed and the motion that agrees with them.
        metric: (n,) by which distances found from each keyframe must be multiplied to be metres.
        ray_sigma: angular noise of a ray, radians.
        T_rig_camera: (4, 4) mounting; its rig x is the direction of travel.
    """
    used = _well_placed(tracks, adjusted, ray_sigma)
    height = float(T_rig_camera[2, 3])
    distance = metric[tracks.anchor[used]] / adjusted.inverse_distance[used] / height
    forward, left, up = T_rig_camera[:3, :3] @ tracks.anchor_ray[used].T * distance
    near = (forward > 0.0) & (forward < FARTHEST_ALONG) & (np.abs(left) < FARTHEST_ACROSS)
    return _densest(-up[near & (up < 0.0)]), _densest(up[near & (up > 0.0)])


def _well_placed(tracks: FeatureTracks, adjusted: AdjustedPoses, ray_sigma: float) -> NDArray[np.bool_]:
    """Points (points,) whose distance is well known."""
    count = len(tracks.anchor)
    missed = np.linalg.norm(track_residuals(adjusted, tracks, ray_sigma), axis=1)
    worst, parallax = np.zeros((2, count))
    np.maximum.at(worst, tracks.point, missed)
    anchor = tracks.anchor[tracks.point]
    moved = adjusted.poses[tracks.frame, :3, 3] - adjusted.poses[anchor, :3, 3]
    ray = np.einsum("nij,nj->ni", adjusted.poses[anchor, :3, :3], tracks.anchor_ray[tracks.point])
    seen = np.linalg.norm(np.cross(moved, ray), axis=1) * adjusted.inverse_distance[tracks.point]
    np.maximum.at(parallax, tracks.point, seen)
    return (worst < LARGEST_RESIDUAL) & (parallax > LEAST_PARALLAX * ray_sigma)


def _densest(heights: Array) -> Plane | None:
    place = np.sort(np.log(np.maximum(heights, 1e-6)))
    place = place[(place > SEARCHED[0]) & (place < SEARCHED[1])]
    if len(place) < LEAST_POINTS:
        return None
    until = np.searchsorted(place, place + PLANE_WIDTH, "right")
    inside = until - np.arange(len(place))
    first = int(np.argmax(inside))
    at_road = np.count_nonzero(np.abs(place) < PLANE_WIDTH / 2.0)
    middle = float(np.median(place[first : until[first]]))
    return Plane(len(place), middle, float(inside[first]) / len(place), at_road / len(place))
