from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.benchmarks.alpasim_vehicle import alpasim_vehicle
from olt_closed_loop.benchmarks.vehicle import (
    BENCHMARK,
    VEHICLES,
    Integration,
    integrations,
    manoeuvres,
    prepare_drive,
    reference_positions,
)
from olt_closed_loop.benchmarks.vehicle_grid import Cell, cell_errors, special_cases, special_row
from olt_closed_loop.vehicle import compiled
from olt_closed_loop.vehicle.integration_plan import stiffness_plan
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import MODELS
from olt_generator.errors import InputError


def position_errors(model, method, substeps=None, step=0.1):
    """Largest position error of each manoeuvre against DOP853."""
    positions = prepare_drive(Integration(model, method, substeps, step))()
    return np.linalg.norm(positions - reference_positions(model), axis=-1).max(axis=1)


def drive_along(stepper, state, controls):
    states = [state]
    for control in controls:
        states.append(stepper(states[-1], control))
    return np.stack(states)


@pytest.mark.parametrize(
    ("model", "method", "substeps", "order"),
    [
        ("kinematic", "midpoint", 64, 2),
        ("kinematic", "rk4", 8, 4),
        pytest.param("saturating", "midpoint", 64, 2, marks=pytest.mark.slow),
        pytest.param("saturating", "rk4", 16, 4, marks=pytest.mark.slow),
    ],
)
def test_methods_converge_to_the_reference_at_their_order(model, method, substeps, order):
    # The first three manoeuvres, which are smooth. Few sub-steps: soon the fourth order is at rounding.
    coarse, fine = (position_errors(model, method, factor * substeps)[:3] for factor in (1, 2))
    np.testing.assert_allclose(np.log2(coarse / fine), order, atol=0.8)


@pytest.mark.parametrize("model", ["kinematic", "saturating"])
@pytest.mark.parametrize("method", ["auto", "cvodes"])
def test_methods_that_choose_for_themselves_stay_below_a_micrometre(model, method):
    assert position_errors(model, method).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.02, 0.2])
def test_the_step_does_not_change_the_accuracy_of_auto(step):
    assert position_errors("saturating", "auto", step=step).max() < 2e-6


@pytest.mark.slow
def test_radau_gains_five_orders_with_its_elements():
    coarse, fine = (position_errors("saturating", "radau", elements)[:4].max() for elements in (2, 8))
    assert fine < coarse / 4.0**4


def test_radau_agrees_where_explicit_methods_need_many_substeps():
    vehicle = alpasim_vehicle()
    stiff = replace(vehicle, tyres=replace(vehicle.tyres, mass=600.0, yaw_inertia=1000.0, rear_stiffness=3e6))
    state, control = np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.3, 0.0])
    radau = VehicleStepper(stiff, "radau", 32)(state, control)
    np.testing.assert_allclose(radau, VehicleStepper(stiff)(state, control), atol=1e-7)


def test_every_model_and_method_is_measured():
    measured = {(each.model, each.method) for each in integrations()}
    assert measured == {
        (model, method) for model in MODELS for method in ("auto", "midpoint", "rk4", "radau", "cvodes")
    }


def test_the_benchmark_tells_error_and_batch_time_of_a_setting():
    result = BENCHMARK.settings()[4].prepare()()
    assert BENCHMARK.measure_error(result) < 1e-3
    assert BENCHMARK.figures(result)["batch (us a step)"] > 0.0


@pytest.mark.parametrize("model", MODELS)
def test_a_batch_steps_every_vehicle_as_if_it_were_alone(model):
    states, controls = manoeuvres(model)
    stepper, batch = VehicleStepper(VEHICLES[model]), VehicleStepper([VEHICLES[model]] * len(states))
    alone = np.stack([stepper(state, held[3]) for state, held in zip(states, controls, strict=True)])
    np.testing.assert_array_equal(batch(states, controls[:, 3]), alone)


def test_compiled_and_interpreted_steps_are_equal(monkeypatch):
    states, controls = manoeuvres("saturating")
    vehicle = VEHICLES["saturating"]
    with_compiler = VehicleStepper([vehicle] * len(states))
    monkeypatch.setattr(compiled, "compile_program", lambda program: None)
    without = VehicleStepper([vehicle] * len(states))
    np.testing.assert_array_equal(without(states, controls[:, 2]), with_compiler(states, controls[:, 2]))
    assert without.taken() == with_compiler.taken()
    assert list(without.left_out()) == list(with_compiler.left_out())


def test_a_slide_takes_the_same_substeps_in_every_direction():
    vehicle, ends, reports = alpasim_vehicle(friction=0.3), [], []
    for yaw in (0.0, np.pi / 2):
        stepper = VehicleStepper(vehicle)
        end = drive_along(stepper, np.array([0.0, 0.0, yaw, 15.0, 0.0, 0.0, 0.0, 0.0]), np.full((10, 2), [0.3, 0.0]))[
            -1
        ]
        ends.append(end)
        reports.append((stepper.taken(), list(stepper.left_out())))
    assert reports[0] == reports[1]
    np.testing.assert_allclose(ends[1][:2], [-ends[0][1], ends[0][0]], atol=1e-9)


@pytest.mark.parametrize("step", [0.05, 0.2])
def test_the_tolerance_is_that_of_a_tenth_of_a_second(step):
    stepper = VehicleStepper(VEHICLES["linear"], "rk4", step=step, tolerance=1e-9)
    state, control = np.array([0.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.2, 0.0])
    stepper(state, control)
    ((_, count),) = stepper.taken().values()
    plan = stiffness_plan("linear", "rk4", 1e-9 * step / 0.1)
    assert count == np.asarray(plan(state, control, VEHICLES["linear"].numbers, step))[1, 0]


def test_results_are_not_overwritten_by_the_next_call():
    states, controls = manoeuvres("kinematic")
    stepper = VehicleStepper(VEHICLES["kinematic"])
    first = stepper(states[0], controls[0, 0])
    kept = first.copy()
    stepper(states[1], controls[1, 0])
    np.testing.assert_array_equal(first, kept)


@pytest.mark.parametrize("tolerance", [pytest.param(1e-6, marks=pytest.mark.slow), 1e-3])
def test_what_auto_leaves_out_changes_nothing_beyond_its_tolerance(tolerance):
    vehicle = alpasim_vehicle(friction=1.0)
    # Standing, moving off straight ahead, a gentle bend, straight braking to standstill, standing.
    controls = np.repeat([[0.0, -2.0], [0.0, 2.0], [0.002, 0.0], [0.0, -2.0], [0.0, -2.0]], 20, axis=0)
    state = np.zeros(8)
    leaving_out, everything_on = VehicleStepper(vehicle, tolerance=tolerance), VehicleStepper(vehicle, "cvodes")
    states = drive_along(leaving_out, state, controls)
    # Each step from where the other came to: the tolerance is that of one step.
    full = np.stack([everything_on(before, control) for before, control in zip(states, controls, strict=False)])
    assert np.linalg.norm((states[1:] - full)[:, :2], axis=1).max() <= tolerance
    whole = drive_along(everything_on, state, controls)
    assert np.linalg.norm((states - whole)[:, :2], axis=1).max() <= tolerance * len(controls)
    assert any(omission.what == "steps of tyre slip" for omission in leaving_out.left_out())


def test_tyres_are_not_left_out_where_they_slide():
    stepper = VehicleStepper(alpasim_vehicle(friction=0.3), tolerance=1e-3)
    drive_along(stepper, np.array([0.0, 0.0, 0.0, 15.0, 0.0, 0.0, 0.0, 0.0]), np.full((10, 2), [0.3, 0.0]))
    taken = stepper.taken()
    assert list(stepper.left_out()) == []
    assert sum(steps for steps, _ in taken.values()) == 10
    assert all(way.startswith("saturating ") for way in taken)


def test_stiffer_moments_take_more_substeps():
    counts = []
    for speed in (2.0, 30.0):
        stepper = VehicleStepper(alpasim_vehicle(), "rk4", tolerance=1e-3)
        stepper(np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0]), np.array([0.01, 0.0]))
        ((_, substeps),) = stepper.taken().values()
        counts.append(substeps)
    assert counts[0] > counts[1]


@pytest.mark.parametrize("step", [0.1, *(pytest.param(step, marks=pytest.mark.slow) for step in (0.025, 0.2))])
def test_extreme_cells_are_stable(step):
    cells = [
        Cell(speed, friction, stiffness, mass, step, 0.6)
        for speed, friction, stiffness, mass in ((0.0, 1.2, 10.0, 0.3), (60.0, 0.05, 0.2, 3.0), (5.0, 0.3, 2.5, 1.0))
    ]
    assert cell_errors(cells).max() < 1e-4


@pytest.mark.parametrize("case", special_cases(), ids=lambda case: case.name)
def test_special_cases_come_out_as_they_should(case):
    assert special_row(case)["outcome"] == ("refused" if "NaN" in case.name else "as it should")


@pytest.mark.parametrize("method", ["auto", "radau"])
def test_what_is_not_finite_is_refused_by_name(method):
    stepper = VehicleStepper([alpasim_vehicle()] * 2, method)
    controls = np.zeros((2, 2))
    controls[1, 0] = np.nan
    with pytest.raises(InputError, match=r"vehicle 1: its control is \[nan, 0.0\]"):
        stepper(np.zeros((2, 8)), controls)
    with pytest.raises(InputError, match="vehicle 0: its state"):
        stepper(np.full((2, 8), np.inf), np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "euler"}, "no integrator 'euler'"),
        ({"step": 0.0}, "positive"),
        ({"tolerance": np.nan}, "positive"),
        ({"method": "rk4", "substeps": 0}, "sub-steps"),
    ],
)
def test_settings_that_make_no_sense_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        VehicleStepper(VEHICLES["kinematic"], **arguments)
