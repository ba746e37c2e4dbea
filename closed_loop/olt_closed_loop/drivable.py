"""Where a vehicle may drive, and when a rollout leaves it."""

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from olt_closed_loop.collisions import MovingBox
from olt_closed_loop.scene import Scene
from olt_generator.poses import Array

TOLERANCE = 1e-3
"""Metres by which the area is widened, so that outlines that share an edge leave no crack between them."""


def drivable_area(scene: Scene, origin: Array) -> BaseGeometry:
    """The union of the scene's drivable outlines, in the plane and relative to `origin` (2,)."""
    outlines = [shapely.Polygon(outline[:, :2] - origin) for outline in scene.drivable]
    area = shapely.union_all([shapely.make_valid(outline) for outline in outlines]).buffer(TOLERANCE)
    shapely.prepare(area)
    return area


def first_departure(scene: Scene, ego: MovingBox, times: NDArray[np.int64]) -> int | None:
    """The first of the times (n,) at which some part of the ego's box is outside the drivable area, or None."""
    origin = ego.poses[0, :2]
    poses = ego.at(times)
    outside = ~shapely.covers(drivable_area(scene, origin), _rectangles(poses, ego.half_size, origin))
    return int(times[np.argmax(outside)]) if outside.any() else None


def _rectangles(poses: Array, half_size: Array, origin: Array) -> NDArray[np.object_]:
    """Polygons (n,) of boxes at poses (n, 4)."""
    cos, sin = np.cos(poses[:, 3]), np.sin(poses[:, 3])
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * half_size[:2]
    x = poses[:, :1] - origin[0] + cos[:, None] * corners[:, 0] - sin[:, None] * corners[:, 1]
    y = poses[:, 1:2] - origin[1] + sin[:, None] * corners[:, 0] + cos[:, None] * corners[:, 1]
    return np.asarray(shapely.polygons(np.stack([x, y], axis=-1)))
