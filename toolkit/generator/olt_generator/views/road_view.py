"""The road as other frames saw it, looked up pixel by pixel instead of splatted.

Seen from far, road covers few pixels, and splatted into a camera close by it falls apart into dots. But where it lies
is known: the point of the plane behind each pixel of the wanted view is looked for in the other frames, and taken where
they see the plane there and nothing in front of it.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.poses import Array
from olt_generator.views.aggregate import SourceFrame

# Metres along the ray from which on road is dense enough to be splatted.
_FARTHEST = 40.0
# Share by which the distance that a frame sees may differ from that of the plane.
_TOLERANCE = 0.1
# Points in a line of the picture as which they are sampled.
_FOLD = 1024


class RoadView:
    """Looks the road up for one target camera."""

    def __init__(self, camera: Camera, target: Camera, T_rig_target: Array) -> None:
        """For frames of `camera` and the camera `target` mounted at `T_rig_target` (4, 4); the road is rig z = 0."""
        self._camera = camera
        rays = pixel_rays(target)
        descent = -(rays @ T_rig_target[2, :3])
        self._road = descent > T_rig_target[2, 3] / _FARTHEST
        # In the axes of the target, in which the sources tell where they stand.
        self._points = rays[self._road] * (T_rig_target[2, 3] / descent[self._road])[:, None]

    def look_up(self, sources: Sequence[SourceFrame]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Image (h, w, 3), black where no source shows road, and where one does (h, w); the nearest source wins."""
        nearest = np.full(len(self._points), np.inf)
        colours = np.zeros((len(self._points), 3), np.uint8)
        for source in sources:
            point, column, row, distance = self._find(source)
            better = distance < nearest[point]
            point = point[better]
            nearest[point] = distance[better]
            # OpenCV takes no maps of more than 32,767 rows, so the list is folded into a picture.
            maps = np.zeros((2, -(-len(point) // _FOLD) or 1, _FOLD), np.float32)
            maps.reshape(2, -1)[:, : len(point)] = column[better], row[better]
            found = cv2.remap(source.image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            colours[point] = np.asarray(found, np.uint8).reshape(-1, 3)[: len(point)]
        image, seen = np.zeros((*self._road.shape, 3), np.uint8), np.zeros(self._road.shape, np.bool_)
        image[self._road], seen[self._road] = colours, np.isfinite(nearest)
        return image, seen

    def _find(self, source: SourceFrame) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32], Array]:
        """Numbers (k,) of the points that a source shows, at which columns and rows (k,), and from how far (k,)."""
        rotation, translation = source.T_target_camera[:3, :3], source.T_target_camera[:3, 3]
        points = (self._points - translation) @ rotation
        pixels, inside = self._camera.project(points)
        point = np.flatnonzero(inside)
        last = (self._camera.width - 1, self._camera.height - 1)
        column, row = pixels[point].clip(0.0, last).astype(np.float32).T
        distance = np.linalg.norm(points[point], axis=1)
        surface = source.distance[np.rint(row).astype(np.intp), np.rint(column).astype(np.intp)]
        with np.errstate(invalid="ignore"):
            agrees = np.abs(surface - distance) < _TOLERANCE * distance
        return point[agrees], column[agrees], row[agrees], distance[agrees]
