"""One-step maps of the vehicle over a step in which the control is held: methods side by side, and `auto`.

`midpoint` and `rk4` take explicit sub-steps (`vehicle.substeps`): as many as are given, else as many as the
stiffness of the moment asks for. `radau` and `cvodes` are implicit (`vehicle.implicit`). `auto` takes at every
step the cheapest model and method that stay within the tolerance (`vehicle.integration_plan`) and counts what
it took and what it left out. `olt bench vehicle` holds the error of each against its run time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from olt_closed_loop.vehicle.compiled import MOST_SUBSTEPS, BatchStep, StepProgram, make_explicit_step
from olt_closed_loop.vehicle.implicit import ImplicitStep, cvodes_function, radau_function
from olt_closed_loop.vehicle.integration_plan import automatic_plan, candidates, fixed_plan, stiffness_plan
from olt_closed_loop.vehicle.parameters import Model, VehicleParameters, model_state_size, on_the_brake
from olt_closed_loop.vehicle.substeps import substep_function
from olt_generator.errors import InputError
from olt_generator.omissions import Omission
from olt_generator.poses import Array

Method = Literal["auto", "midpoint", "rk4", "radau", "cvodes"]
DEFAULT_METHOD: Method = "auto"
DEFAULT_TOLERANCE = 3e-7
"""Metres of position error in 0.1 s: two seconds of the hardest manoeuvres of `olt bench vehicle` stay below 1e-6 m."""
RADAU_ELEMENTS = 8


class VehicleStepper:
    """The map over `step` seconds for one vehicle, or for a batch whose vehicles move as each would alone.

    It counts what it takes. Not for several threads at once.

    Args:
        vehicles: one vehicle, or several that may differ in every number but have one model; the model sets the size s
            of the state.
        method: how to integrate.
        substeps: of `midpoint` and `rk4`, elements of `radau`; None for what the moment asks for (`radau`: 8).
        step: seconds.
        tolerance: metres of position error in 0.1 s that `auto` stays within, and that sub-steps which are not given
            are estimated for.

    Raises:
        InputError: an unknown method, a number that makes no sense, or vehicles of several models.
    """

    def __init__(
        self,
        vehicles: VehicleParameters | Sequence[VehicleParameters],
        method: Method = DEFAULT_METHOD,
        substeps: int | None = None,
        step: float = 0.1,
        tolerance: float = DEFAULT_TOLERANCE,
    ) -> None:
        if method not in get_args(Method):
            raise InputError(f"no integrator {method!r}; there are {', '.join(get_args(Method))}")
        if not (0.0 < step < np.inf and 0.0 < tolerance < np.inf):
            raise InputError(f"step of {step} s within {tolerance} m: both must be positive numbers")
        if substeps is not None and not 1 <= substeps <= MOST_SUBSTEPS:
            raise InputError(f"{substeps} sub-steps: give 1 to {MOST_SUBSTEPS}, or none for what the moment asks for")
        batch = [vehicles] if isinstance(vehicles, VehicleParameters) else vehicles
        models = {vehicle.model for vehicle in batch}
        if len(models) != 1:
            raise InputError(f"a batch of the models {', '.join(sorted(models)) or 'none'}; give vehicles of one model")
        self._step, self._tolerance, self._batched = step, tolerance, batch is vehicles
        self._vehicles, self._shifted = list(batch), list[int]()
        self._model = model = batch[0].model
        numbers = np.stack([vehicle.numbers for vehicle in batch])
        # What the rows of `BatchStep.taken` stand for; the last is the rescue of vehicles that are not moved.
        explicit: tuple[tuple[Model, Any], ...] = candidates(model) if method == "auto" else ((model, method),)
        self._ways = [*(" ".join(way) for way in explicit), f"{model} cvodes"]
        self._batch_step: BatchStep
        if method == "cvodes":
            self._batch_step = ImplicitStep(cvodes_function(model), numbers, step)
        elif method == "radau":
            self._batch_step = ImplicitStep(radau_function(model, substeps or RADAU_ELEMENTS), numbers, step)
        else:
            step_tolerance = tolerance * step / 0.1
            if method == "auto":
                plan = automatic_plan(model, step_tolerance)
            elif substeps is None:
                plan = stiffness_plan(model, method, step_tolerance)
            else:
                plan = fixed_plan(model, substeps)
            functions = tuple(substep_function(*way, model_state_size(model)) for way in explicit)
            self._batch_step = make_explicit_step(StepProgram(functions, plan), numbers, step)

    def __call__(self, state: Array, control: Array) -> Array:
        """The state (s,) one step later under a control (2,); of a batch (n, s) under (n, 2).

        Raises:
            InputError: a state or control is not finite, or the equations cannot be solved from there.
        """
        if self._shifted:
            state = np.atleast_2d(state).copy()
            state[self._shifted] = on_the_brake(state[self._shifted], self._vehicles[0])
            self._shifted = []
        taken, plans = self._batch_step.taken, self._batch_step.plans
        unmoved = taken[-1, 0]
        ends = self._batch_step(state, control)
        if taken[-1, 0] > unmoved:
            rows = np.flatnonzero(plans[:, 0] == len(self._ways) - 1)
            implicit = ImplicitStep(cvodes_function(self._model), self._batch_step.numbers[rows], self._step)
            ends[rows] = implicit(np.atleast_2d(state)[rows], np.atleast_2d(control)[rows])
        return ends.copy() if self._batched else ends[0].copy()

    def shift(self, reverse: bool) -> None:
        """Put all vehicles into a gear; those that shift start their next step on the brake."""
        rows = [index for index, vehicle in enumerate(self._vehicles) if vehicle.reverse_gear != reverse]
        if rows:
            self._vehicles = [replace(vehicle, reverse_gear=reverse) for vehicle in self._vehicles]
            self._batch_step.numbers[...] = [vehicle.numbers for vehicle in self._vehicles]
            self._shifted = rows

    def taken(self) -> dict[str, tuple[int, int]]:
        """Steps of all vehicles since the stepper was made, and their sub-steps, by model and method.

        The key is such as "kinematic midpoint"; implicit methods choose their own sub-steps, which count as 0.
        """
        counted = zip(self._ways, self._batch_step.taken.astype(int).tolist(), strict=True)
        return {way: (steps, substeps) for way, (steps, substeps) in counted if steps}

    def left_out(self) -> Iterator[Omission]:
        """What was not computed in these steps, and why."""
        taken = {way: steps for way, (steps, _) in self.taken().items()}
        for simpler, what in (("kinematic", "tyre slip"), ("linear", "tyre saturation")):
            count = sum(steps for way, steps in taken.items() if way.startswith(f"{simpler} "))
            if count and simpler != self._model:
                why = f"below {self._tolerance:g} m in 0.1 s"
                yield Omission(f"steps of {what}", why, count, sum(taken.values()))
