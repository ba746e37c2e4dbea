"""Nonlinear MPC: the tracking problem as it is, solved to convergence by the interior-point method fatrop.

Multiple shooting: the states at all steps are unknowns beside the commands, tied together by the prediction. fatrop
(Vanroye, Sathya, De Schutter, Decre, IROS 2023) solves the linear systems by a Riccati recursion over the steps, which
CasADi finds when unknowns and constraints are ordered by step. The cost knows changes of commands, so the command
before is carried along as part of the state.

Its exact second derivatives do not settle where the equations have a kink, as brakes have at standstill. What fatrop
gives up is solved in Gauss-Newton rounds (`control.linear`), the same cost from the same guess.
"""

from collections.abc import Sequence
from functools import lru_cache

import casadi as ca
import numpy as np

from olt_closed_loop.control.box_quadratic import SolveFailed
from olt_closed_loop.control.cost import ACTUATORS, TrackingCost
from olt_closed_loop.control.linear import LinearSolver
from olt_closed_loop.control.prediction import predicted_step
from olt_closed_loop.vehicle.buffered import BufferedFunction
from olt_closed_loop.vehicle.parameters import VehicleParameters
from olt_closed_loop.vehicle.state import CONTROL_SIZE, STATE
from olt_generator.poses import Array

_MAX_ITERATIONS = 15
_TOLERANCE = 1e-6
_ROUNDS = 4


class NonlinearSolver:
    """Solves the nonlinear tracking problem; arguments as of `control.linear.LinearSolver`.

    Attributes:
        given_up: solves that fatrop gave up, whether or not the fallback found commands.
    """

    def __init__(self, parameters: VehicleParameters, cost: TrackingCost, horizon: int) -> None:
        step = predicted_step(parameters)
        self.given_up = 0
        self._horizon, self._state_size = horizon, step.size1_in(0)
        self._predict = BufferedFunction(step.mapaccum("horizon", horizon))
        self._program = _program(parameters, cost, horizon)
        self._gauss_newton = LinearSolver(parameters, cost, horizon, rounds=_ROUNDS, limited=True)
        # Of the constraints in their order: ties to the next step, in the first step to the start, and limits.
        ties = np.zeros(self._state_size + CONTROL_SIZE)
        self._low, self._high = (
            np.concatenate([ties, ties, limit, *[np.concatenate([ties, limit])] * (horizon - 1)])
            for limit in parameters.control_limits
        )

    def foresee(self, start: Array, controls: Array) -> Array:
        """As of `control.linear.LinearSolver`."""
        return self._gauss_newton.foresee(start, controls)

    def solve(self, start: Array, guesses: Sequence[Array], target: Array) -> Array:
        """The commands (horizon, 2); arguments and errors as of `control.linear.LinearSolver`."""
        controls = self._gauss_newton.cheapest(start, guesses, target)
        if not np.isfinite(self._gauss_newton.cost(start, controls, target)):
            raise SolveFailed("the predicted drive is not finite")
        # All unknowns in their order: the state, the command before and the command of each step, and the end.
        (reached,) = self._predict(start, controls)
        states = np.concatenate([start[None], reached])
        before = np.concatenate([start[None, ACTUATORS], controls])
        guess = np.concatenate([states[:-1], before[:-1], controls], axis=1)
        solution = self._program(
            x0=np.concatenate([guess.ravel(), states[-1], before[-1]]),
            p=np.concatenate([start, target.ravel()]),
            lbg=self._low,
            ubg=self._high,
        )
        if self._program.stats()["success"]:
            unknowns = np.asarray(solution["x"]).ravel()[: -self._state_size - CONTROL_SIZE]
            return unknowns.reshape(self._horizon, -1)[:, -CONTROL_SIZE:]
        self.given_up += 1
        try:
            return self._gauss_newton.solve(start, [controls], target)
        except SolveFailed as failure:
            raise SolveFailed(f"fatrop gave up, and so did Gauss-Newton: {failure}") from failure


@lru_cache(maxsize=8)
def _program(parameters: VehicleParameters, cost: TrackingCost, horizon: int) -> ca.Function:
    """The nonlinear program of (start, targets), unknowns and constraints in the order of the steps."""
    step = predicted_step(parameters)
    size = step.size1_in(0)
    start, targets = ca.SX.sym("start", size), ca.SX.sym("targets", 3, horizon)
    states = [ca.SX.sym(f"state_{index}", size + CONTROL_SIZE) for index in range(horizon + 1)]
    controls = [ca.SX.sym(f"control_{index}", CONTROL_SIZE) for index in range(horizon)]
    unknowns, constraints, equalities, total = [], [], [], ca.SX(0)
    for index, (state, control, following) in enumerate(zip(states, controls, states[1:], strict=False)):
        ties = [following - ca.vertcat(step(state[:size], control), control)]
        if index == 0:
            ties.append(state - ca.vertcat(start, start[ACTUATORS]))
        unknowns += [state, control]
        constraints += [*ties, control]
        equalities += [True] * len(ties) * (size + CONTROL_SIZE) + [False] * CONTROL_SIZE
        total += ca.sumsqr((control - state[size:]) / ca.DM(cost.change_scales))
        total += ca.sumsqr(cost.pose_errors(following[: STATE.speed], targets[:, index]))
    problem = {
        "x": ca.vertcat(*unknowns, states[-1]),
        "p": ca.vertcat(start, ca.vec(targets)),
        "f": total,
        "g": ca.vertcat(*constraints),
    }
    options = {
        "structure_detection": "auto",
        "equality": equalities,
        "print_time": False,
        "show_eval_warnings": False,
        "fatrop.print_level": 0,
        "fatrop.max_iter": _MAX_ITERATIONS,
        "fatrop.tol": _TOLERANCE,
    }
    return ca.nlpsol("tracking", "fatrop", problem, options)
