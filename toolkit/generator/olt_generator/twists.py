"""Rigid motions as exponentials of twists.

A twist (..., 6) is a translation and a rotation vector in the axes of the moving body. A body that moves for one second
with constant velocity v and turn rate w, both in its own axes, goes from T to `T @ exponential([v, w])`. Equations:
Barfoot, State Estimation for Robotics, chapter 7; the translation comes first here as it does there.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from olt_generator.poses import Array, make_pose

# Below this angle in radians the closed forms lose digits to cancellation and series take their place.
_SMALL_ANGLE = 1e-2
# Terms of the series of the right Jacobian; the next one is below 1e-4 for half a radian.
_JACOBIAN_TERMS = 6


def exponential(twist: Array) -> Array:
    """Poses (..., 4, 4) reached from the identity along twists (..., 6)."""
    rotation_vector = twist[..., 3:]
    angle, safe, small = _angles(rotation_vector)
    linear = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    square = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    # The left Jacobian of SO(3): the mean rotation on the way.
    translation = np.matmul(_polynomial(rotation_vector, linear, square), twist[..., :3, None])[..., 0]
    return make_pose(rotation_from_vector(rotation_vector), translation)


def logarithm(pose: Array) -> Array:
    """Twists (..., 6) that lead from the identity to poses (..., 4, 4); angles are at most pi."""
    rotation_vector = vector_from_rotation(pose[..., :3, :3])
    angle, safe, small = _angles(rotation_vector)
    closed = (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2
    square = np.where(small, 1.0 / 12.0 + angle**2 / 720.0, closed)
    inverse_jacobian = _polynomial(rotation_vector, np.full_like(angle, -0.5), square)
    translation = np.matmul(inverse_jacobian, pose[..., :3, 3:])[..., 0]
    return np.concatenate([translation, rotation_vector], axis=-1)


def rotation_from_vector(vector: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    return Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix().reshape(*vector.shape[:-1], 3, 3)


def vector_from_rotation(rotation: Array) -> Array:
    """Rotation vectors (..., 3) of rotation matrices (..., 3, 3)."""
    return Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec().reshape(rotation.shape[:-1])


def adjoint(pose: Array) -> Array:
    """Matrices (..., 6, 6) that carry twists in the body's axes to the axes in which poses (..., 4, 4) are given."""
    rotation = pose[..., :3, :3]
    result = np.zeros((*pose.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotation
    result[..., :3, 3:] = cross_matrix(pose[..., :3, 3]) @ rotation
    return result


def right_jacobian(twist: Array) -> Array:
    """Matrices J (..., 6, 6) with exponential(twist + d) = exponential(twist) @ exponential(J @ d) for small d."""
    bracket = np.zeros((*twist.shape[:-1], 6, 6))
    bracket[..., :3, :3] = bracket[..., 3:, 3:] = cross_matrix(twist[..., 3:])
    bracket[..., :3, 3:] = cross_matrix(twist[..., :3])
    result = np.broadcast_to(np.eye(6), bracket.shape)
    for term in range(_JACOBIAN_TERMS, 1, -1):
        result = np.eye(6) - bracket @ result / term
    return result


def dot_rows(a: Array, b: Array) -> Array:
    """Products (n,) of vectors given by their components (3, n)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross_rows(a: Array, b: Array) -> Array:
    """`np.cross` of vectors given by their components (3, n), which keeps what is read and written contiguous."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def cross_matrix(vector: Array) -> Array:
    """Matrices (..., 3, 3) whose product with a vector is the cross product of `vector` (..., 3) with it."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vector.shape[:-1], 3, 3)


def _angles(rotation_vector: Array) -> tuple[Array, Array, Array]:
    angle = np.sqrt(np.sum(rotation_vector**2, axis=-1))
    small = angle < _SMALL_ANGLE
    return angle, np.where(small, 1.0, angle), small


def _polynomial(vector: Array, linear: Array, square: Array) -> Array:
    cross = cross_matrix(vector)
    return np.eye(3) + linear[..., None, None] * cross + square[..., None, None] * (cross @ cross)
