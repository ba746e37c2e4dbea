"""Plans that turn back are driven in the reverse gear."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_closed_loop.control.gears import asks_for_reverse, travelled, until_turn
from olt_closed_loop.control.plans import WorldPlan
from olt_closed_loop.control.tracking import TrackingController
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import (
    VehicleParameters,
    on_the_brake,
    vehicle_with_tyres,
    with_rolling_tyres,
)
from olt_closed_loop.vehicle.state import STATE
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

VEHICLES = {
    "kinematic": VehicleParameters.from_dimensions(DEFAULT_VEHICLE),
    "tyres": vehicle_with_tyres(DEFAULT_VEHICLE),
}


def turn(legs, length=8.0, radius=6.0, seconds=6.0):
    """Poses every 10 ms of smooth legs, each with a gear and a side, and rest after each in which a wheel is turned."""
    pose, poses = np.zeros(3), []
    times = np.arange(0.0, seconds, 0.01)
    for gear, side in legs:
        for speed in gear * 2.0 * length / seconds * np.sin(np.pi * times / seconds) ** 2:
            heading = pose[2]
            pose = pose + 0.01 * speed * np.array([np.cos(heading), np.sin(heading), gear * side / radius])
            poses.append(pose)
        poses += [pose] * 250
    return WorldPlan(10_000 * np.arange(len(poses), dtype=np.int64), np.stack(poses))


def follow(reference, vehicle, seconds=None):
    controller, stepper = TrackingController(vehicle), VehicleStepper(vehicle)
    states, gears = [with_rolling_tyres(np.zeros(6), vehicle)], []
    for index in range(round((seconds or reference.timestamps_us[-1] * 1e-6) * 10)):
        times = 100_000 * (index + np.arange(65, dtype=np.int64))
        control = controller.control(states[-1], WorldPlan(times, reference.at(times)), int(times[0]))
        stepper.shift(controller.parameters.reverse_gear)
        gears.append(controller.parameters.reverse_gear)
        states.append(stepper(states[-1], control))
    return np.stack(states), gears, controller.counts


@pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES)
@pytest.mark.parametrize("legs", [((1, 1), (-1, 1), (1, 1)), ((1, -1), (-1, -1), (1, -1)), ((-1, 1), (1, 0))])
def test_turns_with_several_legs_are_driven(vehicle, legs):
    reference = turn(legs)
    states, gears, counts = follow(reference, vehicle)
    wanted = reference.at(100_000 * np.arange(len(states), dtype=np.int64))
    assert np.linalg.norm((states[:, :3] - wanted)[:, :2], axis=1).max() < 0.15
    assert abs(states[-1, STATE.yaw] - wanted[-1, 2]) < 0.05
    assert counts.shifts == len(legs) - (legs[0][0] > 0)
    assert counts.failed == 0
    assert states[:, STATE.speed].min() < -1.0
    # A gear is changed only about standstill.
    changed = np.flatnonzero(np.diff([False, *gears]))
    assert np.abs(states[changed, STATE.speed]).max() < 0.3


def test_a_stop_that_was_overshot_is_no_reason_to_back_up():
    times = np.arange(65, dtype=np.int64) * 100_000
    controller = TrackingController(VEHICLES["kinematic"])
    state = np.array([0.5, 0.0, 0.0, 0.0, 0.0, -2.0])
    control = controller.control(state, WorldPlan(times, np.zeros((65, 3))), 0)
    assert control[1] < 0.0 and not controller.parameters.reverse_gear


def test_a_moving_car_brakes_before_it_shifts():
    backwards = WorldPlan(100_000 * np.arange(65, dtype=np.int64), np.linspace([0, 0, 0], [-12.8, 0, 0], 65))
    controller = TrackingController(VEHICLES["kinematic"])
    control = controller.control(np.array([0.0, 0.0, 0.0, 5.0, 0.0, 0.0]), backwards, 0)
    assert control[1] < -2.0 and controller.counts.shifts == 0


def test_a_shift_is_on_the_brake_and_moves_nothing_by_itself():
    vehicle = VEHICLES["kinematic"]
    stepper, standing = VehicleStepper([vehicle, vehicle]), np.zeros((2, 6))
    standing[:, STATE.acceleration] = -2.0, 1.0
    stepper.shift(True)
    ends = stepper(standing, np.tile([0.0, 2.0], (2, 1)))
    np.testing.assert_array_equal(ends[:, : STATE.steering], 0.0)
    stepper.shift(True)
    np.testing.assert_array_equal(stepper(ends, np.tile([0.0, 2.0], (2, 1)))[:, STATE.speed], 0.0)
    np.testing.assert_array_equal(on_the_brake(standing, vehicle)[:, STATE.acceleration], [-2.0, -1.0])


@given(
    legs=st.lists(st.floats(0.2, 5.0), min_size=1, max_size=4),
    reverse=st.booleans(),
    heading=st.floats(-3.0, 3.0),
)
def test_what_is_followed_never_turns_back(legs, reverse, heading):
    turns = np.concatenate([[0.0], np.cumsum(np.array(legs) * (-1.0) ** np.arange(len(legs)))])
    way = np.interp(np.linspace(0.0, len(legs), 40), np.arange(len(legs) + 1), turns)
    poses = np.stack([way * np.cos(heading), way * np.sin(heading), np.full_like(way, heading)], axis=-1)
    np.testing.assert_allclose(travelled(poses), way, atol=1e-9)
    assert not asks_for_reverse(poses, reverse)
    sign = -1.0 if reverse else 1.0
    followed = sign * travelled(until_turn(poses, reverse))
    assert np.all(np.maximum.accumulate(followed) - followed <= 0.1 + 1e-9)
    same = np.all(until_turn(poses, reverse) == poses, axis=1)
    assert same[0] and np.all(same[: int(np.argmin(same)) or None])


def test_jitter_asks_for_no_gear():
    poses = np.zeros((11, 3))
    poses[:, 0] = np.random.default_rng(0).uniform(-0.04, 0.04, 11)
    assert not asks_for_reverse(poses, False) and asks_for_reverse(poses, True)
