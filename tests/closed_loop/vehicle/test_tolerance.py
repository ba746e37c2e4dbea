"""Every step of `auto` keeps its tolerance."""

import numpy as np
import pytest

from olt_closed_loop.benchmarks.vehicle_steps import RandomSteps, draw_steps, random_step_rows, step_errors
from olt_closed_loop.vehicle.integrators import DEFAULT_TOLERANCE, VehicleStepper
from olt_closed_loop.vehicle.parameters import MODELS, VehicleParameters
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

CAR = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)


@pytest.mark.parametrize("seconds", [0.01, 0.1, 0.5])
@pytest.mark.parametrize("model", MODELS)
def test_random_steps_keep_the_tolerance(model, seconds):
    errors = step_errors(draw_steps(model, 600, seed=5), seconds)
    assert errors.position.max() <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 7])
def test_none_of_many_random_steps_is_above_the_tolerance(seed):
    rows = list(random_step_rows(4000, seed))
    assert sum(row["steps"] for row in rows) == 48_000
    assert sum(row["above_tolerance"] for row in rows) == 0


@pytest.mark.parametrize("model", MODELS)
def test_the_reference_of_random_steps_is_right(model):
    steps = draw_steps(model, 40, seed=8)
    ends = [
        VehicleStepper(steps.vehicles, method, count)(steps.states, steps.controls)
        for method, count in (("rk4", 1024), ("cvodes", None))
    ]
    assert np.abs(ends[0] - ends[1])[:, :2].max() < 0.3 * DEFAULT_TOLERANCE


@pytest.mark.parametrize("speed", [0.0, 0.005, 0.3, 2.0, 20.0])
@pytest.mark.parametrize("accelerations", [(-3.3, 5.1), (5.1, -3.3), (-0.01, 6.0), (6.0, -8.0)])
def test_a_step_from_brake_to_drive_or_back_keeps_the_tolerance(speed, accelerations):
    before, command = accelerations
    steps = RandomSteps([CAR], np.array([[0.0, 0.0, 0.0, speed, 0.39, before]]), np.array([[0.16, command]]))
    assert step_errors(steps, 0.1).position.max() <= 1.0
