"""What frames of the front camera saw of what another camera sees now.

Except in the frame of the same moment, everything is taken to stand still; pixels of moving objects must be left out.
Each frame says how far the surfaces lie that it knows of, as the camera sees them: those of its mesh, and the road,
which is where it is. Each pixel is then looked up in the frame, and counts where the frame sees that very surface.

What the frame of the same moment shows comes first. Of the others the nearest surface wins. Frames whose distances
agree to some per cent show one surface: they are mixed, mostly from the frame that was nearest to it, and less of a
frame close to the edge of what it shows, so that no seam remains. So the bytes do not depend on the order of the work.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.distance.background import road_distance
from olt_generator.poses import Array
from olt_generator.views.surface_mesh import INFINITY, SurfaceMesh, draw_mesh

# Distances that differ by less than this share are one surface: the error of a distance estimate that still serves.
SURFACE_TOLERANCE = 0.15
# The same for what the same frame shows of itself: only what a crack would show of another surface is to be kept out.
OWN_TOLERANCE = 0.3
# Surfaces at least so much nearer than the road stand on it.
IN_FRONT_OF_ROAD = 0.9
# Metres from which on the road is too flat to be told from what lies behind it.
FARTHEST_ROAD = 40.0
# Of frames that show one surface, the nearer ones count by this power of how near they were.
FINENESS_POWER = 6.0
# What has less than this share of the largest weight is left out.
LEAST_SHARE = 0.1
# Pixels over which a frame fades out towards the edge of what it shows.
FADE = 8
# Pixels of another frame that are not part of a square of this side stand alone, and so do patches of fewer pixels per
# thousand of the image that touch nothing.
SPECK, LEAST_PATCH = 3, 4
# Pixels by which the surfaces of the same frame are extended over the cracks at their edges.
CRACK = 2
# Of the road in view one point in so many is tried, along rows and along columns, to tell what a frame may see of it.
BLOCK = 8
# Points in a line of the picture as which they are looked up.
_FOLD = 1024

Mask = NDArray[np.bool_]
Distance = NDArray[np.float32]


@dataclass(frozen=True)
class SourceFrame:
    """One frame to gather from.

    Attributes:
        image: (H, W, 3) uint8.
        distance: (H, W) metres along the rays, inf for what is so far that only its direction matters; NaN for what
            must not be taken.
        mesh: the surfaces of `distance`.
        T_target_camera: (4, 4) pose of its camera in the target camera.
        brightness: factor that takes its grey levels to those of the wanted image.
    """

    image: NDArray[np.uint8]
    distance: Distance
    mesh: SurfaceMesh
    T_target_camera: Array
    brightness: float = 1.0


@dataclass(frozen=True)
class Gathered:
    """What frames show of a view.

    Attributes:
        image: (h, w, 3) uint8, black where none shows anything.
        distance: (h, w) metres from the target; inf where no frame shows anything, about `INFINITY` for what is only
            known by its direction.
        from_same: (h, w) bool, what the frame of the same moment shows.
    """

    image: NDArray[np.uint8]
    distance: Distance
    from_same: Mask


def gather(
    same: SourceFrame, others: Sequence[SourceFrame], camera: Camera, target: Camera, T_rig_target: Array
) -> Gathered:
    """Gather what frames of `camera` show of the view of `target`, mounted at `T_rig_target` (4, 4).

    `same` is the frame of that moment, which may show moving things. Towards the edge of what it shows it fades into
    those of the `others` that show the same surface.
    """
    size = (target.height, target.width)
    first = _look(same, camera, target, _extended(draw_mesh(same.mesh, target, same.T_target_camera)), OWN_TOLERANCE)
    from_same = _mask(first, target)
    nearest = np.full(target.height * target.width, np.inf, np.float32)
    mixed = np.zeros((len(nearest), 3), np.float32)
    fade = np.ones(len(nearest), np.float32)
    if others:
        road = _road(target, np.asarray(T_rig_target, np.float64).tobytes())
        fade = _fade(from_same)
        wanted = (fade < 1.0).reshape(size)
        shown = [_look_from(source, camera, target, road, wanted) for source in others]
        standing = _without_patches([_mask(each, target) for each in shown], from_same)
        shown = [each.only(standing.ravel().take(each.index)) for each in shown]
        for each in shown:
            nearest[each.index] = np.minimum(nearest.take(each.index), each.distance)
        nearest[first.index] = first.distance
        fade[~_mix(mixed, nearest, others, shown, target)] = 1.0
    nearest[first.index] = first.distance
    mixed[first.index] += fade.take(first.index)[:, None] * (
        _colours(same, first.pixels) - mixed.take(first.index, axis=0)
    )
    return Gathered(np.rint(mixed).astype(np.uint8).reshape(*size, 3), nearest.reshape(size), from_same)


@dataclass(frozen=True)
class _Shown:
    """What one frame shows of the target.

    Attributes:
        index: (k,) numbers of the pixels in the flattened target.
        pixels: (2, k) float32, column and row of each in the frame.
        distance, from_source: (k,) float32 metres from the target and from the frame's camera.
    """

    index: NDArray[np.intp]
    pixels: NDArray[np.float32]
    distance: Distance
    from_source: Distance

    def only(self, kept: Mask) -> "_Shown":
        """Those of the k pixels that are kept (k,)."""
        few = np.flatnonzero(kept)
        if len(few) == len(kept):
            return self
        return _Shown(
            self.index.take(few), self.pixels.take(few, axis=1), self.distance.take(few), self.from_source.take(few)
        )


def _look(source: SourceFrame, camera: Camera, target: Camera, surface: Distance, tolerance: float) -> _Shown:
    """Look for a surface at this distance (h, w) from the target, inf for none, in a frame."""
    index = np.flatnonzero(np.isfinite(surface))
    distance = surface.ravel().take(index)
    rotation, translation = source.T_target_camera[:3, :3], source.T_target_camera[:3, 3:]
    # One row for each axis, so that projections read contiguous memory.
    points: NDArray[Any] = _rays(target).take(index, axis=1)
    points *= distance
    points -= translation.astype(np.float32)
    points = rotation.T.astype(np.float32) @ points
    pixels, inside = camera.project(points.T)
    kept = np.flatnonzero(inside)
    points, pixels = points.take(kept, axis=1), pixels.T.astype(np.float32).take(kept, axis=1)
    np.clip(pixels[0], 0.0, camera.width - 1, out=pixels[0])
    np.clip(pixels[1], 0.0, camera.height - 1, out=pixels[1])
    column, row = np.rint(pixels).astype(np.int32)
    seen = np.minimum(source.distance.ravel().take(row * camera.width + column), np.float32(INFINITY))
    from_source = np.sqrt(np.einsum("ij,ij->j", points, points))
    with np.errstate(invalid="ignore"):
        agrees = np.abs(seen - from_source) < tolerance * from_source
    return _Shown(index.take(kept), pixels, distance.take(kept), from_source).only(agrees)


def _look_from(source: SourceFrame, camera: Camera, target: Camera, road: Distance, wanted: Mask) -> _Shown:
    """What a frame of another moment shows of the wanted pixels (h, w), without specks: its surfaces, and the road."""
    surface = draw_mesh(source.mesh, target, source.T_target_camera)
    in_view = np.where(_may_be_seen(road, camera, target, source.T_target_camera), road, np.float32(np.inf))
    # Road that the frame knows about is put where it is; its mesh places it well, but coarsely.
    is_road = surface > IN_FRONT_OF_ROAD * road
    surface = np.where(wanted, np.where(is_road, in_view, surface), np.float32(np.inf))
    shown = _look(source, camera, target, surface, SURFACE_TOLERANCE)
    parts = cv2.morphologyEx(_mask(shown, target).astype(np.uint8), cv2.MORPH_OPEN, np.ones((SPECK, SPECK), np.uint8))
    return shown.only(parts.ravel().take(shown.index) > 0)


def _may_be_seen(surface: Distance, camera: Camera, target: Camera, T_target_camera: Array) -> Mask:
    """Pixels (h, w) in blocks around those at which a frame sees something at this distance (h, w), inf for nothing."""
    few = np.s_[BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK]
    reach = surface[few]
    points = pixel_rays(target)[few] * np.where(np.isfinite(reach), reach, 0.0)[..., None]
    seen = camera.project((points - T_target_camera[:3, 3]) @ T_target_camera[:3, :3])[1] & np.isfinite(reach)
    blocks = cv2.dilate(seen.astype(np.uint8), np.ones((3, 3), np.uint8))
    return cv2.resize(blocks, (target.width, target.height), interpolation=cv2.INTER_NEAREST) > 0


def _extended(surface: Distance) -> Distance:
    """The surface (h, w) with the cracks between its parts closed from behind."""
    for _ in range(CRACK):
        drawn = np.isfinite(surface)
        behind = cv2.dilate(np.where(drawn, surface, np.float32(0.0)), np.ones((3, 3), np.uint8))
        surface = np.where(drawn | (behind == 0.0), surface, behind)
    return surface


def _without_patches(masks: Sequence[Mask], from_same: Mask) -> Mask:
    """Pixels (h, w) of any mask that hang together with what the same frame shows, or with much else."""
    shown = np.logical_or.reduce([*masks, from_same])
    _, label, stats, _ = cv2.connectedComponentsWithStats(shown.astype(np.uint8), connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= LEAST_PATCH * 1e-3 * shown.size
    large[label[from_same]] = True
    return shown & large[label]


def _mix(
    mixed: NDArray[np.float32],
    nearest: Distance,
    sources: Sequence[SourceFrame],
    shown: Sequence[_Shown],
    target: Camera,
) -> Mask:
    """Put the mean colours of those that show the nearest surface (h w,) into `mixed` (h w, 3); where there are any."""
    shares, weight = [], np.zeros(len(nearest), np.float32)
    for each in shown:
        fineness = (each.distance / each.from_source).clip(0.05, 2.0) ** np.float32(FINENESS_POWER)
        one_surface = np.abs(each.distance - nearest.take(each.index)) < SURFACE_TOLERANCE * each.distance
        shares.append(one_surface * fineness * _fade(_mask(each, target)).take(each.index))
        weight[each.index] = np.maximum(weight.take(each.index), shares[-1])
    largest, weight = weight, np.zeros_like(weight)
    for source, each, share in zip(sources, shown, shares, strict=True):
        counts = np.flatnonzero(share > LEAST_SHARE * largest.take(each.index))
        index, share = each.index.take(counts), share.take(counts)
        weight[index] += share
        mixed[index] += share[:, None] * _colours(source, each.pixels.take(counts, axis=1))
    some = np.flatnonzero(weight)
    mixed[some] /= weight.take(some)[:, None]
    return weight > 0.0


def _mask(shown: _Shown, target: Camera) -> Mask:
    mask = np.zeros((target.height, target.width), np.bool_)
    mask.ravel()[shown.index] = True
    return mask


def _fade(mask: Mask) -> NDArray[np.float32]:
    """1 well inside of a mask (h, w), falling to almost 0 at its edge, flattened (h w,)."""
    # Half of the square around a pixel on a straight edge is inside.
    share = cv2.blur(np.where(mask, np.float32(1.0), np.float32(0.0)), (2 * FADE + 1, 2 * FADE + 1))
    return np.clip(2.0 * share.ravel() - 1.0, np.float32(0.01), np.float32(1.0))


def _colours(source: SourceFrame, pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Colours (k, 3) of a frame at pixels (2, k), interpolated."""
    count = pixels.shape[1]
    # OpenCV takes no maps of more than 32,767 rows, so the list is folded into a picture.
    maps = np.zeros((2, -(-count // _FOLD) or 1, _FOLD), np.float32)
    maps.reshape(2, -1)[:, :count] = pixels
    found = cv2.remap(source.image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours = np.asarray(found).reshape(-1, 3)[:count].astype(np.float32)
    return colours if source.brightness == 1.0 else np.minimum(colours * np.float32(source.brightness), 255.0)


@lru_cache(maxsize=16)
def _rays(camera: Camera) -> NDArray[np.float32]:
    """Unit rays (3, height * width), one row for each axis; read-only."""
    rays = np.ascontiguousarray(pixel_rays(camera).reshape(-1, 3).T, np.float32)
    rays.flags.writeable = False
    return rays


@lru_cache(maxsize=16)
def _road(camera: Camera, pose: bytes) -> Distance:
    """Distance (h, w) to the road from a camera mounted at a pose (4, 4), inf where it is far or there is none."""
    distance = road_distance(camera, np.frombuffer(pose).reshape(4, 4))
    return np.where(distance < FARTHEST_ROAD, distance, np.float32(np.inf))
