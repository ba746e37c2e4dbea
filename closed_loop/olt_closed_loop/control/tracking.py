"""Tracking of a plan: what to command now so that the vehicle follows the plan over the next second.

One cost (`control.cost`) and one model, the vehicle's own equations with the lags of its actuators,
so a lag is led. Three ways to minimise:

- `lqr`: linearised, the commands cut at their limits in the end (`control.linear`);
- `linear`: linearised, the limits part of the problem: linear MPC, the default;
- `nonlinear`: the nonlinear problem, to convergence (`control.nonlinear`).

Each call starts from the commands of the last or, where those have led away from the plan, from what the plan itself
suggests if that costs less: on slippery roads the cost has minima in which a vehicle would stay astray.

Plans are smoothed first (`control.smoothing`), and driven in the gear that they ask for (`control.gears`): a vehicle
that has to change its direction is brought to a stand where the plan turns, and shifts there.

A solve that fails or is late is counted, and the last feasible commands go on: those of the last solution for the
present time or, before the first solution, those that the plan suggests; past their end the brake is held. What fatrop
gives up and its fallback solves is counted too. The work is done in the rig's own frame, so world coordinates of any
size do not cost precision.

The horizon is the cheapest whose errors leave a margin to 0.05 m root mean square and 0.2 m at most on AlpaSim's
references (`olt bench control`): half a second costs hardly less and errs by a quarter more; two seconds cost half as
much again and gain an eighth. Where a plan stops at once a longer horizon brakes earlier; plans that brake need none.
"""

import math
import time
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from olt_closed_loop.control.box_quadratic import SolveFailed
from olt_closed_loop.control.cost import TrackingCost
from olt_closed_loop.control.gears import asks_for_reverse, first_curvature, until_turn
from olt_closed_loop.control.linear import LinearSolver
from olt_closed_loop.control.nonlinear import NonlinearSolver
from olt_closed_loop.control.plans import WorldPlan
from olt_closed_loop.control.smoothing import DEFAULT_DELAY, DEFAULT_WINDOW, PlanSmoother
from olt_closed_loop.vehicle.parameters import VehicleParameters, on_the_brake
from olt_closed_loop.vehicle.state import STATE, steering_for
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.policy.contract import STEP_SECONDS, STEP_US

ControlMethod = Literal["lqr", "linear", "nonlinear"]

STANDING_DISTANCE, STANDING_SPEED = 0.1, 0.3
"""A plan that stays within this many metres of a vehicle over the horizon, the vehicle being slower than this many m/s,
is a plan to stand."""
ASTRAY_DISTANCE = 0.3
"""A vehicle farther than this many metres from its plan has left it."""
HOLDING_BRAKE = 2.0
"""Deceleration with which a vehicle is held at the end, m/s^2."""


@dataclass(frozen=True)
class ControlSettings:
    """How a plan is tracked.

    Attributes:
        method: how the cost is minimised; see the module.
        horizon: steps of 0.1 s that are looked ahead; see the module.
        rounds: how often `lqr` and `linear` linearise and solve in a call.
        cost: what is minimised.
        deadline_seconds: a solve that takes longer is late. None: never late, and equal drives stay equal.
        smoothing_window: of each plan in itself, seconds; 0 for none. It delays nothing.
        smoothing_delay: time constant of the mean over successive plans, seconds; 0 for none.
    """

    method: ControlMethod = "linear"
    horizon: int = 10
    rounds: int = 1
    cost: TrackingCost = field(default_factory=TrackingCost)
    deadline_seconds: float | None = None
    smoothing_window: float = DEFAULT_WINDOW
    smoothing_delay: float = DEFAULT_DELAY

    def __post_init__(self) -> None:
        if not (0.0 <= self.smoothing_window < np.inf and 0.0 <= self.smoothing_delay < np.inf):
            raise InputError(
                f"smoothing of plans over {self.smoothing_window} s with a delay of {self.smoothing_delay} s: "
                "give two numbers of seconds, 0 for none"
            )


@dataclass
class SolveCounts:
    """How the calls of a controller went so far.

    A plan that no car can follow shows in the deviations: how far the vehicle will be from the plan, as it was given,
    while it is driven as well as the controller can over the horizon.

    Attributes:
        solves: calls that looked for commands; the others held a standing vehicle.
        failed: solves without a solution. The last feasible commands were held.
        late: solves after the deadline. The last feasible commands were held; the solution serves from the next call.
        given_up: solves that fatrop gave up. Where its fallback found commands they were given; elsewhere the solve
            also counts as failed.
        shifts: changes of gear.
        deviation_max: largest distance of the foreseen positions from the plan so far, metres.
        deviation_squares: sum over the calls of the mean square of that distance, m^2.
        calls: how many that sum has.
    """

    solves: int = 0
    failed: int = 0
    late: int = 0
    given_up: int = 0
    shifts: int = 0
    deviation_max: float = 0.0
    deviation_squares: float = 0.0
    calls: int = 0

    @property
    def deviation_rms(self) -> float:
        """Root mean square of the foreseen distances from the plan, metres; NaN before the first call."""
        return math.sqrt(self.deviation_squares / self.calls) if self.calls else math.nan

    def add_deviation(self, squares: Array) -> None:
        """Count a call whose foreseen positions are so far from the plan: squared distances (horizon,) in m^2."""
        self.deviation_max = max(self.deviation_max, math.sqrt(squares.max()))
        self.deviation_squares += float(squares.mean())
        self.calls += 1


class TrackingController:
    """Follows plans with one vehicle through one drive; a new drive takes a new controller.

    Attributes:
        counts: how the calls went so far.
        parameters: of the vehicle in the gear that the last command is for.
    """

    def __init__(self, parameters: VehicleParameters, settings: ControlSettings | None = None) -> None:
        self.parameters, self.counts = parameters, SolveCounts()
        self._settings = settings or ControlSettings()
        self._smooth = PlanSmoother(self._settings.smoothing_window, self._settings.smoothing_delay)
        self._solvers: dict[VehicleParameters, LinearSolver | NonlinearSolver] = {}
        self._feasible: _TimedCommands | None = None

    def control(self, state: Array, plan: WorldPlan, time_us: int) -> Array:
        """The control (2,) to hold from `time_us` for 0.1 s, in the vehicle's limits.

        Where `parameters.reverse_gear` differs from the call before the vehicle is to shift first
        (`vehicle.integrators.VehicleStepper.shift`).

        Args:
            state: (states,) of the vehicle at `time_us`.
            plan: what to follow; past its end it stands.
            time_us: now; never before that of the last call.

        Raises:
            InputError: the state is not finite.
        """
        if not np.isfinite(state).all():
            raise InputError(f"vehicle state at {time_us} us is not finite; nothing can be tracked from there")
        horizon_us = time_us + STEP_US * np.arange(self._settings.horizon + 1, dtype=np.int64)
        given, target = (_in_rig(each.at(horizon_us), state) for each in (plan, self._smooth(plan)))
        slow = abs(state[STATE.speed]) < STANDING_SPEED
        if slow and asks_for_reverse(target, self.parameters.reverse_gear) != self.parameters.reverse_gear:
            self._shift()
            state = on_the_brake(state, self.parameters)
        target = until_turn(target, self.parameters.reverse_gear)
        if slow and np.abs(target[:, : STATE.yaw]).max() < STANDING_DISTANCE:
            self._feasible = None
            self.counts.add_deviation(np.square(given[1:, : STATE.yaw]).sum(axis=1))
            return np.array([self._steering_at_rest(state, plan, time_us), self._brake])
        astray = np.hypot(*target[0, : STATE.yaw]) > ASTRAY_DISTANCE
        feasible, guesses = self._feasible, []
        if feasible is not None:
            guesses.append(feasible.guess(time_us))
        # Held brakes have no slope from which to find out that releasing them would help.
        if feasible is None or slow or astray:
            guesses.append(self._suggested_commands(target, state[STATE.speed]))
        start = np.concatenate([np.zeros(STATE.speed), state[STATE.speed :]])
        feasible = feasible or _TimedCommands(time_us, guesses[0])
        control, self._feasible = self._solve(start, guesses, target[1:], feasible, time_us)
        foreseen = self._solver.foresee(start, self._feasible.guess(time_us))
        self.counts.add_deviation(np.square(foreseen - given[1:])[:, : STATE.yaw].sum(axis=1))
        return control

    def _steering_at_rest(self, state: Array, plan: WorldPlan, time_us: int) -> float:
        """Where the wheel of a standing vehicle goes: where the plan will need it, as turning it takes a while."""
        curvature = first_curvature(plan.poses[plan.timestamps_us >= time_us])
        if curvature is None:
            return float(state[STATE.steering])
        return float(np.clip(np.arctan(self.parameters.wheelbase * curvature), *self.parameters.control_limits[:, 0]))

    @property
    def _brake(self) -> float:
        """The acceleration that holds a standing vehicle, m/s^2."""
        return HOLDING_BRAKE * (1.0 if self.parameters.reverse_gear else -1.0)

    @property
    def _solver(self) -> LinearSolver | NonlinearSolver:
        """The solver for the present gear."""
        settings = self._settings
        if self.parameters not in self._solvers:
            if settings.method == "nonlinear":
                solver = NonlinearSolver(self.parameters, settings.cost, settings.horizon)
            else:
                limited = settings.method == "linear"
                solver = LinearSolver(self.parameters, settings.cost, settings.horizon, settings.rounds, limited)
            self._solvers[self.parameters] = solver
        return self._solvers[self.parameters]

    def _shift(self) -> None:
        self.parameters = replace(self.parameters, reverse_gear=not self.parameters.reverse_gear)
        self._feasible = None
        self.counts.shifts += 1

    def _solve(
        self, start: Array, guesses: list[Array], target: Array, feasible: "_TimedCommands", time_us: int
    ) -> tuple[Array, "_TimedCommands"]:
        """The first command of a new solution or, where that fails or is late, the present one of the feasible.

        And what is feasible from now on.
        """
        held, began = feasible.at(time_us, self._brake), time.perf_counter()
        self.counts.solves += 1
        try:
            commands = self._solver.solve(start, guesses, target)
        except SolveFailed:
            self.counts.failed += 1
            return held, feasible
        finally:
            self.counts.given_up = sum(solver.given_up for solver in self._solvers.values())
        deadline = self._settings.deadline_seconds
        late = deadline is not None and time.perf_counter() - began > deadline
        self.counts.late += late
        return held if late else commands[0], _TimedCommands(time_us, commands)

    def _suggested_commands(self, target: Array, present_speed: float) -> Array:
        """Commands (horizon, 2) to start from: the plan's steering, and the even acceleration that covers its way."""
        moved = np.diff(target, axis=0)
        heading = target[:-1, 2] + 0.5 * moved[:, 2]
        speed = (moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading)) / STEP_SECONDS
        steering = steering_for(moved[:, 2] / STEP_SECONDS, speed, self.parameters.wheelbase)
        duration = len(moved) * STEP_SECONDS
        way = target[0, 0] + speed.mean() * duration
        acceleration = np.full_like(steering, 2.0 * (way - present_speed * duration) / duration**2)
        return np.clip(np.stack([steering, acceleration], axis=-1), *self.parameters.control_limits)


@dataclass(frozen=True)
class _TimedCommands:
    """Feasible commands (horizon, 2) for the steps from `time_us` on."""

    time_us: int
    commands: Array

    def at(self, time_us: int, brake: float) -> Array:
        """The command for that time; past the end the steering stays and the brake is held."""
        index = (time_us - self.time_us) // STEP_US
        return self.commands[index] if index < len(self.commands) else np.array([self.commands[-1, 0], brake])

    def guess(self, time_us: int) -> Array:
        """Commands (horizon, 2) for the steps from that time on, the last one repeated."""
        if time_us == self.time_us:
            return self.commands
        last = len(self.commands) - 1
        index = (time_us - self.time_us) // STEP_US + np.arange(last + 1)
        return self.commands[np.minimum(index, last)]


def _in_rig(poses: Array, state: Array) -> Array:
    """World poses (n, 3) in the frame of the vehicle's rig; the first yaw is within half a turn."""
    offset = poses[:, :2] - state[: STATE.yaw]
    cos, sin = np.cos(state[STATE.yaw]), np.sin(state[STATE.yaw])
    yaw = poses[:, 2] - state[STATE.yaw]
    yaw = yaw - 2.0 * np.pi * np.round(yaw[0] / (2.0 * np.pi))
    return np.stack([cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0], yaw], axis=-1)
