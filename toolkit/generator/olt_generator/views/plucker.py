"""Pluecker rays: where the camera ray of each token runs, as the generator's geometry encoder takes it.

A line through o along the unit vector d is (d, m) with moment m = o x d, the same for every point o of the line.
Convention: docs/formats/generator.md.
"""

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, make_pose

# The transformer reads 2 x 2 latent cells of 8 x 8 pixels as one token.
TOKEN_PIXELS = 16
# Moments are divided by this many metres.
MOMENT_SCALE = 25.0
# The released generator refuses features from here on.
LARGEST_FEATURE = 1000.0


def anchor_poses(T_world_front: Array, T_rig_front: Array, T_rig_camera: Array) -> Array:
    """Poses T_anchor_camera (n, 4, 4) of a camera in the frame of the front camera at the first of n moments.

    T_anchor_camera[k] = inv(T_world_front[0]) T_world_front[k] inv(T_rig_front) T_rig_camera. Positions are
    subtracted before they are turned, so that world coordinates of 5000 km cost nothing but their own rounding.
    Poses are (n, 4, 4), mountings (4, 4).
    """
    R_anchor_world = T_world_front[0, :3, :3].T
    T_anchor_front = make_pose(
        R_anchor_world @ T_world_front[:, :3, :3],
        (T_world_front[:, :3, 3] - T_world_front[0, :3, 3]) @ R_anchor_world.T,
    )
    # Exactly no motion, whatever rounding makes of inv(R) R.
    T_anchor_front[0] = np.eye(4)
    return T_anchor_front @ (invert(T_rig_front) @ T_rig_camera)


def plucker_rays(camera: Camera, T_anchor_camera: Array) -> NDArray[np.float32]:
    """Rays (6, n, H / 16, W / 16) of every token at n moments: direction, then moment over 25 m, in the anchor frame.

    Computed in double precision. The ray of the token in row i and column j runs through pixel (16 j + 8, 16 i + 8):
    the released generator divides K by 16 and adds 0.5, which is half a pixel off the token's middle where, as here,
    pixel (0, 0) is the centre of the first pixel. Its weights were trained so. Poses (n, 4, 4) are `anchor_poses`.

    Raises:
        InputError: the image does not fill tokens, a token lies outside of the lens, or a feature reaches 1000.
    """
    direction = token_rays(camera) @ np.swapaxes(T_anchor_camera[:, None, :3, :3], -1, -2)
    moment = np.cross(T_anchor_camera[:, None, None, :3, 3], direction) / MOMENT_SCALE
    features = np.moveaxis(np.concatenate([direction, moment], axis=-1), -1, 0)
    largest = float(np.abs(features).max())
    if not largest < LARGEST_FEATURE:
        moment_index = int(np.argmax(~(np.abs(features).max(axis=(0, 2, 3)) < LARGEST_FEATURE)))
        raise InputError(
            f"Pluecker rays: a feature of {largest:.4g} at moment {moment_index}; {LARGEST_FEATURE:.0f} means that the "
            f"camera is {LARGEST_FEATURE * MOMENT_SCALE / 1e3:.0f} km from the anchor; check the poses or cut the clip"
        )
    return features.astype(np.float32)


def token_rays(camera: Camera) -> Array:
    """Unit rays (H / 16, W / 16, 3) of the tokens in the camera frame.

    Raises:
        InputError: the image does not fill tokens, or a token lies outside of the lens.
    """
    if camera.width % TOKEN_PIXELS or camera.height % TOKEN_PIXELS:
        raise InputError(
            f"images of {camera.width} x {camera.height} pixels do not fill tokens of {TOKEN_PIXELS} x {TOKEN_PIXELS}"
        )
    columns, rows = camera.width // TOKEN_PIXELS, camera.height // TOKEN_PIXELS
    u, v = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64))
    rays = camera.rays(TOKEN_PIXELS * (np.stack([u, v], axis=-1) + 0.5))
    if not np.isfinite(rays).all():
        raise InputError("the lens model does not reach all tokens; give a wider max_angle or a smaller image")
    return rays
