"""Poses, cameras and images of AlpaSim's contract as we have them, and back.

Convention: the wire's poses are float32, with quaternions w, x, y, z; ours are float64 matrices `T_a_b`. Times are
unsigned on the wire.
"""

from collections.abc import Iterable
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_closed_loop.drivers import contract
from olt_generator.errors import InputError
from olt_generator.lenses.ftheta import FthetaCamera
from olt_generator.poses import Array, pose_from_quaternion
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import MountedCamera

LATEST_TIME_US = 2**62
"""Later times are refused: what is added to them must stay within 64 bits."""
QUATERNION_TOLERANCE = 0.01
JPEG_QUALITY = 95
"""Of AlpaSim's own images (docs/formats/alpasim.md)."""

ImageFormat = Literal["jpeg", "png"]


def write_trajectory(timestamps_us: Iterable[int], poses: Array) -> Any:
    """The message `Trajectory` of poses (n, 4, 4)."""
    trajectory = contract.Trajectory()
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat().tolist()
    for time_us, (x, y, z), (qx, qy, qz, qw) in zip(timestamps_us, poses[:, :3, 3].tolist(), quaternions, strict=True):
        entry = trajectory.poses.add()
        entry.timestamp_us = time_us
        position, rotation = entry.pose.vec, entry.pose.quat
        position.x, position.y, position.z = x, y, z
        rotation.w, rotation.x, rotation.y, rotation.z = qw, qx, qy, qz
    return trajectory


def write_pose(pose: Array) -> Any:
    """The message `Pose` of a pose (4, 4)."""
    return write_trajectory([0], pose[None]).poses[0].pose


def read_trajectory(trajectory: Any, what: str) -> tuple[NDArray[np.int64], Array]:
    """Times (n,) in microseconds and poses (n, 4, 4) of a message `Trajectory`, in its order.

    Raises:
        InputError: a number is not finite, a quaternion not of unit length, or a time beyond all clocks.
    """
    entries = trajectory.poses
    times = [entry.timestamp_us for entry in entries]
    if any(time_us >= LATEST_TIME_US for time_us in times):
        raise InputError(f"{what}: a time of {max(times)} us; give microseconds below 2^62")
    return np.array(times, dtype=np.int64), _read_poses([entry.pose for entry in entries], what)


def read_pose(pose: Any, what: str) -> Array:
    """Pose (4, 4) of a message `Pose`; raises as `read_trajectory`."""
    return _read_poses([pose], what)[0]


def _read_poses(poses: list[Any], what: str) -> Array:
    if not poses:
        return np.zeros((0, 4, 4))
    numbers = np.array([(*(p.vec.x, p.vec.y, p.vec.z), *(p.quat.x, p.quat.y, p.quat.z, p.quat.w)) for p in poses])
    if not np.isfinite(numbers).all():
        raise InputError(f"{what}: pose {int(np.argmin(np.isfinite(numbers).all(axis=1)))} is not finite")
    lengths = np.linalg.norm(numbers[:, 3:], axis=1)
    wrong = np.abs(lengths - 1.0) > QUATERNION_TOLERANCE
    if wrong.any():
        index = int(np.argmax(wrong))
        raise InputError(f"{what}: the quaternion of pose {index} has length {lengths[index]:.3g} instead of 1")
    return pose_from_quaternion(numbers[:, 3:], numbers[:, :3])


def poses_at(times_us: NDArray[np.int64], poses: Array, wanted_us: NDArray[np.int64]) -> Array:
    """Poses (m, 4, 4) at times within those of known ones (n, 4, 4); times that are all known need no interpolation.

    Raises:
        InputError: a wanted time lies outside, or known times do not increase.
    """
    trajectory = Trajectory(times_us, poses)
    index = np.minimum(np.searchsorted(times_us, wanted_us), len(times_us) - 1)
    return poses[index] if np.array_equal(times_us[index], wanted_us) else trajectory.interpolate(wanted_us)


def write_vector(vector: Iterable[float]) -> Any:
    """The message `Vec3` of three numbers."""
    x, y, z = vector
    return contract.Vec3(x=float(x), y=float(y), z=float(z))


def read_vector(vector: Any, what: str) -> Array:
    """The three numbers (3,) of a message `Vec3`.

    Raises:
        InputError: one is not finite.
    """
    numbers = np.array([vector.x, vector.y, vector.z])
    if not np.isfinite(numbers).all():
        raise InputError(f"{what} is not finite")
    return numbers


def write_camera(name: str, mounted: MountedCamera) -> Any:
    """The message `AvailableCamera` of a camera of the rig, an f-theta one.

    The wire multiplies offsets from the principal point by [[c, d], [e, 1]] after its polynomial: with pixels that are
    not square the polynomial is that of the height.
    """
    camera = mounted.camera
    if not isinstance(camera, FthetaCamera):
        raise InputError(f"camera {name}: a driver is told f-theta lenses only, not {type(camera).__name__}")
    message = contract.AvailableCamera(logical_id=name)
    message.rig_to_camera.CopyFrom(write_pose(mounted.T_rig_camera))
    spec = message.intrinsics
    spec.logical_id, spec.resolution_h, spec.resolution_w = name, camera.height, camera.width
    spec.shutter_type = contract.SHUTTER_GLOBAL
    lens = spec.ftheta_param
    lens.principal_point_x, lens.principal_point_y = camera.cx, camera.cy
    lens.reference_poly = 2 if camera.primary == "forward" else 1
    lens.angle_to_pixeldist_poly.extend(coefficient / camera.aspect for coefficient in camera.fw_poly)
    lens.pixeldist_to_angle_poly.extend(
        coefficient * camera.aspect**power for power, coefficient in enumerate(camera.bw_poly)
    )
    lens.max_angle = camera.max_angle if np.isfinite(camera.max_angle) else np.pi
    lens.linear_cde.linear_c = camera.aspect
    return message


def encode_image(image: NDArray[np.uint8], coding: ImageFormat) -> bytes:
    """An image (3, H, W) RGB as a JPEG or PNG file."""
    pixels = np.ascontiguousarray(image[::-1].transpose(1, 2, 0))
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if coding == "jpeg" else []
    return cv2.imencode(f".{coding}", pixels, options)[1].tobytes()


def decode_image(content: bytes, size: tuple[int, int], where: str) -> NDArray[np.uint8]:
    """A JPEG or PNG file as (3, H, W) RGB of that height and width: scaled by one factor, cropped about the centre.

    Raises:
        InputError: it is neither, damaged, or far too large.
    """
    from olt_toolkit.recordings.pictures import decode_picture

    if not content.startswith((b"\xff\xd8\xff", b"\x89PNG\r\n")):
        raise InputError(f"{where}: {len(content)} bytes that are neither a JPEG nor a PNG image")
    pixels = decode_picture(content, where)
    if pixels.shape[:2] != size:
        pixels = _fit(pixels, size)
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))


def _fit(pixels: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Cut the middle that has the wanted shape, and scale it."""
    (rows, columns), (height, width) = pixels.shape[:2], size
    factor = max(height / rows, width / columns)
    kept_rows, kept_columns = max(1, round(height / factor)), max(1, round(width / factor))
    top, left = (rows - kept_rows) // 2, (columns - kept_columns) // 2
    middle = pixels[top : top + kept_rows, left : left + kept_columns]
    interpolation = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(middle, (width, height), interpolation=interpolation), np.uint8)
