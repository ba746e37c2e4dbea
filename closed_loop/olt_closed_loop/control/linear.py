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

from olt_closed_loop.control.box_quadratic import SolveFailed, minimise_in_box
from olt_closed_loop.control.cost import ACTUATORS, TrackingCost
from olt_closed_loop.control.prediction import linearised_step, predicted_step
from olt_closed_loop.vehicle.buffered import BufferedFunction
from olt_closed_loop.vehicle.parameters import VehicleParameters
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

    given_up = 0
    """As of `control.nonlinear.NonlinearSolver`."""

    def __init__(
        self, parameters: VehicleParameters, cost: TrackingCost, horizon: int, rounds: int, limited: bool
    ) -> None:
        self._horizon, self._rounds, self._limited = horizon, rounds, limited
        self._limits = parameters.control_limits
        self._low, self._high = (np.tile(limit, horizon) for limit in self._limits)
        predicted, linearised = _horizon_functions(parameters, cost, horizon)
        self._predict, self._linearise = BufferedFunction(predicted), BufferedFunction(linearised)
        # The commands that a drive was last predicted under, and the states that it came to.
        self._foreseen: tuple[Array, Array] = np.zeros(0), np.zeros(0)
        self._change_scales = np.array(cost.change_scales)
        size = CONTROL_SIZE * horizon
        # Commands in a row -> their changes from step to step, the first against nothing.
        differences = np.eye(size) - np.eye(size, k=-CONTROL_SIZE)
        changes_by_commands = differences / np.tile(self._change_scales, horizon)[:, None]
        self._change_hessian = changes_by_commands.T @ changes_by_commands

    def solve(self, start: Array, guesses: Sequence[Array], target: Array) -> Array:
        """The commands (horizon, 2), within the vehicle's limits, that a vehicle at `start` should be given.

        Args:
            start: (states,) of the vehicle in its own rig frame.
            guesses: commands (horizon, 2) within the limits; the solver starts from those of the lowest cost.
            target: (horizon, 3) poses x, y (m) and yaw (rad) at the ends of the steps, in the same frame.

        Raises:
            SolveFailed: there is no solution, or not within the solver's iterations.
        """
        controls = self.cheapest(start, guesses, target)
        for _ in range(self._rounds):
            controls = self._improve(start, controls, target)
        return controls

    def cheapest(self, start: Array, guesses: Sequence[Array], target: Array) -> Array:
        """The commands (horizon, 2) of the lowest cost; the other arguments as of `solve`."""
        if len(guesses) == 1:
            return guesses[0]
        return min(guesses, key=lambda controls: self.cost(start, controls, target))

    def foresee(self, start: Array, controls: Array) -> Array:
        """Poses (horizon, 3) of a drive under the commands (horizon, 2), in the frame of `start`."""
        controls_before, reached = self._foreseen
        if controls is not controls_before:
            reached, _ = self._predict(start, controls, np.zeros((self._horizon, STATE.speed)))
        return reached[:, : STATE.speed]

    def cost(self, start: Array, controls: Array, target: Array) -> float:
        """What a drive under the commands (horizon, 2) costs; the other arguments as of `solve`."""
        reached, errors = self._predict(start, controls, target)
        self._foreseen = controls, reached
        changes = self._command_changes(start, controls)
        return float(np.vdot(errors, errors) + np.vdot(changes, changes))

    def _improve(self, start: Array, controls: Array, target: Array) -> Array:
        """Better commands: those of the linearised problem, or as far towards them as the true cost falls."""
        errors, jacobian = self._linearised_errors(start, controls, target)
        changes = self._command_changes(start, controls)
        cost = float(np.vdot(errors, errors) + np.vdot(changes, changes))
        if not np.isfinite(cost):
            raise SolveFailed("the predicted drive is not finite")
        # Half the derivative of the changes' cost by the commands.
        slopes = changes / self._change_scales
        slopes[:-1] -= slopes[1:].copy()
        hessian, gradient = jacobian.T @ jacobian + self._change_hessian, jacobian.T @ errors + slopes.ravel()
        low, high = self._low - controls.ravel(), self._high - controls.ravel()
        box = (low, high) if self._limited else (np.full_like(low, -np.inf), np.full_like(high, np.inf))
        step = np.clip(minimise_in_box(hessian, gradient, *box), low, high).reshape(controls.shape)
        for length in _STEP_LENGTHS:
            moved = np.clip(controls + length * step, *self._limits)
            if self.cost(start, moved, target) <= cost + _NEGLIGIBLE:
                return moved
        return controls

    def _linearised_errors(self, start: Array, controls: Array, target: Array) -> tuple[Array, Array]:
        """Scaled errors (3 n,) of the predicted poses and their derivatives (3 n, 2 n) by the commands."""
        horizon, size = self._horizon, len(start)
        _, by_state, by_control, errors, by_pose = self._linearise(start, controls, target)
        by_state, by_control = by_state.reshape(horizon, size, size), by_control.reshape(horizon, size, CONTROL_SIZE)
        by_commands = np.zeros((horizon, size, CONTROL_SIZE * horizon))
        by_commands[0, :, :CONTROL_SIZE] = by_control[0]
        for index in range(1, horizon):
            np.matmul(by_state[index], by_commands[index - 1], out=by_commands[index])
            by_commands[index, :, CONTROL_SIZE * index : CONTROL_SIZE * (index + 1)] = by_control[index]
        jacobian = by_pose.reshape(horizon, 3, 3) @ by_commands[:, : STATE.speed]
        return errors.ravel(), jacobian.reshape(3 * horizon, -1)

    def _command_changes(self, start: Array, controls: Array) -> Array:
        """Scaled changes (n, 2) of the commands."""
        previous = np.concatenate([start[None, ACTUATORS], controls[:-1]])
        return (controls - previous) / self._change_scales


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
        ca.Function("step", arguments, plain).mapaccum("predicted_horizon", horizon),
        ca.Function("step", arguments, full).mapaccum("linearised_horizon", horizon),
    )
