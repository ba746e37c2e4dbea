"""Which pixels show the ego vehicle: the bonnet at the bottom of the image, which is not road."""

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.poses import Array

# Metres along the ray to the road within which a pixel can show the bonnet: its front edge, 1.5 m ahead of a camera
# and half a metre below it, hides the road up to here.
BONNET_REACH = 6.0

# Frames that are looked at, spread over the clip, and metres between two of them so that they show different road.
MOST_FRAMES = 24
FEWEST_FRAMES = 16
LEAST_TRAVEL = 1.5

# A pixel stands still for certain where the slope of its grey levels does not cancel over the frames: what is left of
# it is at least this share, and so many grey levels a pixel. A bonnet has them on this share of its possible area.
LEAST_PERSISTENCE = 0.7
LEAST_SLOPE = 1.5
LEAST_SHARE = 0.1

# Gaps in the bonnet narrower than this part of the image width are closed.
WIDEST_GAP_SHARE = 16


def find_ego_vehicle(
    frames: NDArray[np.uint8], camera: Camera, T_rig_camera: Array, positions: Array, road: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Pixels (H, W) that show the ego vehicle throughout the clip.

    Road runs through a pixel, so that the slopes of its grey levels along the direction in which it runs cancel over
    the frames; on a bonnet they stay. Lane markings run along themselves and show no such slope. What lies below a
    piece of bonnet is bonnet, too. A clip that moves too little shows nothing of the kind, and nothing is found.

    Args:
        frames: (n, H, W, 3) uint8.
        camera, T_rig_camera: their camera, and its pose (4, 4) in the rig.
        positions: (n, 3) camera positions, metres.
        road: (H, W) metres along the rays to the road.
    """
    vehicle = np.zeros(road.shape, np.bool_)
    near = road < BONNET_REACH
    moving = [0]
    for index, position in enumerate(positions):
        if np.linalg.norm(position - positions[moving[-1]]) >= LEAST_TRAVEL:
            moving.append(index)
    if not near.any() or len(moving) < FEWEST_FRAMES:
        return vehicle
    top = int(np.argmax(near.any(axis=1)))
    near = near[top:]
    direction = _direction_of_road(camera, T_rig_camera, np.minimum(road, BONNET_REACH))[top:]
    slopes = []
    for index in moving[:: -(-len(moving) // MOST_FRAMES)]:
        grey = cv2.cvtColor(frames[index][top:], cv2.COLOR_RGB2GRAY).astype(np.float32)
        down, right = np.gradient(cv2.GaussianBlur(grey, (5, 5), 1.0))
        slopes.append((direction[..., 0] * right + direction[..., 1] * down).astype(np.float32))
    left, mean_size = np.abs(np.mean(slopes, axis=0)), np.mean(np.abs(slopes), axis=0)
    certain = near & (left > LEAST_SLOPE) & (left > LEAST_PERSISTENCE * mean_size)
    if certain.sum() < LEAST_SHARE * near.sum():
        return vehicle
    without_specks = cv2.morphologyEx(certain.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    below = np.logical_or.accumulate(without_specks, axis=0)
    # Columns between those that show a piece of bonnet belong to it.
    gap = np.ones((1, 2 * (camera.width // WIDEST_GAP_SHARE // 2) + 1), np.uint8)
    vehicle[top:] = cv2.morphologyEx(below.astype(np.uint8), cv2.MORPH_CLOSE, gap) > 0
    return vehicle


def _direction_of_road(camera: Camera, T_rig_camera: Array, road: NDArray[np.float32]) -> Array:
    """Unit vectors (H, W, 2) along which road at the given distance runs through the image when driving forward."""
    points = pixel_rays(camera) * road[..., None]
    forward = T_rig_camera[0, :3]
    pixels, _ = camera.project(points)
    later_pixels, _ = camera.project(points - 0.01 * forward)
    motion = later_pixels - pixels
    return motion / np.maximum(np.linalg.norm(motion, axis=-1, keepdims=True), 1e-12)
