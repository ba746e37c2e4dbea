import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.poses import planar_pose
from olt_toolkit.policy.action_space import (
    actions_to_trajectory,
    estimate_initial_speed,
    normalise_actions,
    physical_actions,
    round_trip_errors,
    trajectory_to_actions,
)
from olt_toolkit.rigs.names import ContractName

HISTORY_TIMES = 0.1 * np.arange(-15, 1)
FUTURE_TIMES = 0.1 * np.arange(1, 65)

# Facts sheet alpamayo_interface, section 3: (speed, acceleration, curvature), the estimated speed, and the actions of
# steps 0, 31 and 63 as the released float32 code gives them.
REFERENCE = [
    ((10.0, 0.0, 0.0), 9.99941, [(-0.038612, -0.010296), (-0.042623, -0.010296), (-0.046583, -0.010296)]),
    ((5.0, 1.0, 0.0), 4.99970, [(1.427567, -0.010296), (1.425524, -0.010296), (1.420638, -0.010296)]),
    ((8.0, 0.0, 0.02), 7.99970, [(-0.039449, 0.754466), (-0.042628, 0.754455), (-0.046082, 0.754504)]),
    ((8.0, -1.2, 0.01), 7.99957, [(-1.801282, 0.372090), (-1.804422, 0.371933), (-1.804399, 0.360538)]),
    ((0.0, 0.0, 0.0), 0.0, [(-0.042621, -0.010296), (-0.042621, -0.010296), (-0.042621, -0.010296)]),
]
# A float32 speed of 10 m/s is known to about 1e-6, its difference over 0.1 s divided by the spread of 0.68 to 1e-5,
# and the reference's float32 normal equations amplify that by some tens.
FLOAT32_TOLERANCE = 5e-4


def drive(speed, acceleration, curvature, times):
    """Exact positions and rotations of a motion of constant acceleration and curvature."""
    travelled = speed * times + 0.5 * acceleration * times**2
    yaw = curvature * travelled
    # sinc keeps straight lines exact: sin(yaw) / curvature = travelled * sinc(yaw / pi).
    x = travelled * np.sinc(yaw / np.pi)
    y = travelled * np.sin(0.5 * yaw) * np.sinc(0.5 * yaw / np.pi)
    pose = planar_pose(x, y, yaw)
    return pose[:, :3, 3], pose[:, :3, :3]


@pytest.mark.parametrize(("motion", "speed", "expected"), REFERENCE)
def test_reference_vectors(motion, speed, expected):
    history, future = drive(*motion, HISTORY_TIMES), drive(*motion, FUTURE_TIMES)
    assert estimate_initial_speed(*history) == pytest.approx(speed, abs=1e-5)
    actions = trajectory_to_actions(*history, *future)
    np.testing.assert_allclose(actions[[0, 31, 63]], expected, atol=FLOAT32_TOLERANCE)


@settings(max_examples=50, deadline=None)
@given(
    speed=st.floats(0.0, 40.0),
    acceleration=st.floats(-1.0, 3.0),
    lateral=st.floats(-4.0, 4.0),
)
def test_actions_drive_the_trajectory_they_were_fitted_to(speed, acceleration, lateral):
    # The vehicle must not turn back within the window, and curves are limited by lateral acceleration.
    acceleration = max(acceleration, -speed / 8.0)
    acceleration = min(acceleration, speed / 2.0)
    curvature = lateral / max(speed + 6.4 * acceleration, speed, 5.0) ** 2
    history = drive(speed, acceleration, curvature, HISTORY_TIMES)
    future_xyz, future_rotation = drive(speed, acceleration, curvature, FUTURE_TIMES)
    actions = trajectory_to_actions(*history, future_xyz, future_rotation)
    xyz, rotation = actions_to_trajectory(actions, estimate_initial_speed(*history))
    assert np.linalg.norm(xyz - future_xyz, axis=-1).mean() < 0.05
    # The ridge of 1e-4 pulls the curvature of a step of length s towards 0 by the share ridge / (s^2 + ridge).
    shortest_step = 0.1 * min(speed, speed + 6.4 * acceleration)
    lost = 1e-4 / (shortest_step**2 + 1e-4)
    turn = abs(curvature) * (speed * 6.4 + 0.5 * acceleration * 6.4**2)
    assert np.abs(rotation - future_rotation).max() < 0.01 + lost * turn


def test_standstill_gives_no_motion():
    history, future = drive(0.0, 0.0, 0.0, HISTORY_TIMES), drive(0.0, 0.0, 0.0, FUTURE_TIMES)
    acceleration, curvature = physical_actions(trajectory_to_actions(*history, *future))
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-12)
    np.testing.assert_allclose(curvature, 0.0, atol=1e-12)


def test_constant_actions_follow_the_equations_of_motion():
    actions = np.broadcast_to(normalise_actions(np.array(2.0), np.array(0.0)), (64, 2))
    xyz, rotation = actions_to_trajectory(actions, 0.0)
    times = FUTURE_TIMES
    np.testing.assert_allclose(xyz[:, 0], times**2, atol=1e-9)  # half of 2 m/s^2
    np.testing.assert_allclose(xyz[:, 1:], 0.0, atol=1e-12)
    np.testing.assert_allclose(rotation, np.broadcast_to(np.eye(3), (64, 3, 3)), atol=1e-12)


def test_left_and_right_are_mirror_images():
    history, future = drive(12.0, 0.5, 0.01, HISTORY_TIMES), drive(12.0, 0.5, 0.01, FUTURE_TIMES)
    mirrored = [drive(12.0, 0.5, -0.01, times) for times in (HISTORY_TIMES, FUTURE_TIMES)]
    left = physical_actions(trajectory_to_actions(*history, *future))
    right = physical_actions(trajectory_to_actions(*mirrored[0], *mirrored[1]))
    np.testing.assert_allclose(right[0], left[0], atol=1e-9)
    np.testing.assert_allclose(right[1], -left[1], atol=1e-9)


def test_a_turn_through_half_a_circle_is_unwrapped():
    history, future = drive(6.0, 0.0, 0.15, HISTORY_TIMES), drive(6.0, 0.0, 0.15, FUTURE_TIMES)
    _, curvature = physical_actions(trajectory_to_actions(*history, *future))
    np.testing.assert_allclose(curvature, 0.15, atol=2e-3)


def test_a_batch_gives_what_its_members_give():
    motions = [motion for motion, _, _ in REFERENCE]
    histories = [drive(*motion, HISTORY_TIMES) for motion in motions]
    futures = [drive(*motion, FUTURE_TIMES) for motion in motions]
    stacked = [np.stack(arrays) for arrays in (*zip(*histories, strict=True), *zip(*futures, strict=True))]
    single = [trajectory_to_actions(*history, *future) for history, future in zip(histories, futures, strict=True)]
    np.testing.assert_allclose(trajectory_to_actions(*stacked), np.stack(single), atol=1e-12)


# Facts sheet alpamayo_interface, section 3: mean distances after the round trip that the released code gives, metres.
@pytest.mark.parametrize(
    ("motion", "error"), [(motion, error) for (motion, *_), error in zip(REFERENCE, (8, 13, 15, 11, 0), strict=True)]
)
def test_round_trips_lose_what_the_released_code_loses(motion, error):
    history, future = drive(*motion, HISTORY_TIMES), drive(*motion, FUTURE_TIMES)
    assert round_trip_errors(*history, *future) == pytest.approx(1e-4 * error, abs=1e-4)


@settings(max_examples=25, deadline=None)
@given(speed=st.floats(1.0, 30.0), crab=st.floats(-0.02, 0.02))
def test_motion_across_the_heading_is_what_no_action_drives(speed, crab):
    """It drifts aside by speed * crab for 3.25 s on average, but for what slower actions make up for."""
    history, future = drive(speed, 0.0, 0.0, HISTORY_TIMES), drive(speed, 0.0, 0.0, FUTURE_TIMES)
    turned = planar_pose(0.0, 0.0, np.full(1, crab))[0, :3, :3]
    errors = round_trip_errors(history[0] @ turned.T, history[1], future[0] @ turned.T, future[1])
    assert errors == pytest.approx(3.25 * speed * abs(np.sin(crab)), rel=0.03, abs=0.02)


def test_what_tokens_cut_off_is_lost():
    """Braking from 60 m/s at 8 m/s2 is more than the 6.78 that tokens tell: 0.61 t^2 metres too far on average."""
    history, future = (drive(60.0, -8.0, 0.0, times) for times in (HISTORY_TIMES, FUTURE_TIMES))
    expected = 0.5 * (8.0 - 6.781) * np.mean(FUTURE_TIMES**2)
    assert round_trip_errors(*history, *future) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(
    ("speed", "curvature", "expected"), [(0.5, 0.2, 0.0), (-0.5, 0.2, 0.0), (3.0, 0.2, 0.2), (3.0, -0.5, -0.33)]
)
def test_alpamayo_2_bounds_curvatures_and_takes_none_of_slow_steps(speed, curvature, expected):
    history, future = (drive(speed, 0.0, curvature, times) for times in (HISTORY_TIMES, FUTURE_TIMES))
    _, bounded = physical_actions(trajectory_to_actions(*history, *future, ContractName.ALPAMAYO_2))
    np.testing.assert_allclose(bounded, expected, atol=0.01)
    for policy in (ContractName.ALPAMAYO_R1, ContractName.ALPAMAYO_1_5):
        _, free = physical_actions(trajectory_to_actions(*history, *future, policy))
        assert np.abs(free - expected).max() > 0.1 or expected == curvature


def test_a_creeping_turn_is_lost_to_alpamayo_2_alone():
    history, future = (drive(0.5, 0.0, 0.2, times) for times in (HISTORY_TIMES, FUTURE_TIMES))
    errors = [round_trip_errors(*history, *future, policy) for policy in ContractName]
    assert errors[0] == errors[1] < 0.1 < 0.3 < errors[2]
