"""Where the cells of a bird's-eye grid are in the images. Toy only: the real model is told no camera geometry.

The grid follows the route that the policy is shown: stations along it, offsets to its left. What a bend, a turn at a
junction and a straight road have in common is the same there, so that few samples teach it. Far beside the route its
cells are wide, and show who comes from the sides.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from olt_generator.poses import Array, invert
from olt_sft_recipes.toy.config import PATCH, ToyPolicyConfig
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, MountedCamera
from olt_toolkit.rigs.rig_files import pav_rig

_STATION = np.arange(-4, 32, dtype=np.float64)
STATIONS: Array = 2.0 + _STATION + 0.022 * _STATION * np.abs(_STATION)
"""Metres along the route, from beside the vehicle's rear on, close ahead finer than far ahead."""
OFFSETS: Array = 0.8 * (np.arange(14, dtype=np.float64) - 6.5)
"""Metres to the left of the route of the cells of which the heads tell."""
_FARTHER = np.array([7.0, 9.5, 13.0, 18.0, 25.0])
ROUTE_OFFSETS: Array = np.concatenate([-_FARTHER[::-1], OFFSETS, _FARTHER])
"""Metres to the left of the route of all cells: who comes from the side is seen far beside it."""
TOLD = slice(len(_FARTHER), -len(_FARTHER))
"""Which of all are OFFSETS."""
FRONT = DEFAULT_VEHICLE.rear_axle_to_bbox_center + DEFAULT_VEHICLE.length / 2.0
"""Metres from the rig's origin to the vehicle's front."""
Indices = NDArray[np.int64]
HEIGHTS = (0.0, 1.5)
"""Metres above the ground at which a cell looks into the images: its foot, and what stands on it."""

_BETWEEN = 4.0


def route_cells(route_xy: Array, curvature: float) -> Array:
    """Centres and headings (stations, offsets, 3) of the cells of the grid in the rig frame.

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
    cells = points[:, None] + ROUTE_OFFSETS[:, None] * normal[:, None]
    return np.concatenate([cells, np.broadcast_to(heading[:, None, None], (*cells.shape[:2], 1))], axis=-1)


def look_up(cells: Array, frame_poses: Array, config: ToyPolicyConfig) -> csr_array:
    """Where cells are in the features of images, as a sparse matrix of weights.

    A cell takes the four features around its place, bilinearly, in every image that shows it, and is their mean.

    Args:
        cells: (n, cells, 2) centres in the rig frame at t0, metres.
        frame_poses: (n, frames, 3) x, y, yaw of the rig at the time of each frame, in the rig frame at t0.
        config: the cameras and the size of their images.

    Returns:
        Rows are (sample, cell, frame), columns (sample, frame, camera, row, column, height) of the features.
    """
    cos, sin = np.cos(frame_poses[:, None, :, 2]), np.sin(frame_poses[:, None, :, 2])
    apart = cells[:, :, None] - frame_poses[:, None, :, :2]
    x, y = cos * apart[..., 0] + sin * apart[..., 1], cos * apart[..., 1] - sin * apart[..., 0]
    samples, _, frames = x.shape
    table = _ground_table(config)
    found = table[_ground_row(x, y).ravel()]
    image = np.broadcast_to(np.arange(samples * frames).reshape(samples, 1, frames), x.shape).ravel()
    features = int(np.prod(_feature_shape(config)))
    columns = found.indices + np.repeat(image * features, np.diff(found.indptr))
    return csr_array((found.data, columns, found.indptr), shape=(x.size, samples * frames * features))


_TABLE_STEP, _TABLE_BEGIN, _TABLE_SIZE = 0.25, (-10.0, -50.0), (360, 400)


def _ground_row(x: Array, y: Array) -> NDArray[np.int64]:
    """Rows of the table of places on the ground; the first is for those beyond it, which nothing sees."""
    row = np.rint((x - _TABLE_BEGIN[0]) / _TABLE_STEP).astype(np.int64)
    column = np.rint((y - _TABLE_BEGIN[1]) / _TABLE_STEP).astype(np.int64)
    inside = (row >= 0) & (row < _TABLE_SIZE[0]) & (column >= 0) & (column < _TABLE_SIZE[1])
    return np.where(inside, 1 + row * _TABLE_SIZE[1] + column, 0)


@lru_cache(maxsize=4)
def _ground_table(config: ToyPolicyConfig) -> csr_array:
    """Weights of features (camera, row, column, height) for places on the ground every quarter of a metre."""
    rig = pav_rig().fitted(config.image_width, config.image_height)
    shape = _feature_shape(config)
    rows, columns = config.feature_size
    x, y = np.indices(_TABLE_SIZE, dtype=np.float64) * _TABLE_STEP
    ground: Array = np.stack([x + _TABLE_BEGIN[0], y + _TABLE_BEGIN[1]], axis=-1).reshape(-1, 2)
    places, features, weights = list[Indices](), list[Indices](), list[Array]()
    for camera, name in enumerate(config.camera_names):
        for index, height in enumerate(HEIGHTS):
            row, column, seen = _project(rig[name], ground, height, config)
            place = np.flatnonzero(seen)
            top, left = np.floor(row[place]), np.floor(column[place])
            for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
                at = (
                    np.clip(top + down, 0, rows - 1).astype(np.int64),
                    np.clip(left + right, 0, columns - 1).astype(np.int64),
                )
                places.append(1 + place)
                features.append(np.ravel_multi_index((camera, *at, index), shape))
                weights.append(np.abs(1 - down - row[place] + top) * np.abs(1 - right - column[place] + left))
    place, feature, weight = np.concatenate(places), np.concatenate(features), np.concatenate(weights)
    images = np.maximum(np.bincount(place, minlength=len(ground) + 1) / 4.0, 1.0)
    weight = (weight / images[place]).astype(np.float32)
    return csr_array((weight, (place, feature)), shape=(len(ground) + 1, int(np.prod(shape))))


def _feature_shape(config: ToyPolicyConfig) -> tuple[int, int, int, int]:
    """Cameras, rows, columns and heights of the features of one frame."""
    return len(config.camera_rows), *config.feature_size, len(HEIGHTS)


def _project(
    mounted: MountedCamera, ground: Array, height: float, config: ToyPolicyConfig
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Row and column in the features, and whether they are seen, of points (n, 2) at one height over the ground."""
    T_camera_rig = invert(mounted.T_rig_camera)
    points = np.column_stack([ground, np.full(len(ground), height)])
    pixels, seen = mounted.camera.project(points @ T_camera_rig[:3, :3].T + T_camera_rig[:3, 3])
    # Pixel centres are whole numbers, and so are the middles of features.
    column = (pixels[..., 0] + 0.5) / PATCH - 0.5
    row = (pixels[..., 1] + 0.5 - config.image_top) / PATCH - 0.5
    return row, column, seen & (row >= -0.5)


def _along(points: Array, distances: Array) -> tuple[Array, Array]:
    """Points (m, 2) and headings (m,) at distances along a polyline (n, 2), straight on beyond its ends."""
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    first, last = steps[[0, -1]] / np.maximum(lengths[[0, -1], None], 1e-6)

    def at(distance: Array) -> Array:
        inside = np.stack([np.interp(distance, arc, column) for column in points.T], axis=-1)
        before, beyond = np.minimum(distance, 0.0)[:, None], np.maximum(distance - arc[-1], 0.0)[:, None]
        return inside + before * first + beyond * last

    # Half the distance between points of a route to either side: headings turn smoothly over its corners.
    chord = at(distances + 0.5 * _BETWEEN) - at(distances - 0.5 * _BETWEEN)
    return at(distances), np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
