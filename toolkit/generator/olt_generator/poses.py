"""Rigid motions as 4 x 4 float64 matrices.

Convention: `T_a_b` is the pose of frame b in frame a; it maps points in b to points in a,
`p_a = T_a_b @ [p_b, 1]`, so `T_a_c = T_a_b @ T_b_c`. Quaternions are x, y, z, w. Angles are radians.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

# Camera axes (x right, y down, z forward) of a camera that looks along rig x (x forward, y left, z up).
R_FORWARD_CAMERA: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def make_pose(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Build poses (..., 4, 4) from rotation matrices (..., 3, 3) and translations (..., 3) in metres."""
    rotation = np.asarray(rotation, dtype=np.float64)
    translation = np.asarray(translation, dtype=np.float64)
    pose = np.zeros((*np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1]), 4, 4))
    pose[..., :3, :3] = rotation
    pose[..., :3, 3] = translation
    pose[..., 3, 3] = 1.0
    return pose


def pose_from_quaternion(quaternion_xyzw: ArrayLike, translation: ArrayLike) -> Array:
    """Build poses (..., 4, 4) from quaternions (..., 4), scalar last, and translations (..., 3)."""
    quaternion = np.array(quaternion_xyzw, dtype=np.float64)
    rotation = Rotation.from_quat(quaternion.reshape(-1, 4)).as_matrix()
    return make_pose(rotation.reshape(*quaternion.shape[:-1], 3, 3), translation)


def planar_pose(x: ArrayLike, y: ArrayLike, yaw: ArrayLike, z: ArrayLike = 0.0) -> Array:
    """Build poses (..., 4, 4) that turn by `yaw` about z and stand at (x, y, z)."""
    x, y, yaw, z = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in (x, y, yaw, z)))
    pose = np.zeros((*yaw.shape, 4, 4))
    pose[..., 0, 0] = pose[..., 1, 1] = np.cos(yaw)
    pose[..., 1, 0] = np.sin(yaw)
    pose[..., 0, 1] = -pose[..., 1, 0]
    pose[..., 2, 2] = pose[..., 3, 3] = 1.0
    pose[..., :3, 3] = np.stack([x, y, z], axis=-1)
    return pose


def invert(pose: Array) -> Array:
    """Invert rigid motions (..., 4, 4) through the transpose of the rotation."""
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    return make_pose(rotation, -np.einsum("...ij,...j->...i", rotation, pose[..., :3, 3]))


def transform(pose: Array, points: Array) -> Array:
    """Map points (..., n, 3) by poses (..., 4, 4)."""
    return points @ np.swapaxes(pose[..., :3, :3], -1, -2) + pose[..., None, :3, 3]


def yaw_of(pose: Array) -> Array:
    """Heading (...) about z of poses (..., 4, 4) or rotations (..., 3, 3): the angle of the x axis in the plane."""
    return np.arctan2(pose[..., 1, 0], pose[..., 0, 0])


def camera_pose_in_rig(position: ArrayLike, roll: float, pitch: float, yaw: float) -> Array:
    """Pose T_rig_camera (4, 4) of a camera mounted at `position` (3,) with the given angles.

    Positive pitch is nose down, positive yaw turns left; the rotation is Rz(yaw) Ry(pitch) Rx(roll) applied to a
    camera that looks along rig x.
    """
    mounting = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    return make_pose(mounting @ R_FORWARD_CAMERA, position)


def aim_camera(position: ArrayLike, roll: float, travel_camera: Array) -> Array:
    """Pose T_rig_camera (4, 4) with the pitch and yaw for which the direction `travel_camera` (3,) is rig x."""
    # Rz(yaw) Ry(pitch) turns this direction, which has the roll already, to rig x.
    x, y, z = Rotation.from_rotvec([roll, 0.0, 0.0]).as_matrix() @ R_FORWARD_CAMERA @ travel_camera
    pitch, yaw = np.arctan2(z, x), -np.arctan2(y, np.hypot(x, z))
    return camera_pose_in_rig(position, roll, float(pitch), float(yaw))
