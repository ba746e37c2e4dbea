"""Implicit steps of the vehicle models: Radau collocation and CVODES, both from CasADi's wheel.

Radau IIA with three collocation points (order 5, stiffly accurate; Hairer, Wanner, Solving Ordinary Differential
Equations II, section IV.5) on equal elements, and Sundials' CVODES, which chooses order and sub-steps to a tolerance.
Both integrate the whole equations, lags included, over the time scaled to 0..1, so one function serves every step and
vehicle.
"""

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from olt_closed_loop.vehicle.buffered import BufferedFunction
from olt_closed_loop.vehicle.compiled import PLAN_SIZE, SerialStep
from olt_closed_loop.vehicle.models import state_derivative, step_symbols, within_limits
from olt_closed_loop.vehicle.parameters import Model, VehicleNumbers, model_state_size
from olt_closed_loop.vehicle.state import STATE
from olt_generator.errors import InputError
from olt_generator.poses import Array

RADAU_POINTS = 3
NEWTON_TOLERANCE = 1e-12
CVODES_TOLERANCE = 1e-10


@lru_cache(maxsize=32)
def radau_function(model: Model, elements: int) -> ca.Function:
    """(state, control, numbers of the vehicle, step in seconds) -> state one step later."""
    options: dict[str, Any] = {
        "collocation_scheme": "radau",
        "interpolation_order": RADAU_POINTS,
        "number_of_finite_elements": elements,
        "rootfinder": "newton",
        "rootfinder_options": {"abstol": NEWTON_TOLERANCE, "max_iter": 100, "error_on_fail": True},
    }
    return _step_function(model, "collocation", options)


@lru_cache(maxsize=32)
def cvodes_function(model: Model, tolerance: float = CVODES_TOLERANCE) -> ca.Function:
    """The same map, to a tolerance for each sub-step of CVODES."""
    options = {"abstol": tolerance, "reltol": tolerance, "max_num_steps": 1_000_000, "disable_internal_warnings": True}
    return _step_function(model, "cvodes", options)


def _step_function(model: Model, plugin: str, options: dict[str, Any]) -> ca.Function:
    state, control, numbers, step = step_symbols(model_state_size(model))
    vehicle = VehicleNumbers(*ca.vertsplit(numbers))
    derivative = step * state_derivative(model, state, control, vehicle)
    problem = {"x": state, "p": ca.vertcat(control, numbers, step), "ode": derivative}
    integrator = ca.integrator("integrator", plugin, problem, 0.0, 1.0, options)
    arguments = [ca.MX.sym("argument", symbol.numel()) for symbol in (state, control, numbers, step)]
    start = ca.Function("start", [state, numbers], [within_limits(state, vehicle)])
    end = integrator(x0=start(arguments[0], arguments[2]), p=ca.vertcat(*arguments[1:]))["xf"]
    return ca.Function(f"{model}_{plugin}", arguments, [end])


class ImplicitStep(SerialStep):
    """Steps one vehicle after the other with an implicit function, which chooses its own sub-steps."""

    def __init__(self, function: ca.Function, numbers: Array, step: float) -> None:
        super().__init__(numbers, step, function.size1_in(0), ways=1)
        self._function = BufferedFunction(function)

    def step_one(self, state: Array, control: Array, numbers: Array) -> tuple[Array, Array]:
        """See `SerialStep`. Raises `InputError` where the equations cannot be solved."""
        try:
            (end,) = self._function(np.concatenate([[0.0, 0.0], state[STATE.yaw :]]), control, numbers, self._step)
        except RuntimeError as error:
            raise InputError(
                f"{self._function.name}: no solution from state {state.tolist()} under control "
                f"{control.tolist()} over {self._step:g} s; take a shorter step, more elements, or the method auto"
            ) from error
        end[: STATE.yaw] += state[: STATE.yaw]
        return end, np.zeros(PLAN_SIZE)
