"""The background of a road scene: the road, and beyond it the far."""

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.poses import Array

# Metres at which everything without parallax above the road is placed. Side cameras sit about 1.3 m from the front
# camera: half a degree at this distance, two pixels of a 120 degree view at 576 columns. So sky and the far end of
# the street are in effect warped by the rotation alone, and still lie within the limits of `splat`.
FAR_DISTANCE = 150.0


def road_distance(camera: Camera, T_rig_camera: Array) -> NDArray[np.float32]:
    """Distance (H, W) along each ray to the plane z = 0 of the rig, inf where the ray does not meet it.

    Raises:
        InputError: the camera is not above the plane.
    """
    height = float(T_rig_camera[2, 3])
    if not height > 0.0:
        raise InputError(f"camera height {height:.2f} m: the camera must be mounted above the road; check T_rig_camera")
    descent = -(pixel_rays(camera) @ T_rig_camera[2, :3])
    return np.divide(height, descent, out=np.full(descent.shape, np.inf), where=descent > 0.0).astype(np.float32)


def background_distance(camera: Camera, T_rig_camera: Array) -> NDArray[np.float32]:
    """Distance (H, W) along each ray to the road or, where that is farther, `FAR_DISTANCE`.

    Raises:
        InputError: the camera is not above the road.
    """
    return np.minimum(road_distance(camera, T_rig_camera), np.float32(FAR_DISTANCE))
