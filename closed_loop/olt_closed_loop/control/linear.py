"""Linear control: the cost about a predicted drive as a quadratic of the commands, solved with or without limits.

The vehicle is predicted from the present state under guessed commands and linearised along that prediction, so the
model varies over time and is right at any speed. The states are expressed through the commands (condensing), which
leaves a small dense least-squares problem:

- without limits its minimum is that of the finite-horizon LQR, by one factorisation instead of a Riccati recursion;
- with the limits of the commands it is linear MPC, a quadratic program in a box.

Linearised anew at its own solution the latter is Gauss-Newton SQP on the nonlinear problem; one round a call, started
from the last call's commands, is the real-time iteration (Diehl, Bock, Schloeder, SIAM J. Control Optim. 43, 2005).
"""

from collections.abc import Sequence
from functools import lru_cache

import casadi as ca
import numpy as np

from olt_closed_loop.control.box_quadratic import minimise_in_box
from olt_closed_loop.control.cost import ACTUATORS, TrackingCost
from olt_closed_loop.control.prediction import linearised_step, predicted_step
from olt_closed_loop.control.solver import Solution, SolveFailed
from olt_closed_loop.vehicle.buffered import BufferedFunction
from olt_closed_loop.vehicle.models import VehicleParameters
from olt_closed_loop.vehicle.state import CONTROL_SIZE, STATE
from olt_generator.poses import Array

_STEP_LENGTHS = (1.0, 0.5, 0.25, 0.125)
_NEGLIGIBLE = 1e-9
"""A rise of the cost that is taken for rounding; an error of one scale costs 1."""


class LinearSolver:
    """Solves the linearised tracking problem, once or in rounds.

    Args:
        parameters: of the vehicle.
        cost: what to minimise.
        horizon: steps of 0.1 s looked ahead.
        rounds: how often the problem is linearised and solved in a call.
        limited: whether the solution knows the limits of the commands (linear MPC) or is cut at them (LQR).
    """

    def __init__(
        self, parameters: VehicleParameters, cost: TrackingCost, horizon: int, rounds: int, limited: bool
    ) -> None:
        self._horizon, self._rounds, self._limited = horizon, rounds, limited
        self._low, self._high = (np.tile(limit, horizon) for limit in parameters.control_limits)
        predicted, linearised = _horizon_functions(parameters, cost, horizon)
        self._predict, self._linearise = BufferedFunction(predicted), BufferedFunction(linearised)
        self._change_scales = np.array(cost.change_scales)
        changes_by_commands = _difference_matrix(horizon) / np.tile(self._change_scales, horizon)[:, None]
        self._change_hessian = changes_by_commands.T @ changes_by_commands

    def solve(self, start: Array, guesses: Sequence[Array], target: Array) -> Solution:
        """See `control.solver.Solver`."""
        controls = self.cheapest(start, guesses, target)
        for _ in range(self._rounds):
            controls = self._round(start, controls, target)
        return Solution(controls)

    def cheapest(self, start: Array, guesses: Sequence[Array], target: Array) -> Array:
        """The commands (horizon, 2) of the lowest cost."""
        if len(guesses) == 1:
            return guesses[0]
        return min(guesses, key=lambda controls: self.cost(start, controls, target))

    def _round(self, start: Array, controls: Array, target: Array) -> Array:
        """Better commands: those of the linearised problem, or as far towards them as the true cost falls."""
        errors, jacobian = self._linearised_errors(start, controls, target)
        changes = self._command_changes(start, controls)
        cost = float(np.vdot(errors, errors) + np.vdot(changes, changes))
        if not np.isfinite(cost):
            raise SolveFailed("the predicted drive is not finite")
        hessian = jacobian.T @ jacobian + self._change_hessian
        step = self._minimise(hessian, jacobian.T @ errors + self._change_gradient(changes), controls)
        for length in _STEP_LENGTHS:
            moved = controls + length * step
            if self.cost(start, moved, target) <= cost + _NEGLIGIBLE:
                return moved
        return controls

    def _linearised_errors(self, start: Array, controls: Array, target: Array) -> tuple[Array, Array]:
        """Scaled errors (3 n,) of the predicted poses and their derivatives (3 n, 2 n) by the commands."""
        horizon = self._horizon
        _, by_state, by_control, errors, by_pose = self._linearise(start, controls, target)
        sensitivity = _sensitivities(by_state.reshape(horizon, -1, len(start)), by_control.reshape(horizon, -1, 2))
        return errors.ravel(), (by_pose.reshape(horizon, 3, 3) @ sensitivity).reshape(3 * horizon, -1)

    def _command_changes(self, start: Array, controls: Array) -> Array:
        """Scaled changes (n, 2) of the commands."""
        previous = np.concatenate([start[None, ACTUATORS], controls[:-1]])
        return (controls - previous) / self._change_scales

    def _change_gradient(self, changes: Array) -> Array:
        """Half the derivative (2 n,) of the changes' cost by the commands."""
        slopes = changes / self._change_scales
        slopes[:-1] -= slopes[1:].copy()
        return slopes.ravel()

    def cost(self, start: Array, controls: Array, target: Array) -> float:
        """What a drive under the commands (horizon, 2) costs."""
        _, errors = self._predict(start, controls, target)
        changes = self._command_changes(start, controls)
        return float(np.vdot(errors, errors) + np.vdot(changes, changes))

    def _minimise(self, hessian: Array, gradient: Array, controls: Array) -> Array:
        """The step (horizon, 2) to the minimum of the quadratic, within the limits of the commands."""
        low, high = self._low - controls.ravel(), self._high - controls.ravel()
        box = (low, high) if self._limited else (np.full_like(low, -np.inf), np.full_like(high, np.inf))
        return np.clip(minimise_in_box(hessian, gradient, *box), low, high).reshape(controls.shape)


@lru_cache(maxsize=8)
def _horizon_functions(
    parameters: VehicleParameters, cost: TrackingCost, horizon: int
) -> tuple[ca.Function, ca.Function]:
    """(start, controls, targets) -> states and errors, and the same with derivatives; built once in a process.

    Derivatives are transposed, so that CasADi's storage by columns is numpy's by rows.
    """
    predicted, linearised = predicted_step(parameters), linearised_step(parameters)
    state, control = ca.SX.sym("state", predicted.size1_in(0)), ca.SX.sym("control", CONTROL_SIZE)
    target, pose = ca.SX.sym("target", STATE.speed), ca.SX.sym("pose", STATE.speed)
    errors = cost.pose_errors(pose, target)
    judged = ca.Function("judged", [pose, target], [errors, ca.densify(ca.jacobian(errors, pose)).T])
    arguments = [state, control, target]
    following = predicted(state, control)
    plain = [following, judged(following[: STATE.speed], target)[0]]
    following, by_state, by_control = linearised(state, control)
    full = [following, ca.densify(by_state).T, ca.densify(by_control).T, *judged(following[: STATE.speed], target)]
    return (
        ca.Function("stage", arguments, plain).mapaccum("predicted_horizon", horizon),
        ca.Function("stage", arguments, full).mapaccum("linearised_horizon", horizon),
    )


def _difference_matrix(horizon: int) -> Array:
    """(2 n, 2 n): commands in a row -> their changes from step to step, the first against nothing."""
    size = CONTROL_SIZE * horizon
    return np.eye(size) - np.eye(size, k=-CONTROL_SIZE)


def _sensitivities(by_state: Array, by_control: Array) -> Array:
    """Derivatives (n, 3, 2 n) of all predicted poses by all commands, from those (n, s, s), (n, s, 2) of each step."""
    horizon, size = by_state.shape[:2]
    result = np.zeros((horizon, size, CONTROL_SIZE * horizon))
    result[0, :, :CONTROL_SIZE] = by_control[0]
    for index in range(1, horizon):
        np.matmul(by_state[index], result[index - 1], out=result[index])
        result[index, :, CONTROL_SIZE * index : CONTROL_SIZE * (index + 1)] = by_control[index]
    return result[:, : STATE.speed]
