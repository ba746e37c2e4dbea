"""Where the cells of two bird's-eye grids are in the images. Toy only: the real model is told no camera geometry.

The route grid follows the route that the policy is shown: stations along it, offsets to its left. What a bend, a turn
at a junction and a straight road have in common is the same there, so that few samples teach it. The world grid lies
square ahead of the vehicle and shows who comes from the sides.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array, invert
from olt_sft_recipes.toy.config import PATCH, ToyPolicyConfig
from olt_toolkit.rigs.rig import MountedCamera
from olt_toolkit.rigs.rig_files import pav_rig

_STATION = np.arange(32)
STATIONS: Array = 2.0 + _STATION + 0.022 * _STATION**2
"""Metres along the route, close ahead finer than far ahead."""
OFFSETS: Array = 0.8 * (np.arange(14) - 6.5)
"""Metres to the left of the route."""
WORLD_CELL = 2.5
WORLD_X: Array = -6.0 + WORLD_CELL * np.arange(24)
WORLD_Y: Array = WORLD_CELL * (np.arange(24) - 11.5)
"""Metres ahead and to the left of the rig."""
HEIGHTS = (0.0, 1.2)
"""Metres above the ground at which a cell looks into the images: its foot, and what stands on it."""

ROUTE_CELLS, WORLD_CELLS = len(STATIONS) * len(OFFSETS), len(WORLD_X) * len(WORLD_Y)
_BETWEEN = 4.0


def route_cells(route_xy: Array, curvature: float) -> Array:
    """Centres and headings (stations, offsets, 3) of the cells of the route grid in the rig frame.

    Args:
        route_xy: (n, 2) route ahead; with fewer than two points the way of the present curvature stands for it.
        curvature: of the vehicle's way now, 1/m.
    """
    known = route_xy[~np.isnan(route_xy[:, 0])] if len(route_xy) else route_xy
    if len(known) < 2:
        angle = curvature * np.linspace(0.0, 30.0, 10)
        known = np.linspace(0.0, 30.0, 10)[:, None] * np.stack(
            [np.sinc(angle / np.pi), 0.5 * angle * np.sinc(0.5 * angle / np.pi) ** 2], axis=-1
        )
    points, heading = _along(known, STATIONS)
    normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    cells = points[:, None] + OFFSETS[:, None] * normal[:, None]
    return np.concatenate([cells, np.broadcast_to(heading[:, None, None], (*cells.shape[:2], 1))], axis=-1)


def world_cells() -> Array:
    """Centres and headings (rows, columns, 3) of the cells of the world grid in the rig frame."""
    x, y = np.meshgrid(WORLD_X, WORLD_Y, indexing="ij")
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


@dataclass(frozen=True)
class Lookup:
    """Where the cells of a grid are in the features of images: a sparse matrix of weights in CSR form.

    Rows are (sample, cell, frame); columns are (sample, camera, frame, row, column, height) of features. A cell takes
    the four features around its place, bilinearly, in every image that shows it, and is the mean over those.

    Attributes:
        begins: (rows + 1,) int64, where the entries of each row begin.
        columns, weights: (entries,) int64 and float32.
        cells: of each sample.
    """

    begins: NDArray[np.int64]
    columns: NDArray[np.int64]
    weights: NDArray[np.float32]
    cells: int


def look_up(cells: Array, frame_poses: Array, config: ToyPolicyConfig) -> Lookup:
    """Find cells in images.

    Args:
        cells: (n, cells, 2) centres in the rig frame at t0, metres.
        frame_poses: (n, frames, 3) x, y, yaw of the rig at the time of each frame, in the rig frame at t0.
        config: the cameras and the size of their images.
    """
    cos, sin = np.cos(frame_poses[:, None, :, 2]), np.sin(frame_poses[:, None, :, 2])
    apart = cells[:, :, None] - frame_poses[:, None, :, :2]
    x, y = cos * apart[..., 0] + sin * apart[..., 1], cos * apart[..., 1] - sin * apart[..., 0]
    rows, columns = config.feature_size
    samples, count, frames = x.shape
    images = (samples, len(config.camera_rows), frames, rows, columns, len(HEIGHTS))
    entries: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]] = []
    for camera, mounted in enumerate(_cameras(config)):
        for index, height in enumerate(HEIGHTS):
            row, column, seen = _project(mounted, x, y, height, config)
            cell = np.flatnonzero(seen)
            sample, _, frame = np.unravel_index(cell, x.shape)
            row, column = row[seen], column[seen]
            top, left = np.floor(row).astype(np.int64), np.floor(column).astype(np.int64)
            for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
                weight = np.abs(1 - down - (row - top)) * np.abs(1 - right - (column - left))
                at = np.clip(top + down, 0, rows - 1), np.clip(left + right, 0, columns - 1)
                place = np.ravel_multi_index((sample, np.full_like(sample, camera), frame, *at), images[:-1])
                entries.append((cell, place * len(HEIGHTS) + index, weight.astype(np.float32)))
    cell, places, weights = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    order = np.argsort(cell, kind="stable")
    cell, counts = cell[order], np.bincount(cell, minlength=x.size)
    share = (4.0 / np.maximum(counts, 1)).astype(np.float32)
    begins = np.concatenate([[0], np.cumsum(counts)])
    return Lookup(begins, places[order], weights[order] * share[cell], count)


@lru_cache(maxsize=4)
def _cameras(config: ToyPolicyConfig) -> tuple[MountedCamera, ...]:
    rig = pav_rig().fitted(config.image_width, config.image_height)
    return tuple(rig[name] for name in config.camera_names)


def _project(
    mounted: MountedCamera, x: Array, y: Array, height: float, config: ToyPolicyConfig
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Row and column in the features, and whether they are seen, of points of the rig frame at one height."""
    T = invert(mounted.T_rig_camera).astype(np.float32)
    points = np.stack([x, y, np.full_like(x, height)], axis=-1).astype(np.float32) @ T[:3, :3].T + T[:3, 3]
    pixels, seen = mounted.camera.project(points)
    # Pixel centres are whole numbers, and so are the middles of features.
    column = (pixels[..., 0] + 0.5) / PATCH - 0.5
    row = (pixels[..., 1] + 0.5 - config.image_top) / PATCH - 0.5
    return row.astype(np.float32), column.astype(np.float32), seen & (row >= -0.5)


def _along(points: Array, distances: Array) -> tuple[Array, Array]:
    """Points (m, 2) and headings (m,) at distances along a polyline (n, 2), straight on beyond its end."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    last = (points[-1] - points[-2]) / max(lengths[-1], 1e-6)

    def at(distance: Array) -> Array:
        inside = np.stack([np.interp(distance, arc, column) for column in points.T], axis=-1)
        return inside + np.maximum(distance - arc[-1], 0.0)[:, None] * last

    # Half the distance between points of a route to either side: headings turn smoothly over its corners.
    chord = at(distances + 0.5 * _BETWEEN) - at(np.maximum(distances - 0.5 * _BETWEEN, 0.0))
    return at(distances), np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
