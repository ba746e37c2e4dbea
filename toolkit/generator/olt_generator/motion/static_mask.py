"""The static mask: pixels that show what moves with the vehicle instead of the road."""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.motion.features import Gray, detect_corners, track_corners
from olt_generator.poses import Array

# A frame in which most of the points move more than this shows what does not. Most, because a vehicle that stands sees
# others drive by.
MOVING_PIXELS = 1.5
MOVING_SHARE = 0.7
LEAST_FRAMES = 8
MOST_FRAMES = 32
DETAIL_PIXELS = 15
# Farther below the horizon than this, the scene is near enough that it must move when the camera does.
BELOW_HORIZON = np.radians(5.0)


def choose_moving(grays: Sequence[Gray], keyframes: Sequence[int]) -> list[int]:
    """Those of the keyframes in which the scene moves; only some, spread over the clip, are looked at, at half size."""
    pairs = list(pairwise(keyframes))
    moving = []
    for key, later in pairs[:: -(-len(pairs) // MOST_FRAMES)]:
        first, second = (np.asarray(cv2.pyrDown(grays[index]), np.uint8) for index in (key, later))
        corners = detect_corners(first, 1)
        moved, found = track_corners(first, second, corners)
        flow = 2.0 * np.linalg.norm(moved - corners, axis=1)[found]
        if len(flow) > 0 and np.percentile(flow, 100.0 * (1.0 - MOVING_SHARE)) > MOVING_PIXELS:
            moving.append(key)
    return moving


def find_static_mask(images: Sequence[Gray], camera: Camera, T_rig_camera: Array) -> NDArray[np.bool_]:
    """Pixels (H, W) below the horizon whose detail stays in images between which the scene moves.

    That is the bonnet, an overlay, dirt and reflections in the windscreen, but also lines along the road: none of
    them tells how far the vehicle has driven. Few images give no such pixels; of many, some are looked at.
    """
    if len(images) < LEAST_FRAMES:
        return np.zeros((camera.height, camera.width), dtype=np.bool_)
    looked_at = images[:: -(-len(images) // MOST_FRAMES)]
    total, squares = np.zeros((2, camera.height, camera.width), dtype=np.float32)
    for image in looked_at:
        gray = image.astype(np.float32)
        detail = gray - cv2.blur(gray, (DETAIL_PIXELS, DETAIL_PIXELS))
        total += detail
        squares += detail * detail
    # |mean| > standard deviation, both multiplied by the number of frames.
    stays = 2.0 * total**2 > len(looked_at) * squares
    stays = cv2.dilate(stays.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return stays & (pixel_rays(camera) @ T_rig_camera[2, :3] < -np.sin(BELOW_HORIZON))
