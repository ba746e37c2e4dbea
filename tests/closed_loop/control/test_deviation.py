"""Plans that no car can follow show in the deviation."""

import numpy as np
import pytest

from olt_closed_loop.control.plans import WorldPlan
from olt_closed_loop.control.tracking import TrackingController
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import VehicleParameters
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

CAR = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)


def counts_after(speed, curvature, steps=20):
    """Plans made anew in every step from where the car is, along an arc."""
    controller, stepper, state = TrackingController(CAR), VehicleStepper(CAR), np.array([0, 0, 0, speed, 0, 0], float)
    seconds = 0.1 * np.arange(65)
    turned = speed * curvature * seconds
    for step in range(steps):
        yaw, radius = state[2] + turned, 1.0 / curvature
        x = state[0] + radius * (np.sin(yaw) - np.sin(state[2]))
        y = state[1] - radius * (np.cos(yaw) - np.cos(state[2]))
        times = 100_000 * (step + np.arange(65, dtype=np.int64))
        state = stepper(state, controller.control(state, WorldPlan(times, np.stack([x, y, yaw], -1)), int(times[0])))
    return controller.counts


def test_a_plan_that_can_be_driven_deviates_by_centimetres():
    counts = counts_after(10.0, 0.01)
    assert 0.0 < counts.deviation_rms <= counts.deviation_max < 0.1
    assert counts.calls == 20


@pytest.mark.parametrize(("speed", "curvature"), [(30.0, 0.1), (15.0, 0.33)])
def test_a_plan_beyond_grip_deviates_by_metres_though_it_starts_where_the_car_is(speed, curvature):
    counts = counts_after(speed, curvature)
    assert counts.deviation_max > 2.0 and counts.deviation_rms > 0.5


def test_nothing_is_measured_before_the_first_call():
    assert np.isnan(TrackingController(CAR).counts.deviation_rms)
