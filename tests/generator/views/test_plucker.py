"""Pluecker rays against the release's formula, their invariants, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.cameras import FthetaCamera, PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, invert, make_pose, planar_pose, pose_from_quaternion
from olt_generator.seeds import make_generator
from olt_generator.views.plucker import MOMENT_SCALE, anchor_poses, plucker_rays, token_rays

PINHOLE = PinholeCamera(832, 480, 410.0, 415.0, 414.2, 239.1)
WIDE = FthetaCamera.equidistant(832, 480, 413.0, 300.0, 400.0)
T_RIG_FRONT = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.01, -0.01)
T_RIG_LEFT = camera_pose_in_rig([2.5, 0.94, 0.92], 0.0, 0.01, np.radians(66.0))


def drive(moments: int = 11) -> np.ndarray:
    """Poses (n, 4, 4) of the rig in a bend."""
    along = np.arange(moments) * 1.3
    return planar_pose(along, 0.02 * along**2, 0.04 * along)


def test_shape_and_formula_of_the_release():
    poses = anchor_poses(drive() @ T_RIG_FRONT, T_RIG_FRONT, T_RIG_LEFT)
    rays = plucker_rays(PINHOLE, poses)
    assert rays.shape == (6, 11, 30, 52)
    assert rays.dtype == np.float32
    K = np.array([[410.0, 0.0, 414.2], [0.0, 415.0, 239.1], [0.0, 0.0, 16.0]])
    K[:2] /= 16.0
    K[2, 2] = 1.0
    for moment, row, column in ((0, 0, 0), (7, 29, 51), (10, 12, 30)):
        direction = poses[moment, :3, :3] @ np.linalg.inv(K) @ [column + 0.5, row + 0.5, 1.0]
        direction /= np.linalg.norm(direction)
        expected = np.concatenate([direction, np.cross(poses[moment, :3, 3], direction) / 25.0])
        np.testing.assert_allclose(rays[:, moment, row, column], expected, atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), camera=st.sampled_from([PINHOLE, WIDE]))
def test_every_point_of_a_ray_lies_on_its_line(seed, camera):
    random = make_generator(seed)
    T = pose_from_quaternion(random.normal(size=(1, 4)), random.normal(0.0, 30.0, (1, 3)))
    direction, moment = np.split(plucker_rays(camera, T).astype(np.float64), 2)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=0), 1.0, atol=1e-6)
    np.testing.assert_allclose((direction * moment).sum(axis=0), 0.0, atol=1e-5)
    point = T[0, :3, :3] @ (12.0 * token_rays(camera)[5, 40]) + T[0, :3, 3]
    expected = np.cross(point, direction[:, 0, 5, 40]) / MOMENT_SCALE
    np.testing.assert_allclose(moment[:, 0, 5, 40], expected, atol=1e-4)


def test_the_anchor_is_the_front_camera_at_first():
    poses = anchor_poses(drive() @ T_RIG_FRONT, T_RIG_FRONT, T_RIG_FRONT)
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-14)
    assert np.abs(plucker_rays(WIDE, poses[:1])[3:]).max() < 1e-12
    # Forward driving is +z of the anchor.
    assert poses[5, 2, 3] > 5.0


@pytest.mark.parametrize("offset", [[5e6, -3e6, 200.0], [0.0, 0.0, 0.0]])
def test_world_coordinates_of_5000_km_cost_a_nanometre(offset):
    T_world = make_pose(np.eye(3), offset)
    near, far = (anchor_poses(T @ drive() @ T_RIG_FRONT, T_RIG_FRONT, T_RIG_LEFT) for T in (np.eye(4), T_world))
    np.testing.assert_allclose(far, near, atol=1e-8)
    np.testing.assert_allclose(plucker_rays(WIDE, far), plucker_rays(WIDE, near), atol=1e-7)


def test_anchor_poses_are_the_chain_of_the_fact_sheet():
    T_world_front = drive() @ T_RIG_FRONT
    chain = invert(T_world_front[0]) @ T_world_front @ invert(T_RIG_FRONT) @ T_RIG_LEFT
    np.testing.assert_allclose(anchor_poses(T_world_front, T_RIG_FRONT, T_RIG_LEFT), chain, atol=1e-12)


@pytest.mark.parametrize("far", [30_000.0, 1e12, np.inf, np.nan])
def test_features_from_1000_on_are_refused(far):
    poses = np.repeat(np.eye(4)[None], 3, axis=0)
    poses[2, 0, 3] = far
    with np.errstate(invalid="ignore"), pytest.raises(InputError, match="moment 2"):
        plucker_rays(PINHOLE, poses)


def test_images_that_do_not_fill_tokens_and_short_lenses_are_refused():
    with pytest.raises(InputError, match="840 x 480"):
        plucker_rays(PINHOLE.resized(840, 480), np.eye(4)[None])
    short = FthetaCamera(832, 480, 413.0, 300.0, (0.0, 400.0, 0.0, -60.0), (0.0, 1 / 400.0), max_angle=0.9)
    with pytest.raises(InputError, match="does not reach"):
        plucker_rays(short, np.eye(4)[None])
