"""What other frames of the front camera saw of what a camera sees now.

Everything is taken to stand still; pixels of moving objects must be left out of what is gathered. Each frame says how
far the surfaces lie that it knows of, as the camera sees them: those of its mesh, and the road, which is where it is.
Each pixel is then looked up in the frame, and counts where the frame sees that very surface there.
Of all frames the nearest surface wins. Frames whose distances agree to some per cent show one surface: they are mixed,
mostly from the frame that was nearest to it, and less of a frame close to the edge of what it shows, so that no seam
remains.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.distance.background import road_distance
from olt_generator.poses import Array
from olt_generator.views.surface_mesh import INFINITY, SurfaceMesh, draw_mesh

# Distances that differ by less than this share are one surface: the error of a distance estimate that still serves.
SURFACE_TOLERANCE = 0.15
# Surfaces at least so much nearer than the road stand on it.
_IN_FRONT_OF_ROAD = 0.9
# Metres from which on the road is too flat to be told from what lies behind it.
_FARTHEST_ROAD = 40.0
# Of frames that show one surface, the nearer ones count by this power of how near they were.
_FINENESS_POWER = 6.0
# Pixels over which a frame fades out towards the edge of what it shows.
_FADE = 8.0
# What is narrower than so many pixels and stands alone is not shown.
_SPECK = 3
# Points in a line of the picture as which they are looked up, and the fewest lines of it.
_FOLD = 1024


@dataclass(frozen=True)
class SourceFrame:
    """One frame to gather from.

    Attributes:
        image: (H, W, 3) uint8.
        distance: (H, W) metres along the rays, inf for what is so far that only its direction matters; NaN for what
            must not be taken.
        mesh: the surfaces of `distance`.
        T_target_camera: (4, 4) pose of its camera in the target camera.
    """

    image: NDArray[np.uint8]
    distance: NDArray[np.float32]
    mesh: SurfaceMesh
    T_target_camera: Array


@dataclass(frozen=True)
class Gathered:
    """What several frames show of a view.

    Attributes:
        image: (h, w, 3) uint8, black where none shows anything.
        distance: (h, w) float32 metres from the target; inf where no frame shows anything, `INFINITY` and about it
            for what is only known by its direction.
    """

    image: NDArray[np.uint8]
    distance: NDArray[np.float32]


class _Found:
    """Pixels of the target that a source shows: their numbers (k,), source pixels, and distances from both cameras."""

    def __init__(self, source: SourceFrame, camera: Camera, target: Camera, road: NDArray[np.float32]) -> None:
        surface = draw_mesh(source.mesh, target, source.T_target_camera)
        surface = np.where(surface < _IN_FRONT_OF_ROAD * road, surface, np.minimum(surface, road)).ravel()
        index = np.flatnonzero(surface < 2.0 * INFINITY)
        rotation, translation = (part.astype(np.float32) for part in np.split(source.T_target_camera[:3], [3], axis=1))
        points = (_rays(target).take(index, axis=0) * surface.take(index)[:, None] - translation.T) @ rotation
        pixels, inside = camera.project(points)
        kept = np.flatnonzero(inside)
        last = (camera.width - 1, camera.height - 1)
        pixels = pixels.take(kept, axis=0).clip(0.0, last).astype(np.float32)
        seen = source.distance[np.rint(pixels[:, 1]).astype(np.intp), np.rint(pixels[:, 0]).astype(np.intp)]
        from_source = np.sqrt((points.take(kept, axis=0) ** 2).sum(axis=1))
        with np.errstate(invalid="ignore"):
            agrees = np.abs(np.minimum(seen, np.float32(INFINITY)) - from_source) < SURFACE_TOLERANCE * from_source
        index = index.take(kept)
        shown = np.zeros((target.height, target.width), np.uint8)
        shown.ravel()[index[agrees]] = 1
        shown = cv2.morphologyEx(shown, cv2.MORPH_OPEN, np.ones((_SPECK, _SPECK), np.uint8))
        stays = np.flatnonzero(agrees & (shown.ravel().take(index) > 0))
        self.index = index.take(stays)
        self.pixels = pixels.take(stays, axis=0)
        self.distance = surface.take(self.index)
        fineness = (self.distance / from_source.take(stays)).clip(0.05, 2.0) ** np.float32(_FINENESS_POWER)
        from_edge = cv2.distanceTransform(np.pad(shown, 1), cv2.DIST_L2, 3)[1:-1, 1:-1].ravel().take(self.index)
        self.weight = fineness * np.minimum(from_edge / np.float32(_FADE), 1.0)


def gather(sources: Sequence[SourceFrame], camera: Camera, target: Camera, T_rig_target: Array) -> Gathered:
    """Gather what `sources`, at least one frame of `camera`, show of the view of `target` at `T_rig_target` (4, 4)."""
    road = _road(target, _hashable(T_rig_target))
    found = [_Found(source, camera, target, road) for source in sources]
    nearest = np.full(target.width * target.height, np.inf, np.float32)
    for each in found:
        nearest[each.index] = np.minimum(nearest.take(each.index), each.distance)
    total = np.zeros((len(nearest), 3), np.float32)
    weight = np.zeros(len(nearest), np.float32)
    for source, each in zip(sources, found, strict=True):
        foremost = np.flatnonzero(each.distance < (1.0 + SURFACE_TOLERANCE) * nearest.take(each.index))
        index, share = each.index.take(foremost), each.weight.take(foremost) + np.float32(1e-9)
        total[index] += share[:, None] * _look_up(source.image, each.pixels.take(foremost, axis=0))
        weight[index] += share
    shown = np.isfinite(nearest)
    total[shown] /= weight[shown, None]
    size = (target.height, target.width)
    return Gathered(np.rint(total).astype(np.uint8).reshape(*size, 3), nearest.reshape(size))


def _look_up(image: NDArray[np.uint8], pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Colours (k, 3) of an image at pixels (k, 2), interpolated."""
    # OpenCV takes no maps of more than 32,767 rows, so the list is folded into a picture.
    maps = np.zeros((-(-len(pixels) // _FOLD) or 1, _FOLD, 2), np.float32)
    maps.reshape(-1, 2)[: len(pixels)] = pixels
    found = cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float32).reshape(-1, 3)[: len(pixels)]


@lru_cache(maxsize=16)
def _rays(camera: Camera) -> NDArray[np.float32]:
    return pixel_rays(camera).reshape(-1, 3).astype(np.float32)


def _hashable(pose: Array) -> bytes:
    return np.ascontiguousarray(pose, np.float64).tobytes()


@lru_cache(maxsize=16)
def _road(camera: Camera, pose: bytes) -> NDArray[np.float32]:
    """Distance (h, w) to the road, inf where it is far or there is none."""
    distance = road_distance(camera, np.frombuffer(pose).reshape(4, 4))
    return np.where(distance < _FARTHEST_ROAD, distance, np.float32(np.inf))
