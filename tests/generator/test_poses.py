"""Rigid motions: group laws and conventions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.poses import (
    aim_camera,
    camera_pose_in_rig,
    invert,
    make_pose,
    planar_pose,
    pose_from_quaternion,
    transform,
    yaw_of,
)
from olt_generator.seeds import make_generator


def random_poses(seed: int, *shape: int) -> np.ndarray:
    random = make_generator("poses", seed)
    quaternions = random.normal(size=(*shape, 4))
    return pose_from_quaternion(quaternions, random.normal(scale=100.0, size=(*shape, 3)))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_inverse_and_composition(seed):
    poses, others = random_poses(seed, 3, 5), random_poses(seed + 1, 3, 5)
    assert invert(poses) @ poses == pytest.approx(np.broadcast_to(np.eye(4), poses.shape), abs=1e-10)
    assert invert(poses @ others) == pytest.approx(invert(others) @ invert(poses), abs=1e-9)
    assert invert(invert(poses)) == pytest.approx(poses, abs=1e-10)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_transform_maps_points_of_b_to_a(seed):
    T_a_b, T_b_c = random_poses(seed, 4), random_poses(seed + 1, 4)
    points_c = make_generator("points", seed).normal(size=(4, 7, 3))
    assert transform(T_a_b, transform(T_b_c, points_c)) == pytest.approx(transform(T_a_b @ T_b_c, points_c), abs=1e-9)
    homogeneous = np.append(points_c[2, 3], 1.0)
    assert transform(T_b_c, points_c)[2, 3] == pytest.approx((T_b_c[2] @ homogeneous)[:3], abs=1e-10)


def test_quaternions_are_scalar_last():
    half = np.sqrt(0.5)
    pose = pose_from_quaternion([0.0, 0.0, half, half], [1.0, 2.0, 3.0])  # a quarter turn about z
    assert transform(pose, np.array([[1.0, 0.0, 0.0]])) == pytest.approx(np.array([[1.0, 3.0, 3.0]]))


@settings(max_examples=40, deadline=None)
@given(x=st.floats(-1e6, 1e6), y=st.floats(-1e6, 1e6), yaw=st.floats(-3.1, 3.1))
def test_planar_pose_turns_and_stands(x, y, yaw):
    pose = planar_pose(x, y, yaw, 0.5)
    assert pose[:3, 3] == pytest.approx([x, y, 0.5])
    assert pose[:3, :3] == pytest.approx(Rotation.from_euler("z", yaw).as_matrix(), abs=1e-12)
    assert yaw_of(pose) == pytest.approx(yaw, abs=1e-12)


def test_planar_poses_broadcast():
    poses = planar_pose(np.arange(4.0), 0.0, 0.1)
    assert poses.shape == (4, 4, 4)
    assert np.array_equal(poses[3], planar_pose(3.0, 0.0, 0.1))


def test_make_pose_broadcasts_one_rotation_over_many_translations():
    poses = make_pose(np.eye(3), np.arange(6.0).reshape(2, 3))
    assert poses.shape == (2, 4, 4)
    assert np.array_equal(poses[1, :3, 3], [3.0, 4.0, 5.0])
    assert np.array_equal(poses[0, 3], [0.0, 0.0, 0.0, 1.0])


def test_an_unturned_camera_looks_ahead():
    """Camera x is right (rig -y), camera y is down (rig -z), camera z is ahead (rig x)."""
    pose = camera_pose_in_rig([1.7, 0.1, 1.5], 0.0, 0.0, 0.0)
    right, down, ahead = transform(pose, np.eye(3)[None])[0] - pose[:3, 3]
    assert right == pytest.approx([0.0, -1.0, 0.0])
    assert down == pytest.approx([0.0, 0.0, -1.0])
    assert ahead == pytest.approx([1.0, 0.0, 0.0])


def test_signs_of_the_mounting_angles():
    ahead = np.array([0.0, 0.0, 1.0])
    nose_down = camera_pose_in_rig(np.zeros(3), 0.0, 0.2, 0.0)[:3, :3] @ ahead
    assert nose_down == pytest.approx([np.cos(0.2), 0.0, -np.sin(0.2)])
    turned_left = camera_pose_in_rig(np.zeros(3), 0.0, 0.0, 0.3)[:3, :3] @ ahead
    assert turned_left == pytest.approx([np.cos(0.3), np.sin(0.3), 0.0])
    rolled = camera_pose_in_rig(np.zeros(3), 0.1, 0.0, 0.0)[:3, :3] @ np.array([1.0, 0.0, 0.0])
    assert rolled == pytest.approx([0.0, -np.cos(0.1), -np.sin(0.1)])  # positive roll: the right side goes down


@settings(max_examples=40, deadline=None)
@given(roll=st.floats(-3.1, 3.1), pitch=st.floats(-1.5, 1.5), yaw=st.floats(-3.1, 3.1))
def test_mounting_is_a_rotation(roll, pitch, yaw):
    rotation = camera_pose_in_rig(np.zeros(3), roll, pitch, yaw)[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(("roll", "pitch", "yaw"), [(0.2, 0.1, -0.3), (-0.1, -0.25, 0.15), (0.0, 0.3, 0.0)])
def test_aiming_finds_the_pitch_and_yaw_of_a_rolled_camera(roll, pitch, yaw):
    mounting = camera_pose_in_rig([1.5, 0.2, 1.4], roll, pitch, yaw)
    np.testing.assert_allclose(aim_camera([1.5, 0.2, 1.4], roll, mounting[0, :3]), mounting, atol=1e-12)


def test_a_camera_turns_by_roll_then_pitch_then_yaw():
    """Nose down by pitch, left by yaw, and right side down by roll, each about the rig's own axes."""
    forward, right = camera_pose_in_rig(np.zeros(3), 0.1, 0.2, 0.3)[:3, [2, 0]].T
    np.testing.assert_allclose(forward, [np.cos(0.2) * np.cos(0.3), np.cos(0.2) * np.sin(0.3), -np.sin(0.2)])
    assert right[2] == pytest.approx(-np.sin(0.1) * np.cos(0.2))


@pytest.mark.parametrize("shape", [(), (4,), (3, 5), (2, 3, 4)])
def test_poses_of_any_shape_are_inverted(shape):
    poses = random_poses(7, *shape)
    assert invert(poses) == pytest.approx(np.linalg.inv(poses), abs=1e-9)


def test_a_planar_pose_stands_on_the_ground_unless_it_is_told_otherwise():
    assert planar_pose(1.0, 2.0, 0.3)[:3, 3].tolist() == [1.0, 2.0, 0.0]
