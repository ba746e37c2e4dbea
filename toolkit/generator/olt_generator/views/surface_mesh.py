"""The surfaces that one frame sees, as a mesh that another camera can draw.

Points fall apart where a camera comes closer to a surface than the frame that saw it. A mesh does not: pixels that lie
on one surface are joined by quads, and what lies between them is drawn with them. Where the distance leaps from one
pixel to the next nothing joins them, so nothing is drawn; a pixel that agrees with none of its neighbours, as in
foliage whose distances are noise, or on a pole thinner than the mesh, leaves no trace.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.poses import Array

# Share by which the distances at the corners of a quad may differ. A wall differs by so much when seen at four degrees,
# with quads of half a degree.
LARGEST_STEP = 0.15
# Of the nine quads around and with a quad, so many must be whole for it to be drawn.
LEAST_WHOLE = 5
# Target pixels to which a quad may be enlarged; what was seen so coarsely shows nothing.
LARGEST_QUAD = 12
# Metres that stand for infinity: farther than any clip is long, and finite.
INFINITY = 1e6

# Points of a quad that are drawn for each pixel of its longest side, and the numbers of them, so that quads of about
# one size are drawn together.
_DENSITY = 1.25
_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16)
# Of the points of a mesh one in so many is tried, along rows and along columns, to tell which part is in view.
_BLOCK = 8


@dataclass(frozen=True)
class SurfaceMesh:
    """Points that a frame sees on a grid, and the quads between them.

    Attributes:
        points: (rows, columns, 3) float32 in the frame's camera; those of no quad mean nothing.
        whole: (rows - 1, columns - 1) bool, whether the four points around each gap lie on one surface.
    """

    points: NDArray[np.float32]
    whole: NDArray[np.bool_]


def build_mesh(distance: NDArray[np.float32], camera: Camera, step: int = 1) -> SurfaceMesh:
    """Mesh of a frame of `camera` with distances (H, W) along the rays, inf for the far, NaN for what is left out.

    One pixel in `step` is taken, along rows and along columns.
    """
    few = np.s_[step // 2 :: step, step // 2 :: step]
    reach = np.minimum(distance[few], np.float32(INFINITY))
    corners = (reach[:-1, :-1], reach[:-1, 1:], reach[1:, :-1], reach[1:, 1:])
    with np.errstate(invalid="ignore"):
        joined = np.maximum.reduce(corners) <= (1.0 + LARGEST_STEP) * np.minimum.reduce(corners)
    around = cv2.boxFilter(joined.astype(np.float32), -1, (3, 3), normalize=False, borderType=cv2.BORDER_REPLICATE)
    points = pixel_rays(camera)[few] * reach[..., None]
    return SurfaceMesh(points.astype(np.float32), joined & (around > LEAST_WHOLE - 0.5))


def draw_mesh(mesh: SurfaceMesh, target: Camera, T_target_camera: Array) -> NDArray[np.float32]:
    """Distance (h, w) in metres from `target` to the nearest surface of a mesh in each pixel, inf where there is none.

    `T_target_camera` (4, 4) is the pose of the frame's camera in the target. Surfaces seen from behind are not drawn.
    """
    margin = LARGEST_QUAD
    widened = target.cropped(-margin, -margin, target.width + 2 * margin, target.height + 2 * margin)
    drawn = np.full((widened.height, widened.width), np.inf, np.float32)
    rows, columns = _part_in_view(mesh, widened, T_target_camera)
    points: NDArray[Any] = mesh.points[rows, columns] @ T_target_camera[:3, :3].T.astype(np.float32)
    points += T_target_camera[:3, 3].astype(np.float32)
    pixels, inside = widened.project(points)
    # Column, row and inverse distance, which is linear on a plane as the picture shows it.
    with np.errstate(divide="ignore"):
        nearness = 1.0 / np.sqrt(np.einsum("ijk,ijk->ij", points, points))
    vertices = np.concatenate([pixels, nearness[..., None]], axis=-1, dtype=np.float32)
    whole = mesh.whole[rows, columns][: max(0, len(points) - 1), : max(0, points.shape[1] - 1)]
    row, column = np.nonzero(whole & inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, :-1] & inside[1:, 1:])
    a, b, c, d = (vertices[row + down, column + right] for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)))
    side = np.maximum.reduce([np.abs(p - q)[:, :2].max(axis=1) for p, q in ((a, b), (c, d), (a, c), (b, d))])
    falling, rising = d - a, b - c
    faces_target = rising[:, 0] * falling[:, 1] > rising[:, 1] * falling[:, 0]
    side[~faces_target | (side > LARGEST_QUAD)] = np.inf
    fewest = 0
    for count in _COUNTS:
        some = np.flatnonzero((_DENSITY * side > fewest) & (_DENSITY * side <= count))
        fewest = count
        _draw_quads(drawn, np.stack([corner.take(some, axis=0) for corner in (a, b, c, d)]), count)
    return np.ascontiguousarray(drawn[margin:-margin, margin:-margin])


def _part_in_view(mesh: SurfaceMesh, target: Camera, T_target_camera: Array) -> tuple[slice, slice]:
    """Rows and columns of the points around those that the target sees of the few that are tried."""
    few = mesh.points[::_BLOCK, ::_BLOCK] @ T_target_camera[:3, :3].T + T_target_camera[:3, 3]
    row, column = np.nonzero(target.project(few)[1])
    if len(row) == 0:
        return slice(0, 0), slice(0, 0)
    rows, columns = (
        slice(max(0, int(index.min() - 1) * _BLOCK), int(index.max() + 1) * _BLOCK + 1) for index in (row, column)
    )
    return rows, columns


def _draw_quads(drawn: NDArray[np.float32], corners: NDArray[np.float32], count: int) -> None:
    """Put `count`^2 points of each quad with corners (4, k, 3) into the z-buffer."""
    share = ((np.arange(count) + 0.5) / count).astype(np.float32)
    right, down = (part.ravel() for part in np.meshgrid(share, share))
    weights = np.stack([(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down], axis=1)
    column, row, nearness = (weights @ corners[:, :, axis] for axis in range(3))
    index = np.rint(row).astype(np.int32) * drawn.shape[1] + np.rint(column).astype(np.int32)
    np.minimum.at(drawn.ravel(), index.ravel(), (1.0 / nearness).ravel())
