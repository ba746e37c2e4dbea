import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_closed_loop.integrators import make_stepper
from olt_closed_loop.vehicle import STATE, VehicleParameters, steering_for, vehicle_equations
from olt_toolkit.rig import DEFAULT_VEHICLE

PARAMETERS = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)


def make_state(speed=0.0, steering=0.0, acceleration=0.0):
    return np.array([0.0, 0.0, 0.0, speed, steering, acceleration])


def drive(state, control, seconds):
    stepper = make_stepper(PARAMETERS)
    states = [state]
    for _ in range(round(seconds * 10)):
        states.append(stepper(states[-1], np.asarray(control, dtype=np.float64)))
    return np.stack(states)


def test_equations_are_built_once():
    assert vehicle_equations(PARAMETERS) is vehicle_equations(VehicleParameters.from_dimensions(DEFAULT_VEHICLE))


def test_steady_circle_has_the_radius_of_the_wheelbase_and_steering():
    steering = 0.2
    states = drive(make_state(speed=8.0, steering=steering), [steering, 0.0], 10.0)
    radius = DEFAULT_VEHICLE.wheelbase / np.tan(steering)
    distances = np.hypot(states[:, STATE.x], states[:, STATE.y] - radius)
    np.testing.assert_allclose(distances, radius, atol=1e-6)


def test_lags_reach_63_percent_after_one_time_constant():
    state = drive(make_state(speed=10.0), [0.3, 2.0], 0.1)[-1]
    share = 1.0 - np.exp(-1.0)
    assert state[STATE.steering] == pytest.approx(0.3 * share, rel=1e-6)
    assert state[STATE.acceleration] == pytest.approx(2.0 * share, rel=1e-6)


def test_commands_are_cut_at_the_limits():
    beyond = drive(make_state(speed=10.0), [5.0, 50.0], 2.0)[-1]
    at_limit = drive(make_state(speed=10.0), [PARAMETERS.max_steering, PARAMETERS.max_acceleration], 2.0)[-1]
    np.testing.assert_array_equal(beyond, at_limit)


def test_held_brake_keeps_a_standing_vehicle_still_for_a_minute():
    states = drive(make_state(steering=0.3, acceleration=-2.0), [0.3, -2.0], 60.0)
    np.testing.assert_array_equal(states[:, : STATE.speed + 1], 0.0)


@given(speed=st.floats(0.0, 60.0), command=st.floats(-8.0, -0.5), steering=st.floats(-0.7, 0.7))
def test_braking_stops_and_never_reverses(speed, command, steering):
    states = drive(make_state(speed=speed, acceleration=command), [steering, command], 5.0)
    assert np.all(np.diff(states[:, STATE.speed]) <= 0.0)
    assert np.all(states[:, STATE.speed] >= 0.0)


def test_full_braking_takes_the_distance_of_its_deceleration():
    states = drive(make_state(speed=20.0, acceleration=-8.0), [0.0, -8.0], 10.0)
    # The integral of v / (8 tanh(v / v_stand)): the fading brake adds pi^2 / 12 v_stand^2 / 8.
    fading = np.pi**2 / 12.0 * PARAMETERS.standing_speed**2 / 8.0
    assert states[-1, STATE.x] == pytest.approx(20.0**2 / 16.0 + fading, abs=1e-4)
    assert states[-1, STATE.speed] < 1e-6


def test_a_vehicle_moves_off_from_a_held_brake():
    states = drive(make_state(acceleration=-2.0), [0.0, 2.0], 3.0)
    assert states[-1, STATE.speed] == pytest.approx(2.0 * 2.8, abs=0.2)


def test_yaw_noise_at_standstill_asks_for_no_steering():
    assert abs(steering_for(np.array(0.5), np.array(0.0), 2.85)) == 0.0
    assert steering_for(np.array(2.0), np.array(20.0), 2.85) == pytest.approx(np.arctan(2.85 * 0.1), rel=1e-3)
