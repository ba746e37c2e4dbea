"""Ground contact: what stands on the road has the distance of the road at its foot, whether it moves or not."""

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.poses import Array


def contact_distance(
    is_object: NDArray[np.bool_], road: NDArray[np.float32], camera: Camera, T_rig_camera: Array
) -> NDArray[np.float32]:
    """Metres (h, w) along the rays of upright objects, by the road where the lowest pixel of each column stands.

    Inf where there is no object or its foot does not lie on the road.

    Args:
        is_object: (h, w) pixels of things that stand on the road.
        road: (h, w) metres along the rays to the road, inf above the horizon.
        camera, T_rig_camera: of these pixels; image columns are taken to be upright.
    """
    climb = pixel_rays(camera) @ T_rig_camera[2, :3]
    level = np.sqrt(np.maximum(1.0 - climb**2, 1e-6)).astype(np.float32)
    range_over_ground = np.where(np.isfinite(road), road * level, np.float32(np.inf))
    foot = np.full(is_object.shape, np.inf, np.float32)
    below = np.full(is_object.shape[1], np.inf, np.float32)
    stands = np.zeros(is_object.shape[1], np.bool_)
    for row in range(len(is_object) - 1, -1, -1):
        below = np.where(stands, below, range_over_ground[row])
        stands = is_object[row]
        foot[row, stands] = below[stands]
    return foot / level
