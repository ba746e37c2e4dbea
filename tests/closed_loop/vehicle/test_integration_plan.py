"""How many sub-steps a moment asks for: enough for stability, no more than that, and by the order of the method."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from olt_closed_loop.benchmarks.alpasim_vehicle import alpasim_vehicle
from olt_closed_loop.benchmarks.vehicle_grid import Cell
from olt_closed_loop.vehicle.integration_plan import automatic_plan, candidates, stiffness_plan
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import VehicleParameters, vehicle_with_tyres
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

EVERYTHING_IS_ACCURATE = 1e12
POLYNOMIALS = {"midpoint": [0.5, 1.0, 1.0], "rk4": [1 / 24, 1 / 6, 0.5, 1.0, 1.0]}
"""Amplification of one sub-step in powers of rate times length, the highest first."""

STIFF = [
    Cell(speed, np.inf, stiffness, mass, step, 0.0)
    for speed, stiffness, mass, step in product((0.0, 1.0, 5.0, 20.0, 60.0), (0.2, 2.5, 10.0), (0.3, 3.0), (0.025, 0.2))
]


def lateral_rates(vehicle, speed):
    """Eigenvalues of the lateral dynamics (Rajamani, section 2.3), the wheels rolling as `vehicle.tyres` says."""
    tyres = vehicle.tyres
    rolling = (speed**4 + tyres.slip_speed**4) ** 0.25
    to_rear = tyres.rear_axle_to_centre
    to_front = vehicle.wheelbase - to_rear
    # About the centre of gravity: lateral speed of each axle by lateral speed and yaw rate, then forces, then motion.
    axles = np.array([[1.0, to_front], [1.0, -to_rear]])
    forces = -np.array([[tyres.front_stiffness], [tyres.rear_stiffness]]) * axles / rolling
    motion = np.array([[1.0, 1.0], [to_front, -to_rear]]) @ forces / [[tyres.mass], [tyres.yaw_inertia]]
    return np.linalg.eigvals(motion - [[0.0, speed], [0.0, 0.0]])


def substeps(vehicle, method, state, control=(0.0, 0.0), step=0.1, tolerance=EVERYTHING_IS_ACCURATE):
    plan = stiffness_plan(vehicle.model, method, tolerance)
    return float(np.asarray(plan(state, control, vehicle.numbers, step))[1, 0])


def rolling_at(speed):
    return np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("method", ["midpoint", "rk4"])
@pytest.mark.parametrize("cell", STIFF, ids=str)
def test_no_substep_amplifies_what_decays(cell, method):
    rates = lateral_rates(cell.vehicle, cell.speed)
    count = substeps(cell.vehicle, method, rolling_at(cell.speed), step=cell.step)
    assert np.abs(rates).max() * cell.step / count <= 2.0
    decaying = rates[rates.real <= 0.0]
    if method == "midpoint":  # stable on the real axis and around it; swaying is what the error asks about
        decaying = decaying[np.abs(decaying.imag) <= np.abs(decaying.real)]
    assert np.all(np.abs(np.polyval(POLYNOMIALS[method], decaying * cell.step / count)) <= 1.0)


@pytest.mark.parametrize(("method", "limit"), [("midpoint", 2.0), ("rk4", 2.785)])
def test_stability_takes_about_as_many_substeps_as_it_needs(method, limit):
    """The stiffest: light, on strong tyres, at walking speed. `limit` is where the real axis leaves stability."""
    cell = Cell(1.0, np.inf, 10.0, 0.3, 0.2, 0.0)
    needed = np.abs(lateral_rates(cell.vehicle, cell.speed)).max() * cell.step / limit
    count = substeps(cell.vehicle, method, rolling_at(cell.speed), step=cell.step)
    assert needed <= count <= 2.5 * needed


@pytest.mark.parametrize("method", ["midpoint", "rk4"])
def test_fast_cars_that_sway_more_than_they_damp_are_followed(method):
    """Heavy, on weak tyres, with slow steering: neither damping nor the actuators are as fast as the swaying."""
    vehicle = replace(Cell(60.0, np.inf, 0.2, 3.0, 1.0, 0.0).vehicle, steering_lag=1.0)
    rates = lateral_rates(vehicle, 60.0)
    assert np.abs(rates.imag).max() > 5.0 * np.abs(rates.real).max()
    assert np.abs(rates).max() / substeps(vehicle, method, rolling_at(60.0), step=1.0) <= 2.0


@pytest.mark.parametrize("method", ["midpoint", "rk4"])
def test_a_push_sideways_decays_where_only_stability_asks(method):
    cell = Cell(2.0, np.inf, 10.0, 0.3, 0.2, 0.0)
    stepper = VehicleStepper(cell.vehicle, method, step=0.2, tolerance=EVERYTHING_IS_ACCURATE)
    state = rolling_at(2.0)
    state[6] = 0.5
    for _ in range(10):
        state = stepper(state, np.zeros(2))
    assert np.abs(state[6:]).max() < 1e-6


@pytest.mark.parametrize(("method", "order"), [("midpoint", 2), ("rk4", 4)])
@pytest.mark.parametrize(
    ("state", "control"),
    [
        (rolling_at(20.0), (0.2, 0.0)),
        (np.array([0.0, 0.0, 0.0, 20.0, 0.2, 0.0, 0.5, 0.3]), (0.2, 0.0)),
        (rolling_at(20.0), (0.0, -8.0)),
    ],
    ids=["steering", "slipping", "braking"],
)
def test_twice_the_substeps_meet_a_tolerance_smaller_by_the_order(state, control, method, order):
    vehicle = alpasim_vehicle()
    tolerance = {"midpoint": 1e-5, "rk4": 1e-9}[method]
    coarse, fine = (
        substeps(vehicle, method, state, control, tolerance=tolerance * share) for share in (1.0, 0.5**order)
    )
    assert 20.0 < coarse < 2000.0
    assert fine == pytest.approx(2.0 * coarse, abs=1.0)


@pytest.mark.parametrize(("method", "tolerance"), [("midpoint", 1e-6), ("rk4", 1e-10)])
def test_a_bend_uses_the_same_share_of_the_tolerance_at_every_speed(method, tolerance):
    """Along a circle the error of order q is in proportion to v w^q h^q a second; the exact end is that of the arc."""
    vehicle, steering, shares = VehicleParameters(DEFAULT_VEHICLE.wheelbase, friction=np.inf), 0.3, []
    for speed in (5.0, 10.0, 20.0):
        stepper = VehicleStepper(vehicle, method, tolerance=tolerance)
        end = stepper(np.array([0.0, 0.0, 0.0, speed, steering, 0.0]), np.array([steering, 0.0]))
        radius, angle = vehicle.wheelbase / np.tan(steering), 0.1 * speed * np.tan(steering) / vehicle.wheelbase
        error = np.hypot(end[0] - radius * np.sin(angle), end[1] - radius * (1.0 - np.cos(angle)))
        shares.append(error / tolerance)
        ((_, count),) = stepper.taken().values()
        assert count > 3
    assert max(shares) < 1.0
    assert max(shares) < 2.0 * min(shares)


@pytest.mark.parametrize(("method", "order", "tolerance"), [("midpoint", 2, 1e-6), ("rk4", 4, 1e-10)])
def test_the_lag_of_the_brakes_counts_by_the_order(method, order, tolerance):
    counts = []
    for lag in (0.05, 0.2):
        vehicle = replace(VehicleParameters.from_dimensions(DEFAULT_VEHICLE), acceleration_lag=lag)
        state = np.array([0.0, 0.0, 0.0, 30.0, 0.0, 0.0])
        counts.append(substeps(vehicle, method, state, (0.0, -8.0), tolerance=tolerance))
    assert 20.0 < counts[1] <= counts[0] < 2000.0
    assert counts[0] / counts[1] == pytest.approx(4.0 ** ((order - 2) / order), rel=0.02)


@pytest.mark.parametrize(("method", "tolerance"), [("midpoint", 1e-5), ("rk4", 1e-9)])
@pytest.mark.parametrize(
    "more",
    [{"command": 0.2}, {"lateral": 0.1}, {"yaw_rate": 0.9}, {"acceleration": -8.0}],
    ids=lambda more: next(iter(more)),
)
def test_more_steering_slip_and_braking_ask_for_more_substeps(more, method, tolerance):
    vehicle = alpasim_vehicle()

    def count(command=0.1, lateral=0.02, yaw_rate=0.2, acceleration=-1.0):
        state = np.array([0.0, 0.0, 0.0, 10.0, 0.05, 0.0, lateral, yaw_rate])
        return substeps(vehicle, method, state, (command, acceleration), tolerance=tolerance)

    assert count() < count(**more) < 4097.0


@pytest.mark.parametrize(("tolerance", "expected"), [(1e-2, "midpoint"), (1e-9, "rk4")])
def test_the_plan_takes_the_method_that_evaluates_the_equations_less(tolerance, expected):
    vehicle, state, control = VehicleParameters.from_dimensions(DEFAULT_VEHICLE), rolling_at(20.0)[:6], (0.01, 0.0)
    plan = automatic_plan(vehicle.model, tolerance)
    which, count, check = np.asarray(plan(state, control, vehicle.numbers, 0.1)).ravel()[:3]
    assert candidates(vehicle.model)[int(which)] == ("kinematic", expected) and check == 0.0
    assert count == substeps(vehicle, expected, state, control, tolerance=tolerance)
    evaluations = {
        method: each * substeps(vehicle, method, state, control, tolerance=tolerance)
        for method, each in (("midpoint", 2), ("rk4", 4))
    }
    assert min(evaluations, key=evaluations.__getitem__) == expected


@pytest.mark.parametrize("what", ["braking", "driving", "bend"])
def test_the_error_of_the_kinematic_model_is_measured_where_four_tenths_of_the_grip_are_asked_for(what):
    vehicle = replace(VehicleParameters.from_dimensions(DEFAULT_VEHICLE), friction=0.8)
    plan = automatic_plan("kinematic", 1e-7)
    for share, measured in ((0.97, False), (1.03, True)):
        state, control, asked = rolling_at(20.0)[:6], [0.0, 0.0], 0.4 * share * vehicle.friction * 9.81
        if what == "bend":
            state[4] = control[0] = np.arctan(asked / 20.0**2 * vehicle.wheelbase)
        else:
            control[1] = asked if what == "driving" else -asked
        check = float(np.asarray(plan(state, control, vehicle.numbers, 0.1))[2, 0])
        assert (check > 0.0) is measured


@pytest.mark.parametrize("vehicle", [alpasim_vehicle(), vehicle_with_tyres(DEFAULT_VEHICLE, friction=0.8)])
def test_the_error_of_tyres_is_always_measured(vehicle):
    plan = automatic_plan(vehicle.model, 1e-7)
    which, count, check = np.asarray(plan(rolling_at(20.0), (0.01, 0.0), vehicle.numbers, 0.1)).ravel()[:3]
    assert candidates(vehicle.model)[int(which)][1] == "rk4" and check > 0.0 and count >= 1.0
