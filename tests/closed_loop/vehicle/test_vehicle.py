from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from olt_closed_loop.benchmarks.alpasim_vehicle import alpasim_vehicle
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.models import vehicle_equations
from olt_closed_loop.vehicle.parameters import VehicleParameters, vehicle_with_tyres, with_rolling_tyres
from olt_closed_loop.vehicle.state import STATE, steering_for
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

PARAMETERS = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)
GRIPPING = replace(PARAMETERS, friction=np.inf)


def make_state(speed=0.0, steering=0.0, acceleration=0.0):
    return np.array([0.0, 0.0, 0.0, speed, steering, acceleration])


def drive(state, control, seconds, vehicle=PARAMETERS):
    stepper = VehicleStepper(vehicle)
    state = with_rolling_tyres(state, vehicle)
    states = [state]
    for _ in range(round(seconds * 10)):
        states.append(stepper(states[-1], np.asarray(control, dtype=np.float64)))
    return np.stack(states)


def test_equations_are_built_once():
    assert vehicle_equations(PARAMETERS) is vehicle_equations(VehicleParameters.from_dimensions(DEFAULT_VEHICLE))


def test_steady_circle_has_the_radius_of_the_wheelbase_and_steering():
    steering = 0.2
    states = drive(make_state(speed=8.0, steering=steering), [steering, 0.0], 10.0, GRIPPING)
    radius = DEFAULT_VEHICLE.wheelbase / np.tan(steering)
    distances = np.hypot(states[:, STATE.x], states[:, STATE.y] - radius)
    np.testing.assert_allclose(distances, radius, atol=1e-6)


def test_at_the_limit_a_circle_has_the_radius_that_grip_allows():
    speed, friction = 30.0, 0.8
    states = drive(make_state(speed=speed, steering=0.3), [0.3, 0.0], 3.0, replace(PARAMETERS, friction=friction))
    # The demand is twelve times the grip: nothing is left of the difference.
    radius = speed**2 / (friction * 9.81)
    np.testing.assert_allclose(np.hypot(states[:, STATE.x], states[:, STATE.y] - radius), radius, atol=2e-2)


def test_lags_reach_63_percent_after_one_time_constant():
    state = drive(make_state(speed=10.0), [0.03, 2.0], 0.1)[-1]
    share = 1.0 - np.exp(-1.0)
    assert state[STATE.steering] == pytest.approx(0.03 * share, rel=1e-6)
    assert state[STATE.acceleration] == pytest.approx(2.0 * share, rel=1e-6)


def test_each_actuator_has_its_own_lag():
    vehicle = replace(PARAMETERS, steering_lag=0.05, acceleration_lag=0.3)
    state = drive(make_state(speed=10.0), [0.02, 2.0], 0.1, vehicle)[-1]
    assert state[STATE.steering] == pytest.approx(0.02 * (1.0 - np.exp(-2.0)), rel=1e-6)
    assert state[STATE.acceleration] == pytest.approx(2.0 * (1.0 - np.exp(-1.0 / 3.0)), rel=1e-6)


def test_commands_are_cut_at_the_limits():
    beyond = drive(make_state(speed=10.0), [5.0, 50.0], 2.0)[-1]
    at_limit = drive(make_state(speed=10.0), [PARAMETERS.max_steering, PARAMETERS.max_acceleration], 2.0)[-1]
    np.testing.assert_array_equal(beyond, at_limit)


def test_held_brake_keeps_a_standing_vehicle_still_for_a_minute():
    states = drive(make_state(steering=0.3, acceleration=-2.0), [0.3, -2.0], 60.0)
    np.testing.assert_array_equal(states[:, : STATE.speed + 1], 0.0)


@settings(deadline=None, max_examples=30)
@given(speed=st.floats(0.0, 60.0), command=st.floats(-8.0, -0.5), steering=st.floats(-0.7, 0.7))
def test_braking_stops_and_never_reverses(speed, command, steering):
    states = drive(make_state(speed=speed, acceleration=command), [steering, command], 5.0)
    assert np.all(np.diff(states[:, STATE.speed]) <= 0.0)
    assert np.all(states[:, STATE.speed] >= 0.0)


def test_full_braking_takes_the_distance_of_its_deceleration():
    states = drive(make_state(speed=20.0, acceleration=-8.0), [0.0, -8.0], 10.0)

    def slowness(speed):
        """Speed over deceleration: what brakes ask for, fading, and what is left of it within the grip."""
        asked = 8.0 / (speed**4 + PARAMETERS.standing_speed**4) ** 0.25
        return (1.0 + (asked * speed / 9.81) ** 4) ** 0.25 / asked

    distance, _ = quad(slowness, 0.0, 20.0)
    assert states[-1, STATE.x] == pytest.approx(distance, abs=1e-5)
    assert states[-1, STATE.speed] < 1e-6


def test_a_vehicle_moves_off_from_a_held_brake():
    states = drive(make_state(acceleration=-2.0), [0.0, 2.0], 3.0)
    assert states[-1, STATE.speed] == pytest.approx(2.0 * 2.8, abs=0.2)


def test_yaw_noise_at_standstill_asks_for_no_steering():
    assert abs(steering_for(np.array(0.5), np.array(0.0), 2.85)) == 0.0
    assert steering_for(np.array(2.0), np.array(20.0), 2.85) == pytest.approx(np.arctan(2.85 * 0.1), rel=1e-3)


VEHICLES = {
    "kinematic": PARAMETERS,
    "linear": alpasim_vehicle(),
    "saturating": alpasim_vehicle(friction=0.8),
}
every_model = pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES)


@every_model
def test_every_model_stands_on_a_held_brake(vehicle):
    states = drive(make_state(steering=0.3, acceleration=-2.0), [0.3, -2.0], 60.0, vehicle)
    np.testing.assert_array_equal(states[:, : STATE.speed + 1], 0.0)


@every_model
def test_every_model_reverses_when_asked_and_stops_there(vehicle):
    reverse = replace(vehicle, reverse_gear=True)
    backwards = drive(make_state(), [0.0, -1.0], 3.0, reverse)
    assert backwards[-1, STATE.speed] == pytest.approx(-2.9, abs=0.05)
    stopping = drive(backwards[-1, :6], [0.0, 4.0], 5.0, reverse)
    assert np.all(stopping[:, STATE.speed] <= 0.0)
    assert stopping[-1, STATE.speed] == pytest.approx(0.0, abs=1e-6)


@every_model
def test_a_brake_stops_a_car_that_rolls_backwards_in_the_forward_gear(vehicle):
    states = drive(make_state(speed=-2.0), [0.0, -3.0], 5.0, vehicle)
    assert states[-1, STATE.speed] == pytest.approx(0.0, abs=1e-6)
    assert np.all(states[:, STATE.speed] <= 0.0)


@every_model
def test_left_and_right_are_mirror_images(vehicle):
    left, right = (drive(make_state(speed=15.0), [side * 0.1, -1.0], 2.0, vehicle) for side in (1.0, -1.0))
    np.testing.assert_allclose(left[:, STATE.y], -right[:, STATE.y], atol=1e-9)
    np.testing.assert_allclose(left[:, STATE.speed], right[:, STATE.speed], atol=1e-9)


def test_motion_is_smooth_in_the_first_speed():
    def bends(spacing):
        speeds = np.arange(-2.0, 60.0, spacing)
        states = np.zeros((len(speeds), 8))
        states[:, STATE.speed] = speeds
        stepper = VehicleStepper([VEHICLES["saturating"]] * len(speeds))
        for _ in range(5):
            states = stepper(states, np.tile([0.02, -1.0], (len(speeds), 1)))
        return np.abs(np.diff(states, n=2, axis=0)).max()

    # Second differences of what is smooth shrink to a quarter; across a switch that jumps they would stay.
    assert bends(0.05) < 0.3 * bends(0.1)


def test_slow_tyres_follow_the_kinematic_path():
    kinematic = drive(make_state(speed=0.5), [0.4, 0.0], 4.0)
    with_tyres = drive(make_state(speed=0.5), [0.4, 0.0], 4.0, VEHICLES["saturating"])
    # Turning takes up energy, so the places along the path differ; the path does not.
    radius = PARAMETERS.wheelbase / np.tan(0.4)
    centre = with_tyres[20, :2] + radius * np.array([-np.sin(with_tyres[20, 2]), np.cos(with_tyres[20, 2])])
    np.testing.assert_allclose(np.linalg.norm(with_tyres[20:, :2] - centre, axis=1), radius, atol=2e-3)
    assert np.linalg.norm(with_tyres[-1, :2] - kinematic[-1, :2]) < 0.2


@pytest.mark.parametrize("speed", [15.0, 30.0])
def test_steady_turning_has_the_textbook_yaw_rate(speed):
    vehicle, steering = alpasim_vehicle(), 0.01
    tyres = vehicle.tyres
    assert tyres is not None
    # Rajamani, section 3.1: yaw rate gain v / (L + K v^2) with the understeer gradient K.
    front, rear = vehicle.wheelbase - tyres.rear_axle_to_centre, tyres.rear_axle_to_centre
    understeer = tyres.mass / vehicle.wheelbase * (rear / tyres.front_stiffness - front / tyres.rear_stiffness)
    end = drive(make_state(speed=speed), [steering, 0.0], 4.0, vehicle)[-1]
    expected = end[STATE.speed] * steering / (vehicle.wheelbase + understeer * end[STATE.speed] ** 2)
    assert end[STATE.yaw_rate] == pytest.approx(expected, rel=2e-3)


@settings(deadline=None, max_examples=25)
@given(
    speed=st.floats(1.0, 60.0),
    friction=st.floats(0.05, 1.2),
    steering=st.floats(-0.6, 0.6),
    acceleration=st.floats(-8.0, 6.0),
)
def test_no_force_is_beyond_friction(speed, friction, steering, acceleration):
    vehicle = alpasim_vehicle(friction)
    assert vehicle.tyres is not None
    states = drive(make_state(speed=speed), [steering, acceleration], 1.0, vehicle)
    derivatives = np.stack([vehicle_equations(vehicle)(s, [steering, acceleration]).full().ravel() for s in states])
    arm = vehicle.tyres.rear_axle_to_centre
    forward = derivatives[:, STATE.speed] - (states[:, STATE.lateral_speed] + arm * states[:, 7]) * states[:, 7]
    sideways = derivatives[:, STATE.lateral_speed] + arm * derivatives[:, 7] + states[:, STATE.speed] * states[:, 7]
    assert np.hypot(forward, sideways).max() <= friction * 9.81 * (1.0 + 1e-9)


@settings(deadline=None, max_examples=20)
@given(speed=st.floats(-10.0, 60.0), sideways=st.floats(-5.0, 5.0), yaw_rate=st.floats(-2.0, 2.0))
def test_tyres_take_energy_and_never_give_it(speed, sideways, yaw_rate):
    vehicle = alpasim_vehicle(friction=0.7)
    tyres = vehicle.tyres
    assert tyres is not None
    states = [np.array([0.0, 0.0, 0.0, speed, 0.2, 0.0, sideways, yaw_rate])]
    for _ in range(5):
        states.append(VehicleStepper(vehicle)(states[-1], np.array([0.2, 0.0])))
    moving = np.stack(states)
    lateral = moving[:, STATE.lateral_speed] + tyres.rear_axle_to_centre * moving[:, STATE.yaw_rate]
    turning = tyres.yaw_inertia * moving[:, STATE.yaw_rate] ** 2
    energy = tyres.mass * (moving[:, STATE.speed] ** 2 + lateral**2) + turning
    assert np.all(np.diff(energy) <= 1e-6 * (1.0 + energy[:-1]))


def test_great_friction_is_the_linear_tyre():
    linear = drive(make_state(speed=20.0), [0.1, -2.0], 2.0, alpasim_vehicle())
    gripping = drive(make_state(speed=20.0), [0.1, -2.0], 2.0, alpasim_vehicle(friction=1e3))
    np.testing.assert_allclose(gripping, linear, atol=1e-5)


def test_on_ice_a_car_brakes_no_harder_than_friction():
    states = drive(make_state(speed=10.0), [0.0, -8.0], 2.0, alpasim_vehicle(friction=0.1))
    assert states[-1, STATE.speed] == pytest.approx(10.0 - 0.1 * 9.81 * 2.0, abs=0.05)


def test_rate_limits_are_kept_and_reached():
    vehicle = replace(PARAMETERS, max_steering_rate=0.5, max_jerk=5.0)
    states = drive(make_state(speed=10.0), [0.4, -6.0], 3.0, vehicle)
    rates = np.abs(np.diff(states[:, [STATE.steering, STATE.acceleration]], axis=0)) / 0.1
    np.testing.assert_allclose(rates.max(axis=0), [0.5, 5.0])
    np.testing.assert_allclose(states[-1, [STATE.steering, STATE.acceleration]], [0.4, -6.0], atol=1e-3)


def test_presets_follow_the_box():
    assert replace(vehicle_with_tyres(DEFAULT_VEHICLE, np.inf), max_steering_rate=np.inf) == alpasim_vehicle()
    bigger = vehicle_with_tyres(replace(DEFAULT_VEHICLE, length=7.0, height=2.5, wheelbase=4.0))
    tyres, ours = bigger.tyres, alpasim_vehicle().tyres
    assert tyres is not None and ours is not None
    assert bigger.wheelbase == 4.0
    assert tyres.mass == pytest.approx(ours.mass * 7.0 * 2.5 / (DEFAULT_VEHICLE.length * DEFAULT_VEHICLE.height))
    assert tyres.front_stiffness / tyres.mass == pytest.approx(ours.front_stiffness / ours.mass)
