"""The surfaces that one frame sees, as a mesh that another camera can draw.

Points fall apart where a camera comes closer to a surface than the frame that saw it. A mesh does not: pixels that lie
on one surface are joined by quads, and what lies between them is drawn with them. Where the distance leaps from one
pixel to the next nothing joins them, so nothing is drawn; a pixel that agrees with none of its neighbours, as in
foliage whose distances are noise, or a thin pole, leaves no trace.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.poses import Array

# Columns that a frame is reduced to: as fine as distances by parallax are (`depth.SweepSettings`), or finer.
COLUMNS = 208
# Share by which the distances at the corners of a quad may differ. A wall differs by so much when seen at four degrees.
LARGEST_STEP = 0.15
# Of the nine quads around and with a quad, so many must be whole for it to be drawn.
LEAST_WHOLE = 5
# Metres that stand for infinity: farther than any clip is long, and finite.
INFINITY = 1e6
# Target pixels to which a quad may be enlarged; what was seen so coarsely shows nothing.
LARGEST_QUAD = 24
_STEPS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)


@dataclass(frozen=True)
class SurfaceMesh:
    """Points that a frame sees on a grid, and the quads between them.

    Attributes:
        points: (rows, columns, 3) float32 in the frame's camera; those of no quad mean nothing.
        whole: (rows - 1, columns - 1) bool, whether the four points around each gap lie on one surface.
    """

    points: NDArray[np.float32]
    whole: NDArray[np.bool_]


def build_mesh(distance: NDArray[np.float32], camera: Camera) -> SurfaceMesh:
    """Mesh of a frame of `camera` with distances (H, W) along the rays, inf for the far, NaN for what is left out."""
    step = max(1, round(camera.width / COLUMNS))
    few = np.s_[step // 2 :: step, step // 2 :: step]
    reach = np.minimum(distance[few], np.float32(INFINITY))
    corners = [reach[:-1, :-1], reach[:-1, 1:], reach[1:, :-1], reach[1:, 1:]]
    nearest, farthest = np.minimum.reduce(corners), np.maximum.reduce(corners)
    with np.errstate(invalid="ignore"):
        joined = farthest <= (1.0 + LARGEST_STEP) * nearest
    around = cv2.boxFilter(joined.astype(np.float32), -1, (3, 3), normalize=False, borderType=cv2.BORDER_REPLICATE)
    whole = joined & (around >= LEAST_WHOLE)
    return SurfaceMesh((pixel_rays(camera)[few] * reach[..., None]).astype(np.float32), whole)


def draw_mesh(mesh: SurfaceMesh, target: Camera, T_target_camera: Array) -> NDArray[np.float32]:
    """Distance (h, w) in metres from `target` to the nearest surface of the mesh in each pixel, inf where there is none.

    `T_target_camera` (4, 4) is the pose of the frame's camera in the target. Surfaces seen from behind are not drawn.
    """
    rotation, translation = T_target_camera[:3, :3].astype(np.float32), T_target_camera[:3, 3].astype(np.float32)
    points = mesh.points @ rotation.T + translation
    widened = target.cropped(
        -LARGEST_QUAD, -LARGEST_QUAD, target.width + 2 * LARGEST_QUAD, target.height + 2 * LARGEST_QUAD
    )
    pixels, inside = widened.project(points)
    pixels = pixels.astype(np.float32)
    drawn = np.full((widened.height, widened.width), np.inf, np.float32)
    whole = mesh.whole & inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, :-1] & inside[1:, 1:]
    row, column = np.nonzero(whole)
    # Corners (4, k, 3) as column, row and inverse distance, which is linear on a plane as the picture shows it.
    nearness = 1.0 / np.sqrt((points * points).sum(axis=-1))
    vertices = np.concatenate([pixels, nearness[..., None]], axis=-1)
    a, b, c, d = (vertices[row + down, column + right] for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)))
    side = np.maximum.reduce([np.abs(one - other)[:, :2].max(axis=1) for one, other in ((a, b), (c, d), (a, c), (b, d))])
    first, second = (b - c)[:, :2], (d - a)[:, :2]
    faces = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] > 0.0
    samples = np.ceil(1.25 * side + 0.25)
    lower = 0
    for steps in _STEPS:
        some = np.flatnonzero(faces & (samples > lower) & (samples <= steps) & (side <= LARGEST_QUAD))
        lower = steps
        if len(some):
            _draw_quads(drawn, steps, *(corner[some] for corner in (a, b, c, d)))
    inner = drawn[LARGEST_QUAD:-LARGEST_QUAD, LARGEST_QUAD:-LARGEST_QUAD]
    return np.ascontiguousarray(inner)


def _draw_quads(
    drawn: NDArray[np.float32],
    steps: int,
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    d: NDArray[np.float32],
) -> None:
    """Put `steps`^2 points of each quad with corners (k, 3) into the z-buffer."""
    share = ((np.arange(steps) + 0.5) / steps).astype(np.float32)
    right, down = share[None, :, None], share[:, None, None]
    weights = np.stack(
        [w.ravel() for w in ((1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down)]
    )
    column, row, nearness = (
        np.einsum("ik,ij->jk", np.stack([corner[:, axis] for corner in (a, b, c, d)]), weights) for axis in range(3)
    )
    index = np.rint(row).astype(np.int32) * drawn.shape[1] + np.rint(column).astype(np.int32)
    np.minimum.at(drawn.ravel(), index.ravel(), (1.0 / nearness).ravel())
