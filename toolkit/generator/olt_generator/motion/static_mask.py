"""The static mask: pixels that show what moves with the vehicle instead of the road."""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.motion.features import Gray, detect_corners, track_corners
from olt_generator.poses import Array

# A frame in which a quarter of the points move more than this shows what does not.
MOVING_PIXELS = 1.5
LEAST_FRAMES = 8
MOST_FRAMES = 32
DETAIL_PIXELS = 15
# Farther below the horizon than this, the scene is near enough that it must move when the camera does.
BELOW_HORIZON = np.radians(5.0)


def find_static_mask(
    grays: Sequence[Gray], keyframes: Sequence[int], camera: Camera, T_rig_camera: Array
) -> NDArray[np.bool_]:
    """Pixels (H, W) below the horizon whose detail stays while the scene moves.

    That is the bonnet, an overlay, dirt and reflections in the windscreen, but also lines along the road: none of
    them tells how far the vehicle has driven. Clips with few moving frames give no such pixels. Only some of the
    keyframes, spread over the clip, are looked at.
    """
    pairs = list(pairwise(keyframes))
    moving = []
    for key, later in pairs[:: -(-len(pairs) // MOST_FRAMES)]:
        corners = detect_corners(grays[key], 1)
        moved, found = track_corners(grays[key], grays[later], corners)
        flow = np.linalg.norm(moved - corners, axis=1)[found]
        if len(flow) > 0 and np.percentile(flow, 75) > MOVING_PIXELS:
            moving.append(grays[key])
    if len(moving) < LEAST_FRAMES:
        return np.zeros((camera.height, camera.width), dtype=np.bool_)
    total, squares = np.zeros((2, camera.height, camera.width), dtype=np.float32)
    for image in moving:
        gray = image.astype(np.float32)
        detail = gray - cv2.blur(gray, (DETAIL_PIXELS, DETAIL_PIXELS))
        total += detail
        squares += detail * detail
    # |mean| > standard deviation, both multiplied by the number of frames.
    stays = 2.0 * total**2 > len(moving) * squares
    stays = cv2.dilate(stays.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return stays & (pixel_rays(camera) @ T_rig_camera[2, :3] < -np.sin(BELOW_HORIZON))
