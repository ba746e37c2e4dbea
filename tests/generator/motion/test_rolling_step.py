"""Steps of vehicles that roll along arcs, seen by cameras anywhere on them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.motion.rolling_step import fit_rolling_step, rolling_direction, slip_angle, straighten
from olt_generator.motion.steps import Step
from olt_generator.motion.two_view import TwoViewMotion
from olt_generator.poses import camera_pose_in_rig, invert
from olt_generator.twists import exponential

SIGMA = 1e-3
LEVER = st.tuples(st.floats(-1.5, 3.5), st.floats(-0.8, 0.8), st.floats(0.8, 2.5))
ANGLE = st.floats(-0.1, 0.1)
TURN = st.floats(-0.08, 0.08)
DRIVEN = st.one_of(st.floats(0.4, 3.0), st.floats(-2.0, -0.4))


def camera_motion(driven, turn, mounting):
    """Pose (4, 4) of the camera after an arc in its axes before; `driven` is the chord of the rear axle."""
    arc = driven * 0.5 * turn / np.sin(0.5 * turn) if abs(turn) > 1e-9 else driven
    return invert(mounting) @ exponential(np.array([arc, 0.0, 0.0, 0.0, 0.0, turn])) @ mounting


def see(points, T_a_b, noise=0.0, seed=0):
    """Unit rays (n, 3) to points in the axes of a, from a and from b."""
    later = (points - T_a_b[:3, 3]) @ T_a_b[:3, :3]
    random = np.random.default_rng(seed)
    rays = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in (points, later)]
    rays[1] = rays[1] + noise * random.standard_normal(later.shape)
    return rays[0], rays[1] / np.linalg.norm(rays[1], axis=1, keepdims=True)


def step_of(T_a_b, direction=None):
    moved = T_a_b[:3, 3] if direction is None else direction
    motion = TwoViewMotion(T_a_b[:3, :3].T, moved / np.linalg.norm(moved), np.ones(1, np.bool_))
    return Step(0, 1, True, motion, np.arange(1), np.zeros((1, 3)), np.zeros((1, 3)))


@settings(max_examples=60, deadline=None)
@given(LEVER, ANGLE, ANGLE, TURN, DRIVEN)
def test_the_camera_goes_where_the_arc_takes_it(position, pitch, yaw, turn, driven):
    mounting = camera_pose_in_rig(position, 0.0, pitch, yaw)
    T_a_b = camera_motion(driven, turn, mounting)
    direction = rolling_direction(T_a_b[:3, :3].T, driven, mounting)
    assert direction == pytest.approx(T_a_b[:3, 3] / np.linalg.norm(T_a_b[:3, 3]), abs=1e-9)
    assert slip_angle(step_of(T_a_b), driven, mounting) < 1e-6
    assert slip_angle(step_of(T_a_b, -T_a_b[:3, 3]), driven, mounting) < 1e-6, "a direction holds up to its sign"


@settings(max_examples=30, deadline=None)
@given(LEVER, ANGLE, TURN, DRIVEN, st.floats(0.01, 0.5))
def test_slip_is_the_angle_to_the_arc(position, yaw, turn, driven, aside):
    mounting = camera_pose_in_rig(position, 0.0, 0.0, yaw)
    T_a_b = camera_motion(driven, turn, mounting)
    about = Rotation.from_rotvec(aside * np.array([0.0, 1.0, 0.0]))
    slipping = step_of(T_a_b, about.apply(T_a_b[:3, 3]))
    assert slip_angle(slipping, driven, mounting) == pytest.approx(aside, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(LEVER, ANGLE, ANGLE, TURN, DRIVEN)
def test_a_straightened_step_goes_along_rig_x(position, pitch, yaw, turn, driven):
    mounting = camera_pose_in_rig(position, 0.0, pitch, yaw)
    found = straighten(step_of(camera_motion(driven, turn, mounting)), driven, mounting)
    assert found.motion.direction_a == pytest.approx(np.sign(driven) * mounting[0, :3], abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(LEVER, TURN, DRIVEN, st.integers(0, 1000))
def test_points_that_stand_give_the_turn(position, turn, driven, seed):
    mounting = camera_pose_in_rig(position, 0.0, 0.01, -0.02)
    T_a_b = camera_motion(driven, turn, mounting)
    points = np.random.default_rng(seed).uniform([-12, -4, 4], [12, 1.5, 40], (150, 3))
    rays = see(points, T_a_b, 0.3 * SIGMA, seed)
    motion = fit_rolling_step(*rays, driven, mounting, [np.eye(3)], SIGMA)
    assert np.degrees(Rotation.from_matrix(motion.R_b_a @ T_a_b[:3, :3]).magnitude()) < 0.1
    assert motion.inliers.mean() > 0.95


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("turn", [0.0, 0.05])
def test_a_majority_that_moves_as_no_vehicle_does_is_left_out(seed, turn):
    """Six in ten points move aside together, as lorries do that cross: the motion that most agree with slips."""
    mounting = camera_pose_in_rig([1.5, 0.0, 1.4], 0.0, 0.0, 0.0)
    T_a_b = camera_motion(1.2, turn, mounting)
    points = np.random.default_rng(seed).uniform([-12, -4, 4], [12, 1.5, 40], (300, 3))
    moved = points.copy()
    moved[:180] += [0.6, 0.0, 0.0]
    before, _ = see(points, T_a_b)
    _, after = see(moved, T_a_b, 0.3 * SIGMA, seed)
    wrong = Rotation.from_euler("y", -1.0, degrees=True).as_matrix() @ T_a_b[:3, :3].T
    motion = fit_rolling_step(before, after, 1.2, mounting, [wrong, np.eye(3)], SIGMA)
    assert np.degrees(Rotation.from_matrix(motion.R_b_a @ T_a_b[:3, :3]).magnitude()) < 0.15
    assert motion.inliers[180:].mean() > 0.9
    assert motion.inliers[:180].mean() < 0.5
