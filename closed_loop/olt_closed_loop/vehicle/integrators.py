"""One-step maps of the vehicle over a step in which the control is held: methods side by side, and `auto`.

`midpoint` and `rk4` take explicit sub-steps (`vehicle.substeps`): as many as are given, else as many as the
stiffness of the moment asks for. `radau` and `cvodes` are implicit (`vehicle.implicit`). `auto` takes at every
step the cheapest model and method that stay within the tolerance (`vehicle.integration_plan`) and counts what
it took and what it left out. `olt bench vehicle` holds the error of each against its run time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import casadi as ca
import numpy as np

from olt_closed_loop.vehicle.buffered import BufferedFunction
from olt_closed_loop.vehicle.compiled import MOST_SUBSTEPS, Drive, StepProgram, check_finite, make_drive
from olt_closed_loop.vehicle.implicit import cvodes_function, radau_function
from olt_closed_loop.vehicle.integration_plan import automatic_plan, candidates, fixed_plan, stiffness_plan
from olt_closed_loop.vehicle.models import Model, VehicleNumbers, VehicleParameters, model_state_size
from olt_closed_loop.vehicle.state import CONTROL_SIZE, STATE
from olt_closed_loop.vehicle.substeps import ExplicitMethod, explicit_substep, substep_function
from olt_generator.errors import InputError
from olt_generator.omissions import Omission
from olt_generator.poses import Array

Method = Literal["auto", "midpoint", "rk4", "radau", "cvodes"]
DEFAULT_METHOD: Method = "auto"
DEFAULT_SUBSTEPS: int | None = None
DEFAULT_TOLERANCE = 3e-7
"""Metres of position error in 0.1 s: two seconds of the hardest manoeuvres of `olt bench vehicle` stay below 1e-6 m."""
RADAU_ELEMENTS = 8

Stepper = Callable[[Array, Array], Array]
"""Maps state (s,) and control (2,) to the state (s,) one step later; batched ones take a leading axis."""


def make_stepper(
    parameters: VehicleParameters,
    method: Method = DEFAULT_METHOD,
    substeps: int | None = DEFAULT_SUBSTEPS,
    step: float = 0.1,
    tolerance: float = DEFAULT_TOLERANCE,
) -> "VehicleStepper":
    """The map over `step` seconds for one vehicle.

    Args:
        parameters: the vehicle; its model sets the size s of the state.
        method: how to integrate.
        substeps: of `midpoint` and `rk4`, elements of `radau`; None for what the moment asks for (`radau`: 8).
        step: seconds.
        tolerance: metres of position error in 0.1 s that `auto`, and sub-steps that are not given, stay within.

    Raises:
        InputError: an unknown method, or a number that makes no sense.
    """
    return VehicleStepper([parameters], method, substeps, step, tolerance, batched=False)


def make_batch_stepper(
    parameters: VehicleParameters | list[VehicleParameters],
    count: int,
    method: Method = DEFAULT_METHOD,
    substeps: int | None = DEFAULT_SUBSTEPS,
    step: float = 0.1,
    tolerance: float = DEFAULT_TOLERANCE,
) -> "VehicleStepper":
    """The same map for `count` vehicles at once: states (count, s), controls (count, 2).

    The vehicles may differ in every number, but have one model. Each moves as it would alone.
    """
    vehicles = parameters if isinstance(parameters, list) else [parameters] * count
    return VehicleStepper(vehicles, method, substeps, step, tolerance, batched=True)


class VehicleStepper:
    """The one-step map of a batch of vehicles, which counts what it took. Not for several threads at once."""

    def __init__(
        self,
        vehicles: list[VehicleParameters],
        method: Method,
        substeps: int | None,
        step: float,
        tolerance: float,
        batched: bool,
    ) -> None:
        _check_settings(vehicles, method, substeps, step, tolerance)
        self._model: Model = vehicles[0].model
        self._numbers = np.stack([vehicle.numbers for vehicle in vehicles])
        self._step, self._tolerance, self._batched = step, tolerance, batched
        self._ways = _ways(self._model, method)
        self._drive: Drive
        if method == "radau" or method == "cvodes":
            self._drive = _ImplicitDrive(_implicit_function(self._model, method, substeps), self._numbers, step)
        else:
            self._drive = make_drive(
                _program(self._model, method, substeps, tolerance * step / 0.1), self._numbers, step
            )

    def __call__(self, state: Array, control: Array) -> Array:
        """The state(s) one step later.

        Raises:
            InputError: a state or control is not finite, or the equations cannot be solved from there.
        """
        unmoved = self._drive.taken[-1, 0]
        ends = self._drive(state, control)
        if self._drive.taken[-1, 0] > unmoved:
            self._move_implicitly(np.atleast_2d(state), np.atleast_2d(control), ends)
        return ends.copy() if self._batched else ends[0].copy()

    def _move_implicitly(self, states: Array, controls: Array, ends: Array) -> None:
        rows = np.flatnonzero(self._drive.plans[:, 0] == len(self._ways) - 1)
        implicit = _ImplicitDrive(cvodes_function(self._model), self._numbers[rows], self._step)
        ends[rows] = implicit(states[rows], controls[rows])

    def report(self) -> "IntegrationReport":
        """What was taken since the stepper was made."""
        steps, substeps = self._drive.taken[:, 0].astype(int), self._drive.taken[:, 1]
        rows = [
            (way, int(steps[row]), float(substeps[row] / steps[row]))
            for row, way in enumerate(self._ways)
            if steps[row]
        ]
        total = int(steps.sum())
        left_out = []
        for simpler, what in (("kinematic", "steps of tyre slip"), ("linear", "steps of tyre saturation")):
            count = sum(count for way, count, _ in rows if way.startswith(f"{simpler} "))
            if count and simpler != self._model:
                left_out.append(Omission(what, f"below {self._tolerance:g} m in 0.1 s", count, total))
        return IntegrationReport(
            steps=total,
            taken={way: count for way, count, _ in rows},
            substeps={way: mean for way, _, mean in rows},
            left_out=tuple(left_out),
        )


@dataclass(frozen=True)
class IntegrationReport:
    """What a stepper took.

    Attributes:
        steps: how many steps were made, over all vehicles.
        taken: steps by model and method, such as "kinematic midpoint".
        substeps: mean number of sub-steps of these steps.
        left_out: what was not computed, and why.
    """

    steps: int
    taken: dict[str, int]
    substeps: dict[str, float]
    left_out: tuple[Omission, ...]


class _ImplicitDrive:
    """Steps one vehicle after the other with an implicit function."""

    def __init__(self, function: ca.Function, numbers: Array, step: float) -> None:
        self._function, self._numbers, self._step = BufferedFunction(function), numbers, step
        self._ends = np.zeros((len(numbers), function.size1_in(0)))
        self.plans, self.taken = np.zeros((len(numbers), 3)), np.zeros((2, 2))

    def __call__(self, states: Array, controls: Array) -> Array:
        states, controls = np.atleast_2d(states, controls)
        check_finite(states, controls)
        for index, (state, control) in enumerate(zip(states, controls, strict=True)):
            self._ends[index] = self._advance(state, control, self._numbers[index])
        self.taken[0, 0] += len(states)
        return self._ends

    def _advance(self, state: Array, control: Array, numbers: Array) -> Array:
        local = np.concatenate([[0.0, 0.0], state[STATE.yaw :]])
        try:
            (end,) = self._function(local, control, numbers, self._step)
        except RuntimeError as error:
            raise InputError(
                f"{self._function.name}: no solution from state {state.tolist()} under control {control.tolist()} over "
                f"{self._step:g} s; take a shorter step, more elements, or the method auto"
            ) from error
        end[: STATE.yaw] += state[: STATE.yaw]
        return end


def _check_settings(
    vehicles: list[VehicleParameters], method: Method, substeps: int | None, step: float, tolerance: float
) -> None:
    if method not in get_args(Method):
        raise InputError(f"no integrator {method!r}; there are {', '.join(get_args(Method))}")
    if not (0.0 < step < np.inf and 0.0 < tolerance < np.inf):
        raise InputError(f"step of {step} s within {tolerance} m: both must be positive numbers")
    if substeps is not None and not 1 <= substeps <= MOST_SUBSTEPS:
        raise InputError(f"{substeps} sub-steps: give 1 to {MOST_SUBSTEPS}, or none for what the moment asks for")
    models = {vehicle.model for vehicle in vehicles}
    if len(models) != 1:
        raise InputError(f"a batch of the models {', '.join(sorted(models)) or 'none'}; give vehicles of one model")


def _ways(model: Model, method: Method) -> list[str]:
    """What the rows of `Drive.taken` stand for; the last is the rescue of vehicles that a drive does not move."""
    if method == "auto":
        return [*(f"{way.model} {way.method}" for way in candidates(model)), f"{model} cvodes"]
    return [f"{model} {method}", f"{model} cvodes"]


def _program(
    model: Model, method: Literal["auto", "midpoint", "rk4"], substeps: int | None, tolerance: float
) -> StepProgram:
    size = model_state_size(model)
    if method == "auto":
        functions = tuple(substep_function(way.model, way.method, size) for way in candidates(model))
        return StepProgram(functions, automatic_plan(model, tolerance))
    plan = stiffness_plan(model, method, tolerance) if substeps is None else fixed_plan(model, substeps)
    return StepProgram((substep_function(model, method, size),), plan)


def _implicit_function(model: Model, method: Literal["radau", "cvodes"], elements: int | None) -> ca.Function:
    return cvodes_function(model) if method == "cvodes" else radau_function(model, elements or RADAU_ELEMENTS)


@lru_cache(maxsize=32)
def step_function(parameters: VehicleParameters, method: ExplicitMethod, substeps: int, step: float) -> ca.Function:
    """The one-step map as a CasADi function of (state, control), for what differentiates or repeats it."""
    start, control = ca.SX.sym("state", parameters.state_size), ca.SX.sym("control", CONTROL_SIZE)
    numbers = VehicleNumbers(*parameters.numbers)
    state = start
    for _ in range(substeps):
        state = explicit_substep(parameters.model, method, state, control, numbers, step / substeps)
    return ca.Function("step", [start, control], [ca.cse(state)], ["state", "control"], ["next_state"])
