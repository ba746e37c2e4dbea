"""Plans that alternate by 0.25 m to either side, as a recorded rollout has them."""

import json

import numpy as np
import pytest

from olt_closed_loop.benchmarks.noisy_plans import count_reversals
from olt_closed_loop.control.plans import WorldPlan
from olt_closed_loop.control.tracking import ControlSettings, TrackingController
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import VehicleParameters
from olt_closed_loop.vehicle.state import STATE
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE


def steering_under(plans, settings):
    """Steering angles of a car that is given the plans one after the other, and how far it left the line, metres."""
    vehicle = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)
    controller, stepper = TrackingController(vehicle, settings), VehicleStepper(vehicle)
    first = np.array(plans[0]["poses"])
    state = np.array([*first[0], np.linalg.norm(first[1, :2] - first[0, :2]) / 0.1, 0.0, 0.0])
    states = [state]
    for plan in plans:
        given = WorldPlan(np.array(plan["timestamps_us"], dtype=np.int64), np.array(plan["poses"], dtype=np.float64))
        states.append(stepper(states[-1], controller.control(states[-1], given, int(plan["now_us"]))))
    driven = np.stack(states)
    return driven[:, STATE.steering], np.abs(driven[:, STATE.y]).max()


def test_alternating_plans_do_not_make_the_wheel_saw(shared_real):
    path = shared_real.parent / "parity" / "plans_jitter_0.25m.json"
    if not path.exists():
        pytest.skip("no rollout with alternating plans in ../shared/parity")
    plans = json.loads(path.read_text())["plans"][:120]
    smooth, offset = steering_under(plans, ControlSettings())
    raw, _ = steering_under(plans, ControlSettings(smoothing_window=0.0, smoothing_delay=0.0))
    print(count_reversals(raw), count_reversals(smooth), np.ptp(raw), np.ptp(smooth), offset)
    assert count_reversals(smooth) < 0.2 * count_reversals(raw)
    assert np.ptp(smooth[20:]) < 0.2 * np.ptp(raw[20:])
    assert offset < 0.25
