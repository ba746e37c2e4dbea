"""What a car can do holds in every model, at any step: grip, steering, steering rate, drive and brakes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.models import vehicle_equations
from olt_closed_loop.vehicle.parameters import STEERING_RATE, VehicleParameters, vehicle_with_tyres
from olt_closed_loop.vehicle.state import STATE
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

MODELS = {
    "kinematic": VehicleParameters.from_dimensions(DEFAULT_VEHICLE),
    "saturating": vehicle_with_tyres(DEFAULT_VEHICLE),
}
every_model = pytest.mark.parametrize("model", MODELS)
anything = {
    "speed": st.floats(-10.0, 60.0),
    "steering": st.floats(-2.0, 2.0),
    "acceleration": st.floats(-30.0, 30.0),
    "command": st.tuples(st.floats(-3.0, 3.0), st.floats(-50.0, 50.0)),
    "friction": st.sampled_from([0.05, 0.1, 0.3, 0.7, 1.0, 1.2]),
    "step": st.sampled_from([0.001, 0.02, 0.1, 0.5]),
    "reverse": st.booleans(),
}


def drive(vehicle, speed, steering, acceleration, command, step, count=8):
    state = np.zeros(vehicle.state_size)
    state[STATE.speed : STATE.lateral_speed] = speed, steering, acceleration
    stepper, states = VehicleStepper(vehicle, step=step), [state]
    for _ in range(count):
        states.append(stepper(states[-1], np.array(command)))
    return np.stack(states)


def world_accelerations(vehicle, states, command):
    """(n,) m/s^2 of the point that grip is about: the rear axle or, with tyres, the centre of gravity."""
    equations = vehicle_equations(vehicle)
    slopes = np.stack([equations(state, command).full().ravel() for state in states])
    if vehicle.tyres is None:
        return np.hypot(slopes[:, STATE.speed], states[:, STATE.speed] * slopes[:, STATE.yaw])
    arm, yaw_rate = vehicle.tyres.rear_axle_to_centre, states[:, STATE.yaw_rate]
    along = slopes[:, STATE.speed] - (states[:, STATE.lateral_speed] + arm * yaw_rate) * yaw_rate
    across = slopes[:, STATE.lateral_speed] + arm * slopes[:, STATE.yaw_rate] + states[:, STATE.speed] * yaw_rate
    return np.hypot(along, across)


@every_model
@settings(deadline=None, max_examples=60)
@given(**anything)
def test_no_vehicle_exceeds_its_limits(model, speed, steering, acceleration, command, friction, step, reverse):
    vehicle = replace(MODELS[model], friction=friction, reverse_gear=reverse)
    states = drive(vehicle, speed, steering, acceleration, command, step)[1:]
    low, high = vehicle.control_limits
    actuators = states[:, STATE.steering : STATE.lateral_speed]
    assert np.all(actuators >= low - 1e-12) and np.all(actuators <= high + 1e-12)
    assert np.all(np.abs(np.diff(actuators[:, 0])) <= STEERING_RATE * step * (1.0 + 1e-9))
    grip = friction * 9.81
    assert world_accelerations(vehicle, states, command).max() <= grip * (1.0 + 1e-9)
    if vehicle.tyres is None:
        # What was driven, not what the equations say: changes of velocity in the world, to the integrator's tolerance.
        heading = np.stack([np.cos(states[:, STATE.yaw]), np.sin(states[:, STATE.yaw])], axis=-1)
        changes = np.linalg.norm(np.diff(states[:, STATE.speed, None] * heading, axis=0), axis=1)
        assert changes.max() <= grip * step + 1e-4
        pulled = np.diff(states[:, STATE.speed])
        assert pulled.max() <= max(high[1], 0.0 if not reverse else -low[1]) * step + 1e-6
        assert np.abs(pulled).max() <= max(abs(low[1]), abs(high[1])) * step + 1e-6


@every_model
@settings(deadline=None, max_examples=40)
@given(**anything)
def test_left_and_right_are_alike(model, speed, steering, acceleration, command, friction, step, reverse):
    vehicle = replace(MODELS[model], friction=friction, reverse_gear=reverse)
    left = drive(vehicle, speed, steering, acceleration, command, step)
    right = drive(vehicle, speed, -steering, acceleration, (-command[0], command[1]), step)
    mirrored = [STATE.y, STATE.yaw, STATE.steering, STATE.lateral_speed, STATE.yaw_rate]
    right[:, [index for index in mirrored if index < vehicle.state_size]] *= -1.0
    np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-9)


@every_model
@settings(deadline=None, max_examples=20)
@given(steering=st.floats(-0.7, 0.7), turned=st.floats(-0.7, 0.7), brake=st.floats(0.0, 8.0), step=anything["step"])
def test_what_stands_stays_standing(model, steering, turned, brake, step):
    states = drive(MODELS[model], 0.0, steering, -brake, (turned, -brake), step)
    np.testing.assert_array_equal(states[:, : STATE.steering], 0.0)


@every_model
def test_an_actuator_set_beyond_its_limit_acts_as_at_the_limit(model):
    beyond, at_limit = (drive(MODELS[model], 20.0, 0.05, value, (0.05, 0.0), 0.1) for value in (-25.0, -8.0))
    np.testing.assert_array_equal(beyond[1:], at_limit[1:])


@pytest.mark.parametrize("method", ["auto", "rk4", "radau", "cvodes"])
def test_every_method_knows_the_limits(method):
    vehicle = MODELS["kinematic"]
    state = np.array([0.0, 0.0, 0.0, 30.0, 1.5, -20.0])
    end = VehicleStepper(vehicle, method)(state, np.array([1.5, -20.0]))
    assert end[STATE.steering] == pytest.approx(vehicle.max_steering) and end[STATE.acceleration] == pytest.approx(-8.0)
    assert abs(end[STATE.yaw]) <= 0.1 * 9.81 / 29.0
