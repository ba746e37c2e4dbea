"""One-step maps of the vehicle over a step in which the control is held.

Methods: explicit Euler, explicit midpoint and the classical Runge-Kutta method of fourth order with equal sub-steps
(Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.1), and CVODES (Sundials), which chooses
order and sub-steps itself.

The default is RK4 with 10 sub-steps of 10 ms. `olt bench vehicle` is the argument: it is the cheapest setting whose
largest position error stays below 1e-6 m over two seconds of the hardest manoeuvres (0.3 rad steering steps at 10 to
40 m/s, full braking to standstill); coarser steps save a few microseconds and lose two digits and more.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Literal

import casadi as ca

from olt_closed_loop.buffered import BufferedFunction
from olt_closed_loop.vehicle import CONTROL_SIZE, STATE_SIZE, VehicleParameters, vehicle_equations
from olt_generator.poses import Array

Method = Literal["euler", "midpoint", "rk4", "cvodes"]
Stepper = Callable[[Array, Array], Array]
"""Maps state (6,) and control (2,) to the state (6,) one step later; batched ones take a leading axis."""

CVODES_TOLERANCE = 1e-10
DEFAULT_METHOD: Method = "rk4"
DEFAULT_SUBSTEPS = 10


def make_stepper(
    parameters: VehicleParameters,
    method: Method = DEFAULT_METHOD,
    substeps: int = DEFAULT_SUBSTEPS,
    step: float = 0.1,
) -> Stepper:
    """The map over `step` seconds; CVODES ignores `substeps`."""
    return _call(step_function(parameters, method, substeps, step))


def make_batch_stepper(
    parameters: VehicleParameters,
    count: int,
    method: Method = DEFAULT_METHOD,
    substeps: int = DEFAULT_SUBSTEPS,
    step: float = 0.1,
) -> Stepper:
    """The same map for `count` vehicles at once: states (count, 6), controls (count, 2)."""
    return _call(step_function(parameters, method, substeps, step).map(count))


def _call(function: ca.Function) -> Stepper:
    buffered = BufferedFunction(function)
    return lambda state, control: buffered(state, control)[0]


@lru_cache(maxsize=32)
def step_function(parameters: VehicleParameters, method: Method, substeps: int, step: float) -> ca.Function:
    """The one-step map as a CasADi function of (state, control), for what differentiates or repeats it."""
    if method == "cvodes":
        return _cvodes(parameters, step)
    advance = {"euler": _euler, "midpoint": _midpoint, "rk4": _rk4}[method]
    start, control = ca.SX.sym("state", STATE_SIZE), ca.SX.sym("control", CONTROL_SIZE)
    equations = vehicle_equations(parameters)
    state = start
    for _ in range(substeps):
        state = advance(lambda x: equations(x, control), state, step / substeps)
    return ca.Function("step", [start, control], [ca.cse(state)], ["state", "control"], ["next_state"])


_Derivative = Callable[[ca.SX], ca.SX]


def _euler(derivative: _Derivative, state: ca.SX, step: float) -> ca.SX:
    return state + step * derivative(state)


def _midpoint(derivative: _Derivative, state: ca.SX, step: float) -> ca.SX:
    return state + step * derivative(state + 0.5 * step * derivative(state))


def _rk4(derivative: _Derivative, state: ca.SX, step: float) -> ca.SX:
    k1 = derivative(state)
    k2 = derivative(state + 0.5 * step * k1)
    k3 = derivative(state + 0.5 * step * k2)
    k4 = derivative(state + step * k3)
    return state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def _cvodes(parameters: VehicleParameters, step: float) -> ca.Function:
    state, control = ca.SX.sym("state", STATE_SIZE), ca.SX.sym("control", CONTROL_SIZE)
    problem = {"x": state, "p": control, "ode": vehicle_equations(parameters)(state, control)}
    options = {"abstol": CVODES_TOLERANCE, "reltol": CVODES_TOLERANCE}
    integrator = ca.integrator("integrator", "cvodes", problem, 0.0, step, options)
    start, held = ca.MX.sym("state", STATE_SIZE), ca.MX.sym("control", CONTROL_SIZE)
    return ca.Function(
        "step", [start, held], [integrator(x0=start, p=held)["xf"]], ["state", "control"], ["next_state"]
    )
