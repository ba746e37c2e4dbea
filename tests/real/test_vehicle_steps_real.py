"""Steps that were once reported to leave the tolerance."""

import numpy as np
import pytest

from olt_closed_loop.benchmarks.vehicle_steps import RandomSteps, step_errors
from olt_closed_loop.vehicle.parameters import VehicleParameters
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE


def test_reported_steps_keep_the_tolerance(shared_real):
    path = shared_real.parent / "cases" / "rollouts" / "vehicle_tolerance.npz"
    if not path.exists():
        pytest.skip("no reported steps in ../shared/cases/rollouts")
    with np.load(path) as reported:
        states, controls = np.atleast_2d(reported["state"], reported["control"])
    vehicles = [VehicleParameters.from_dimensions(DEFAULT_VEHICLE)] * len(states)
    assert step_errors(RandomSteps(vehicles, states, controls), 0.1).position.max() <= 1.0
