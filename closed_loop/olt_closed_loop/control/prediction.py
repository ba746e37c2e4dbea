"""How a controller foresees the vehicle: its own equations over one control step of 0.1 s, and their derivatives.

Tyres and actuators make the equations stiff, and a controller looks far ahead at low cost. So a step is one of the
L-stable Rosenbrock method ROS2 (Verwer, Spee, Blom, Hundsdorfer, SIAM J. Sci. Comput. 20, 1999): two evaluations and
one linear system, no iteration. It is of second order whatever matrix stands for the Jacobian, so only the stiff part
of that is used, and the derivatives of the step take the matrix as given.
"""

import casadi as ca

from olt_closed_loop.vehicle.models import vehicle_equations
from olt_closed_loop.vehicle.parameters import VehicleParameters
from olt_closed_loop.vehicle.state import CONTROL_SIZE, STATE
from olt_toolkit.policy.contract import STEP_SECONDS

_GAMMA = 1.0 - 0.5**0.5


def predicted_step(parameters: VehicleParameters) -> ca.Function:
    """(state, control) -> the state 0.1 s later."""
    linearised = linearised_step(parameters)
    state, control = ca.SX.sym("state", linearised.size1_in(0)), ca.SX.sym("control", CONTROL_SIZE)
    return ca.Function("predicted_step", [state, control], [linearised(state, control)[0]])


def linearised_step(parameters: VehicleParameters) -> ca.Function:
    """(state, control) -> the state 0.1 s later and its derivatives by state and by control."""
    equations = vehicle_equations(parameters)
    state, control = ca.SX.sym("state", equations.size1_in(0)), ca.SX.sym("control", CONTROL_SIZE)
    # The Jacobian is large where a quantity lags or fades by itself, and where tyres hold their two by each other.
    tyres = range(STATE.acceleration + 1, state.numel())
    entries = [(index, index) for index in (STATE.speed, STATE.steering, STATE.acceleration)]
    entries += [(row, column) for row in tyres for column in tyres]
    sparsity = ca.Sparsity.triplet(state.numel(), state.numel(), *zip(*entries, strict=True))
    stiff = ca.SX.sym("stiff", sparsity)
    system = ca.SX.eye(state.numel()) - _GAMMA * STEP_SECONDS * stiff
    derivative = equations(state, control)
    first = ca.solve(system, derivative)
    second = ca.solve(system, equations(state + STEP_SECONDS * first, control) - 2.0 * first)
    following = state + STEP_SECONDS * (1.5 * first + 0.5 * second)
    step = ca.Function(
        "step", [state, control, stiff], [following, ca.jacobian(following, state), ca.jacobian(following, control)]
    )
    present = ca.project(ca.jacobian(derivative, state), sparsity)
    return ca.Function("linearised_step", [state, control], ca.cse([*step(state, control, present)]))
