"""How a sensor is mounted, from the motion of a vehicle whose rear axle does not slip."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.motion.mounting import align_mounting
from olt_generator.poses import camera_pose_in_rig, invert, planar_pose
from olt_generator.twists import exponential

ANGLE = st.floats(-np.radians(6.0), np.radians(6.0))
SEED = st.integers(0, 2**32 - 1)


def drive_arcs(seed, metres=60.0, spacing=0.7):
    """Poses (n, 4, 4) of a rig that drives a chain of arcs with radii of 6 m and more, pose by pose."""
    random = np.random.default_rng(seed)
    curvatures = np.repeat(random.uniform(-1 / 6, 1 / 6, 12), int(metres / spacing / 12) + 1)
    steps = exponential(spacing * np.array([[1.0, 0.0, 0.0, 0.0, 0.0, curvature] for curvature in curvatures]))
    poses = [planar_pose(*random.uniform(-100.0, 100.0, 2), random.uniform(-3.0, 3.0))]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.stack(poses)


def angle_between(first, second):
    return np.degrees(Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).magnitude())


lever = st.tuples(st.floats(-1.5, 3.5), st.floats(-0.8, 0.8), st.floats(0.3, 2.5))


@settings(max_examples=60, deadline=None)
@given(SEED, lever, st.floats(-np.radians(3.0), np.radians(3.0)), ANGLE, ANGLE, st.booleans())
def test_any_arcs_and_any_lever_arm_give_the_mounting(seed, position, roll, pitch, yaw, backwards):
    true = camera_pose_in_rig(position, roll, pitch, yaw)
    poses = drive_arcs(seed)[:: -1 if backwards else 1]
    found = align_mounting(poses @ true, camera_pose_in_rig(position, roll, 0.0, 0.0))
    # Chords across the join of two arcs lie a little aside; the median sees few of them.
    assert angle_between(found, true) < 0.6
    assert found[:3, 3] == pytest.approx(true[:3, 3])


@settings(max_examples=30, deadline=None)
@given(SEED, lever, ANGLE, ANGLE, st.floats(0.01, 1 / 6), st.booleans())
def test_one_arc_gives_the_mounting_exactly(seed, position, pitch, yaw, curvature, left):
    true = camera_pose_in_rig(position, 0.0, pitch, yaw)
    turn = exponential(0.9 * np.array([1.0, 0.0, 0.0, 0.0, 0.0, curvature if left else -curvature]))
    poses = np.stack([np.linalg.matrix_power(turn, index) for index in range(12)])
    found = align_mounting(poses @ true, camera_pose_in_rig(position, 0.0, 0.0, 0.0))
    assert angle_between(found, true) < 1e-6


@settings(max_examples=30, deadline=None)
@given(SEED, lever, ANGLE)
def test_noise_of_a_centimetre_costs_a_few_tenths_of_a_degree(seed, position, yaw):
    true = camera_pose_in_rig(position, 0.0, 0.0, yaw)
    noise = np.array([0.01, 0.01, 0.01, 2e-4, 2e-4, 2e-4])
    poses = drive_arcs(seed) @ true
    noisy = poses @ exponential(noise * np.random.default_rng(seed).standard_normal((len(poses), 6)))
    assert angle_between(align_mounting(noisy, camera_pose_in_rig(position, 0.0, 0.0, 0.0)), true) < 0.9


@given(lever, ANGLE, ANGLE)
@settings(max_examples=30, deadline=None)
def test_a_straight_path_gives_the_direction_of_travel(position, pitch, yaw):
    true = camera_pose_in_rig(position, 0.0, pitch, yaw)
    poses = planar_pose(0.3 * np.arange(40), 0.0, 0.0)
    # The vehicle waits in between, which adds nothing.
    waiting = np.concatenate([poses[:20], np.tile(poses[20], (300, 1, 1)), poses[20:]])
    found = align_mounting(waiting @ true, camera_pose_in_rig(position, 0.0, 0.0, 0.0))
    assert angle_between(found, true) < 1e-6


def test_a_sensor_that_looks_ahead_in_rig_axes_is_aligned_too():
    arcs = drive_arcs(3)
    true = invert(exponential(np.array([0.0, 0.0, 0.0, 0.0, np.radians(1.0), np.radians(-2.0)])))
    rough = np.eye(4)
    rough[:3, 3] = true[:3, 3] = (0.2, 0.1, 0.9)
    assert angle_between(align_mounting(arcs @ true, rough), true) < 0.6


@pytest.mark.parametrize("jitter", [0.0, 0.02])
def test_a_standing_vehicle_says_nothing(jitter):
    poses = np.tile(np.eye(4), (200, 1, 1))
    poses[:, :3, 3] += jitter * np.random.default_rng(0).standard_normal((200, 3))
    assert align_mounting(poses, camera_pose_in_rig([1.0, 0.0, 1.5], 0.0, 0.0, 0.0)) is None
    assert align_mounting(poses[:1], np.eye(4)) is None
