"""Moving objects, found by what other frames look through.

A surface that stands still is seen again, or hidden by a nearer one, wherever another frame looks at its place. Where
the other frame sees something farther away instead, the surface was not there at that time: it moves.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import pixel_rays
from olt_generator.distance.depth import FAR_DISTANCE
from olt_generator.poses import invert
from olt_generator.views.front_view import FrontView

# Seconds to the frames that are asked: an object must have left the line of sight, and the place be still in view.
_GAPS = (-1.0, -0.4, 0.4, 1.0)
# The other frame must see at least this many times as far as the surface.
_SEEN_THROUGH = 1.25
# One pixel in so many, along rows and along columns, is tried; its whole block is marked.
_BLOCK = 4


def find_moving(front: FrontView) -> NDArray[np.bool_]:
    """Pixels (n, H, W) of `front` that show something that moves, with a margin; `front.moving` is not read."""
    blocks = np.minimum(front.distance[:, _BLOCK // 2 :: _BLOCK, _BLOCK // 2 :: _BLOCK], np.float32(FAR_DISTANCE))
    # An edge may lie a block aside: only what lies behind all neighbours is surely looked at. On the ego vehicle
    # nothing is looked through.
    kernel = np.ones((3, 3), np.uint8)
    nearest = np.stack([cv2.erode(np.nan_to_num(each, nan=0.0), kernel) for each in blocks])
    moving = np.empty(front.distance.shape, np.bool_)
    rays, times = pixel_rays(front.camera)[_BLOCK // 2 :: _BLOCK, _BLOCK // 2 :: _BLOCK], front.trajectory.times
    offered = times[front.drawn_on]
    for index, each in enumerate(blocks):
        looked_through = np.zeros(each.shape, np.uint8)
        # Frames drawn on that are the wanted gaps away, where the clip has them.
        wanted = times[index] + np.array(_GAPS)
        within = wanted[(wanted >= offered[0]) & (wanted <= offered[-1])]
        for other in sorted(set(front.drawn_on[np.searchsorted(offered, within)].tolist()) - {index}):
            T_other_index = invert(front.camera_poses[other]) @ front.camera_poses[index]
            points = rays * each[..., None] @ T_other_index[:3, :3].T + T_other_index[:3, 3]
            pixels, inside = front.camera.project(points)
            tried = inside & (each < FAR_DISTANCE)
            column, row = np.rint(pixels[tried] / _BLOCK - 0.5).astype(np.int64).clip(0).T
            found = nearest[other][np.minimum(row, each.shape[0] - 1), np.minimum(column, each.shape[1] - 1)]
            looked_through[tried] |= found > _SEEN_THROUGH * np.linalg.norm(points[tried], axis=-1)
        # Single blocks are errors of distance. The middle of an object that moved by less than its size was not looked
        # through, so gaps between its parts are closed, and its outline lies around what was found.
        parts = cv2.morphologyEx(looked_through, cv2.MORPH_OPEN, kernel)
        found = cv2.dilate(cv2.morphologyEx(parts, cv2.MORPH_CLOSE, kernel, iterations=3), kernel, iterations=2)
        moving[index] = cv2.resize(found, front.frames.shape[2:0:-1], interpolation=cv2.INTER_NEAREST)
    return moving
