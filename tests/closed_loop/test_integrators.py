import numpy as np
import pytest

from olt_closed_loop.benchmarks.vehicle import BENCHMARK, PARAMETERS, manoeuvres, reference_positions
from olt_closed_loop.integrators import make_batch_stepper, make_stepper


def position_errors(method, substeps):
    """Largest position error of each manoeuvre against DOP853."""
    states, controls = manoeuvres()
    stepper = make_stepper(PARAMETERS, method, substeps)
    positions = np.zeros((*controls.shape[:2], 2))
    for row, (state, held) in enumerate(zip(states, controls, strict=True)):
        for index, control in enumerate(held):
            state = stepper(state, control)
            positions[row, index] = state[:2]
    return np.linalg.norm(positions - reference_positions(), axis=-1).max(axis=1)


@pytest.mark.parametrize(("method", "order"), [("euler", 1), ("midpoint", 2), ("rk4", 4)])
def test_methods_converge_to_the_reference_at_their_order(method, order):
    coarse, fine = position_errors(method, 8), position_errors(method, 16)
    np.testing.assert_allclose(np.log2(coarse / fine), order, atol=0.35)


def test_the_default_is_the_cheapest_setting_below_a_micrometre():
    errors = {setting.name: BENCHMARK.measure_error(setting.prepare()()) for setting in BENCHMARK.settings()}
    defaults = [setting.name for setting in BENCHMARK.settings() if setting.default]
    assert defaults == ["RK4 10 ms"]
    assert errors["RK4 10 ms"] < 1e-6 < errors["RK4 25 ms"]
    assert errors["CVODES 1e-10"] < 1e-6


def test_a_batch_steps_every_vehicle_as_if_it_were_alone():
    states, controls = manoeuvres()
    stepper, batch = make_stepper(PARAMETERS), make_batch_stepper(PARAMETERS, len(states))
    alone = np.stack([stepper(state, held[3]) for state, held in zip(states, controls, strict=True)])
    np.testing.assert_array_equal(batch(states, controls[:, 3]), alone)


def test_results_are_not_overwritten_by_the_next_call():
    states, controls = manoeuvres()
    stepper = make_stepper(PARAMETERS)
    first = stepper(states[0], controls[0, 0])
    kept = first.copy()
    stepper(states[1], controls[1, 0])
    np.testing.assert_array_equal(first, kept)
