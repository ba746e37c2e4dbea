from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_closed_loop.benchmarks.alpasim_vehicle import alpasim_vehicle
from olt_closed_loop.control.box_quadratic import SolveFailed, minimise_in_box
from olt_closed_loop.control.cost import TrackingCost
from olt_closed_loop.control.linear import LinearSolver
from olt_closed_loop.control.nonlinear import NonlinearSolver
from olt_closed_loop.control.plans import WorldPlan
from olt_closed_loop.control.prediction import linearised_step, predicted_step
from olt_closed_loop.control.tracking import ControlSettings, TrackingController
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import VehicleParameters, with_rolling_tyres
from olt_generator.errors import InputError
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

KINEMATIC = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)
VEHICLES = {"kinematic": KINEMATIC, "linear": alpasim_vehicle(), "saturating": alpasim_vehicle(0.9)}
TIMES = 0.1 * np.arange(1, 21)
TARGET = np.stack([15.0 * TIMES, 0.3 * TIMES**2, 0.04 * TIMES], axis=-1)


def starting(parameters, speed=15.0):
    return with_rolling_tyres(np.array([0.0, 0.0, 0.0, speed, 0.02, 0.5]), parameters)


def solver_of(method, parameters, rounds=1):
    if method == "nonlinear":
        return NonlinearSolver(parameters, TrackingCost(), 20)
    return LinearSolver(parameters, TrackingCost(), 20, rounds, limited=method == "linear")


@given(seed=st.integers(0, 10_000), size=st.integers(1, 12))
def test_a_quadratic_in_a_box_is_minimal_in_every_direction_that_the_box_leaves(seed, size):
    generator = np.random.default_rng(seed)
    factor = generator.normal(size=(size + 2, size))
    hessian, gradient = factor.T @ factor + 0.1 * np.eye(size), generator.normal(scale=3.0, size=size)
    low, high = -generator.uniform(0.0, 1.0, size), generator.uniform(0.0, 1.0, size)
    x = minimise_in_box(hessian, gradient, low, high)
    slope = hessian @ x + gradient
    assert np.all((x >= low) & (x <= high))
    assert np.all(slope[x > low] < 1e-6) and np.all(slope[x < high] > -1e-6)


def test_a_quadratic_with_nan_has_no_solution():
    with pytest.raises(SolveFailed):
        minimise_in_box(np.eye(2), np.array([1.0, np.nan]), -np.ones(2), np.ones(2))


@pytest.mark.parametrize("parameters", VEHICLES.values(), ids=VEHICLES)
@pytest.mark.parametrize("speed", [0.0, 1.0, 5.0, 20.0, 60.0])
def test_a_predicted_step_is_close_to_the_exact_one_and_its_slope_true(parameters, speed):
    state, control = starting(parameters, speed), np.array([0.03, 1.0])
    predict, linearise = predicted_step(parameters), linearised_step(parameters)
    predicted = np.asarray(predict(state, control)).ravel()
    exact = VehicleStepper(parameters, "rk4", 100)(state, control)
    np.testing.assert_allclose(predicted[:3], exact[:3], atol=0.02)
    by_control = np.asarray(linearise(state, control)[2].full())
    change = np.array([1e-3, 1e-2])
    moved = [np.asarray(predict(state, control + sign * change)).ravel() for sign in (1.0, -1.0)]
    np.testing.assert_allclose(by_control @ change, 0.5 * (moved[0] - moved[1]), atol=2e-4)


@pytest.mark.parametrize("index", [4, 5, 6, 7], ids=["steering", "acceleration", "lateral speed", "yaw rate"])
def test_a_predicted_step_lets_fast_quantities_decay(index):
    """Quick actuators, and tyres at walking speed: explicit steps of 0.1 s would explode."""
    predict = predicted_step(replace(alpasim_vehicle(), steering_lag=0.01, acceleration_lag=0.01))
    state = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    state[index] = 0.1
    for _ in range(10):
        state = np.asarray(predict(state, np.zeros(2))).ravel()
    assert np.abs(state[4:]).max() < 0.02


@pytest.mark.parametrize("parameters", VEHICLES.values(), ids=VEHICLES)
def test_all_methods_minimise_the_same_cost(parameters):
    start, guess = starting(parameters), np.zeros((20, 2))
    exact = solver_of("nonlinear", parameters).solve(start, [guess], TARGET)
    for method in ("lqr", "linear"):
        found = solver_of(method, parameters, rounds=8).solve(start, [guess], TARGET)
        np.testing.assert_allclose(found, exact, atol=0.01)


def test_a_solver_starts_from_the_cheapest_guess():
    start, good, bad = starting(KINEMATIC), np.zeros((20, 2)), np.tile([0.7, -8.0], (20, 1))
    solver = solver_of("linear", KINEMATIC)
    expected = solver.solve(start, [good], TARGET)
    np.testing.assert_array_equal(solver.solve(start, [bad, good], TARGET), expected)
    assert np.abs(solver.solve(start, [bad], TARGET) - expected).max() > 0.01


def test_limits_that_are_met_are_part_of_the_problem():
    start, guess = starting(KINEMATIC, 2.0), np.zeros((20, 2))
    cut, limited = (
        solver_of(method, KINEMATIC, rounds=3).solve(start, [guess], TARGET) for method in ("lqr", "linear")
    )
    low, high = KINEMATIC.control_limits
    for commands in (cut, limited):
        assert np.all((commands >= low) & (commands <= high))
    assert limited[0, 1] == high[1]
    assert np.abs(limited - cut).max() > 0.01


def curve(speed=15.0, radius=100.0):
    times = np.arange(161, dtype=np.int64) * 100_000
    angle = speed / radius * times * 1e-6
    return WorldPlan(times, np.stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle], axis=-1))


def drive(controller, parameters, plan, state, steps=60, fail=lambda step: None):
    stepper, states, controls = VehicleStepper(parameters), [state], []
    for step in range(steps):
        fail(step)
        controls.append(controller.control(states[-1], plan, 100_000 * step))
        states.append(np.array(stepper(states[-1], controls[-1])))
    return np.stack(states), np.stack(controls)


def errors(states, plan):
    times = 100_000 * np.arange(len(states), dtype=np.int64)
    return np.linalg.norm(states[:, :2] - plan.at(times)[:, :2], axis=1)


def test_failed_solves_are_counted_and_the_last_feasible_commands_go_on(monkeypatch):
    plan, controller = curve(), TrackingController(KINEMATIC)
    solve = LinearSolver.solve

    def failing(*_arguments):
        raise SolveFailed("made to fail")

    def fail(step):
        monkeypatch.setattr(LinearSolver, "solve", failing if 20 <= step < 29 else solve)

    states, controls = drive(controller, KINEMATIC, plan, np.array([0, 0, 0, 15.0, 0, 0]), fail=fail)
    assert controller.counts.failed == 9 and controller.counts.solves == 60
    assert np.all(controls[20:29, 0] > 0.02)
    assert errors(states, plan).max() < 0.3


def test_without_any_solution_the_plan_is_steered_and_then_the_brake_held(monkeypatch):
    def failing(*_arguments):
        raise SolveFailed("made to fail")

    monkeypatch.setattr(LinearSolver, "solve", failing)
    controller = TrackingController(KINEMATIC)
    states, controls = drive(controller, KINEMATIC, curve(), np.array([0, 0, 0, 15.0, 0, 0]), steps=120)
    assert np.all(controls[:20, 0] == pytest.approx(np.arctan(KINEMATIC.wheelbase / 100.0), abs=1e-3))
    assert np.all(controls[20:, 1] == -2.0)
    assert states[-1, 3] < 0.1
    assert controller.counts.failed > 80


def test_late_solves_are_counted_and_serve_from_the_next_call():
    plan, late = curve(), TrackingController(KINEMATIC, ControlSettings(deadline_seconds=0.0))
    states, _ = drive(late, KINEMATIC, plan, np.array([0, 0, 0, 15.0, 0, 0]))
    assert late.counts.late == late.counts.solves == 60
    assert errors(states, plan).max() < 0.3


def move_off_with_the_nonlinear_method():
    """Where brakes have a kink fatrop gives up."""
    times = np.arange(66, dtype=np.int64) * 100_000
    plan = WorldPlan(times, np.stack([5e-6 * times, 0.0 * times, 0.0 * times], axis=-1))
    controller = TrackingController(KINEMATIC, ControlSettings(method="nonlinear"))
    states, controls = drive(controller, KINEMATIC, plan, np.zeros(6), steps=15)
    return controller.counts, states, controls


def test_what_fatrop_gives_up_is_counted_and_solved_otherwise():
    events, states, _ = move_off_with_the_nonlinear_method()
    assert events.given_up > 0 and events.failed == 0
    assert states[-1, 3] > 5.0


def test_what_the_fallback_gives_up_too_has_failed_and_the_last_feasible_commands_go_on(monkeypatch):
    def failing(*_arguments):
        raise SolveFailed("made to fail")

    monkeypatch.setattr(LinearSolver, "solve", failing)
    events, _, controls = move_off_with_the_nonlinear_method()
    assert events.failed == events.given_up == 15
    np.testing.assert_allclose(controls[:10, 1], KINEMATIC.max_acceleration)
    assert np.all(controls[10:, 1] == -2.0)


@pytest.mark.parametrize("method", ["linear", "nonlinear"])
def test_a_plan_out_of_reach_fails_in_words(method):
    solver = solver_of(method, KINEMATIC)
    with pytest.raises(SolveFailed, match="not finite"):
        solver.solve(starting(KINEMATIC), [np.zeros((20, 2))], TARGET + 1e200)


def test_a_state_that_is_not_finite_is_refused():
    with pytest.raises(InputError, match="not finite"):
        TrackingController(KINEMATIC).control(np.array([0, 0, 0, np.nan, 0, 0]), curve(), 0)


def test_equal_drives_are_equal():
    first, second = (
        drive(TrackingController(KINEMATIC), KINEMATIC, curve(), np.array([0, 0, 0, 14.0, 0, 0]))[0] for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)
