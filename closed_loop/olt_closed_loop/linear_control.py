"""Linear control: the cost about a predicted drive as a quadratic of the commands, solved with or without limits.

The vehicle is predicted from the present state under guessed commands and linearised along that prediction, so the
model varies over time and is right at any speed. The states are expressed through the commands (condensing), which
leaves a small dense least-squares problem:

- without limits its minimum is that of the finite-horizon LQR, by one factorisation instead of a Riccati recursion;
- with the limits of the commands it is linear MPC, a quadratic program in a box.

Linearised anew at its own solution the latter is Gauss-Newton SQP on the nonlinear problem; one round a call, started
from the last call's commands, is the real-time iteration (Diehl, Bock, Schloeder, SIAM J. Control Optim. 43, 2005).
"""

from functools import lru_cache

import casadi as ca
import numpy as np

from olt_closed_loop.box_quadratic import minimise_in_box
from olt_closed_loop.buffered import BufferedFunction
from olt_closed_loop.prediction import predicted_step
from olt_closed_loop.solver import SolveFailed
from olt_closed_loop.tracking_cost import ACTUATORS, TrackingCost
from olt_closed_loop.vehicle import CONTROL_SIZE, STATE, VehicleParameters
from olt_generator.poses import Array

_STEP_LENGTHS = (1.0, 0.5, 0.25, 0.125)


class LinearSolver:
    """Solves the linearised tracking problem, once or in rounds.

    Args:
        parameters: of the vehicle.
        cost: what to minimise.
        horizon, substeps: steps of 0.1 s looked ahead, and parts into which the prediction divides each.
        rounds: how often the problem is linearised and solved in a call.
        limited: whether the solution knows the limits of the commands (linear MPC) or is cut at them (LQR).
    """

    def __init__(
        self, parameters: VehicleParameters, cost: TrackingCost, horizon: int, substeps: int, rounds: int, limited: bool
    ) -> None:
        self._horizon, self._rounds, self._limited = horizon, rounds, limited
        self._low, self._high = (np.tile(limit, horizon) for limit in parameters.control_limits)
        linearised, total_cost = _horizon_functions(parameters, cost, horizon, substeps)
        self._predict, self._cost = BufferedFunction(linearised), BufferedFunction(total_cost)
        self._changes, self._change_of_start = _change_matrices(cost, horizon)
        self._change_hessian = self._changes.T @ self._changes

    def solve(self, start: Array, controls: Array, target: Array) -> Array:
        """See `olt_closed_loop.solver.Solver`."""
        for _ in range(self._rounds):
            hessian, gradient = self._quadratic(start, controls, target)
            step = self._solve_quadratic(hessian, gradient, controls)
            controls = self._improved(start, controls, step, target)
        return controls

    def _quadratic(self, start: Array, controls: Array, target: Array) -> tuple[Array, Array]:
        """Half the Gauss-Newton Hessian (2 n, 2 n) and gradient (2 n,) of the cost by the commands."""
        _, by_state, by_control, errors, by_pose = self._predict(start, controls, target)
        sensitivity = _sensitivities(_per_stage(by_state, self._horizon), _per_stage(by_control, self._horizon))
        jacobian = (_per_stage(by_pose, self._horizon) @ sensitivity).reshape(3 * self._horizon, -1)
        changes = self._changes @ controls.ravel() - self._change_of_start @ start[ACTUATORS]
        hessian: Array = jacobian.T @ jacobian + self._change_hessian
        gradient: Array = jacobian.T @ errors.ravel() + self._changes.T @ changes
        return hessian, gradient

    def _solve_quadratic(self, hessian: Array, gradient: Array, controls: Array) -> Array:
        low, high = self._low - controls.ravel(), self._high - controls.ravel()
        box = (low, high) if self._limited else (np.full_like(low, -np.inf), np.full_like(high, np.inf))
        return np.clip(minimise_in_box(hessian, gradient, *box), low, high).reshape(controls.shape)

    def _improved(self, start: Array, controls: Array, step: Array, target: Array) -> Array:
        """The commands moved along the step as far as the true cost falls; unmoved where it does not."""
        (before,) = self._cost(start, controls, target)
        if not np.isfinite(before):
            raise SolveFailed("the predicted drive is not finite")
        for length in _STEP_LENGTHS:
            moved = controls + length * step
            (after,) = self._cost(start, moved, target)
            if after < before:
                return moved
        return controls


@lru_cache(maxsize=8)
def _horizon_functions(
    parameters: VehicleParameters, cost: TrackingCost, horizon: int, substeps: int
) -> tuple[ca.Function, ca.Function]:
    """The linearised horizon and the cost of it, built once in a process."""
    step = predicted_step(parameters, substeps)
    return _linearised_stage(step, cost).mapaccum("horizon", horizon), _total_cost(step, cost, horizon)


def _linearised_stage(step: ca.Function, cost: TrackingCost) -> ca.Function:
    """(state, control, target) -> next state, its derivatives, the errors there and their derivative by the pose."""
    state, control, target = ca.SX.sym("state", step.size1_in(0)), ca.SX.sym("control", 2), ca.SX.sym("target", 3)
    following = step(state, control)
    reached = ca.SX.sym("reached", step.size1_in(0))
    errors = cost.pose_errors(reached, target)
    by_pose = ca.substitute(ca.jacobian(errors, reached)[:, : STATE.speed], reached, following)
    outputs = [
        following,
        ca.densify(ca.jacobian(following, state)),
        ca.densify(ca.jacobian(following, control)),
        ca.substitute(errors, reached, following),
        ca.densify(by_pose),
    ]
    return ca.Function("stage", [state, control, target], ca.cse(outputs))


def _total_cost(step: ca.Function, cost: TrackingCost, horizon: int) -> ca.Function:
    """(state, controls, targets) -> the cost."""
    state, control, target = ca.SX.sym("state", step.size1_in(0)), ca.SX.sym("control", 2), ca.SX.sym("target", 3)
    following = step(state, control)
    stage = ca.Function("stage", [state, control, target], [following, ca.sumsqr(cost.pose_errors(following, target))])
    start = ca.MX.sym("start", step.size1_in(0))
    controls, targets = ca.MX.sym("controls", CONTROL_SIZE, horizon), ca.MX.sym("targets", 3, horizon)
    _, errors = stage.mapaccum("horizon", horizon)(start, controls, targets)
    previous = ca.horzcat(start[ACTUATORS], controls[:, :-1])
    changes = _changes_function(cost).map(horizon)(controls, previous)
    return ca.Function("cost", [start, controls, targets], [ca.sum2(errors) + ca.sumsqr(changes)])


def _changes_function(cost: TrackingCost) -> ca.Function:
    control, previous = ca.SX.sym("control", CONTROL_SIZE), ca.SX.sym("previous", CONTROL_SIZE)
    return ca.Function("changes", [control, previous], [cost.command_changes(control, previous)])


def _change_matrices(cost: TrackingCost, horizon: int) -> tuple[Array, Array]:
    """(2 n, 2 n) from commands in a row, and (2 n, 2) from the actuators, to the scaled changes (their difference)."""
    scale = np.tile(1.0 / np.array([cost.steering_change, cost.acceleration_change]), horizon)[:, None]
    size = CONTROL_SIZE * horizon
    return scale * (np.eye(size) - np.eye(size, k=-CONTROL_SIZE)), scale * np.eye(size, CONTROL_SIZE)


def _per_stage(stacked: Array, horizon: int) -> Array:
    """(n, rows, columns) of matrices that CasADi laid side by side."""
    return stacked.reshape(horizon, -1, stacked.shape[-1]).swapaxes(1, 2)


def _sensitivities(by_state: Array, by_control: Array) -> Array:
    """Derivatives (n, 3, 2 n) of all predicted poses by all commands, from those of each step."""
    horizon, size = by_state.shape[:2]
    result = np.zeros((horizon, STATE.speed, CONTROL_SIZE * horizon))
    current = np.zeros((size, CONTROL_SIZE * horizon))
    for index in range(horizon):
        current = by_state[index] @ current
        current[:, CONTROL_SIZE * index : CONTROL_SIZE * (index + 1)] = by_control[index]
        result[index] = current[: STATE.speed]
    return result
