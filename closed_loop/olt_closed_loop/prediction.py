"""How a controller foresees the vehicle: one control step of 0.1 s of the vehicle's own equations, and its derivatives.

Tyres make the equations stiff at low speed, and a controller looks far ahead at low cost. So the steps are those of the
L-stable Rosenbrock method ROS2 (Verwer, Spee, Blom, Hundsdorfer, SIAM J. Sci. Comput. 20, 1999): second order, two
evaluations and one small linear system, no iteration, and stable at any speed.
"""

import casadi as ca

from olt_closed_loop.vehicle import VehicleParameters, vehicle_equations
from olt_toolkit.policy import STEP_SECONDS

_GAMMA = 1.0 - 0.5**0.5


def predicted_step(parameters: VehicleParameters, substeps: int) -> ca.Function:
    """(state, control) -> the state 0.1 s later."""
    equations = vehicle_equations(parameters)
    start, control = ca.SX.sym("state", equations.size1_in(0)), ca.SX.sym("control", equations.size1_in(1))
    rosenbrock = _rosenbrock_step(equations, STEP_SECONDS / substeps)
    state = start
    for _ in range(substeps):
        state = rosenbrock(state, control)
    return ca.Function("predicted_step", [start, control], [ca.cse(state)])


def _rosenbrock_step(equations: ca.Function, step: float) -> ca.Function:
    state, control = ca.SX.sym("state", equations.size1_in(0)), ca.SX.sym("control", equations.size1_in(1))
    derivative = equations(state, control)
    system = ca.SX.eye(state.numel()) - _GAMMA * step * ca.jacobian(derivative, state)
    first = ca.solve(system, derivative)
    second = ca.solve(system, equations(state + step * first, control) - 2.0 * first)
    return ca.Function("rosenbrock", [state, control], [ca.cse(state + step * (1.5 * first + 0.5 * second))])
