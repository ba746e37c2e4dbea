"""Implicit steps of the vehicle models: Radau collocation and CVODES, both from CasADi's wheel.

Radau IIA of three stages (order 5, stiffly accurate; Hairer, Wanner, Solving Ordinary Differential Equations II,
section IV.5) on equal elements, and Sundials' CVODES, which chooses order and sub-steps to a tolerance. Both integrate
the whole equations, lags included, over the time scaled to 0..1, so one function serves every step and vehicle.
"""

from functools import lru_cache
from typing import Any, Literal

import casadi as ca

from olt_closed_loop.vehicle.models import NUMBERS_SIZE, Model, VehicleNumbers, model_state_size, state_derivative
from olt_closed_loop.vehicle.state import CONTROL_SIZE

ImplicitMethod = Literal["radau", "cvodes"]
RADAU_STAGES = 3
NEWTON_TOLERANCE = 1e-12
CVODES_TOLERANCE = 1e-10


@lru_cache(maxsize=32)
def radau_function(model: Model, elements: int) -> ca.Function:
    """(state, control, numbers of the vehicle, step in seconds) -> state one step later."""
    options: dict[str, Any] = {
        "collocation_scheme": "radau",
        "interpolation_order": RADAU_STAGES,
        "number_of_finite_elements": elements,
        "rootfinder": "newton",
        "rootfinder_options": {"abstol": NEWTON_TOLERANCE, "max_iter": 100, "error_on_fail": True},
    }
    return _step_function(model, "collocation", options)


@lru_cache(maxsize=32)
def cvodes_function(model: Model, tolerance: float = CVODES_TOLERANCE) -> ca.Function:
    """The same map, to a tolerance for each sub-step of CVODES."""
    options: dict[str, Any] = {
        "abstol": tolerance,
        "reltol": tolerance,
        "max_num_steps": 1_000_000,
        "disable_internal_warnings": True,
    }
    return _step_function(model, "cvodes", options)


def _step_function(model: Model, plugin: str, options: dict[str, Any]) -> ca.Function:
    state = ca.SX.sym("state", model_state_size(model))
    control, numbers, step = ca.SX.sym("control", CONTROL_SIZE), ca.SX.sym("numbers", NUMBERS_SIZE), ca.SX.sym("step")
    derivative = step * state_derivative(model, state, control, VehicleNumbers(*ca.vertsplit(numbers)))
    problem = {"x": state, "p": ca.vertcat(control, numbers, step), "ode": derivative}
    integrator = ca.integrator("integrator", plugin, problem, 0.0, 1.0, options)
    arguments = [ca.MX.sym("state", state.numel()), ca.MX.sym("control", CONTROL_SIZE)]
    arguments += [ca.MX.sym("numbers", NUMBERS_SIZE), ca.MX.sym("step")]
    end = integrator(x0=arguments[0], p=ca.vertcat(*arguments[1:]))["xf"]
    return ca.Function(f"{model}_{plugin}", arguments, [end])
