"""Pluecker rays of a drive at map coordinates of 5000 km: precision of the arithmetic against time."""

from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import PinholeCamera
from olt_generator.poses import Array, camera_pose_in_rig, make_pose, planar_pose
from olt_generator.views.plucker import MOMENT_SCALE, anchor_poses, plucker_rays
from olt_toolkit.bench.benchmark import Benchmark, list_settings

CAMERA = PinholeCamera.from_field_of_view(832, 480, float(np.radians(100.0)))
T_RIG_FRONT = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.01, -0.01)
T_RIG_LEFT = camera_pose_in_rig([2.5, 0.94, 0.92], 0.0, 0.01, float(np.radians(66.0)))
LATENT_FRAMES = 11

Floats = NDArray[np.floating]


@lru_cache(maxsize=1)
def front_poses() -> Array:
    """Poses (11, 4, 4) of the front camera in a bend, 5000 km from the origin of the map."""
    along = 4.0 * np.arange(LATENT_FRAMES)
    T_map_start = make_pose(np.eye(3), [5e6, -3e6, 250.0])
    return T_map_start @ planar_pose(along, 0.01 * along**2, 0.02 * along) @ T_RIG_FRONT


def chained(kind: type[np.floating]) -> Floats:
    """Rays (6, n, 30, 52) by multiplying the poses as they are, in one floating-point type throughout."""
    T_world_front, T_rig_front, T_rig_left = (pose.astype(kind) for pose in (front_poses(), T_RIG_FRONT, T_RIG_LEFT))
    poses = _inverse(T_world_front[0]) @ T_world_front @ _inverse(T_rig_front) @ T_rig_left
    u, v = np.meshgrid(np.arange(52, dtype=kind), np.arange(30, dtype=kind))
    sixteen, half, focal = kind(16.0), kind(0.5), kind(CAMERA.fx)
    x = (sixteen * (u + half) - kind(CAMERA.cx)) / focal
    y = (sixteen * (v + half) - kind(CAMERA.cy)) / focal
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) / np.sqrt(x * x + y * y + kind(1.0))[..., None]
    direction = rays @ np.swapaxes(poses[:, None, :3, :3], -1, -2)
    moment = np.cross(poses[:, None, None, :3, 3], direction) / kind(MOMENT_SCALE)
    return np.moveaxis(np.concatenate([direction, moment], axis=-1), -1, 0)


def differenced() -> NDArray[np.float32]:
    """Rays (6, n, 30, 52) as the generator makes them: positions subtracted first, float64, rounded at the end."""
    return plucker_rays(CAMERA, anchor_poses(front_poses(), T_RIG_FRONT, T_RIG_LEFT))


def measure_error(rays: Floats) -> float:
    """Largest difference of rays (6, n, 30, 52) from the reference over all features."""
    return float(np.abs(rays - _reference()).max())


@lru_cache(maxsize=1)
def _reference() -> Floats:
    return chained(np.longdouble)


def _inverse(pose: Floats) -> Floats:
    """Inverse of a rigid motion (4, 4) in its own precision."""
    inverse = np.eye(4, dtype=pose.dtype)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -(pose[:3, :3].T @ pose[:3, 3])
    return inverse


BENCHMARK = Benchmark(
    title=f"Pluecker rays of {LATENT_FRAMES} x 30 x 52 tokens at map coordinates of 5000 km",
    error_name="largest feature error",
    error_unit="of 1",
    reference="the same rays in extended precision (80 bit on x86), by multiplying the poses as they are",
    settings=lambda: list_settings(
        front_poses,
        {
            "float32 throughout": partial(chained, np.float32),
            "float64 throughout": partial(chained, np.float64),
            "float64, positions subtracted first, float32 result": differenced,
        },
        default="float64, positions subtracted first, float32 result",
    ),
    measure_error=measure_error,
)
