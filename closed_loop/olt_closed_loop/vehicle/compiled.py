"""Explicit steps of whole batches of vehicles in one call: generated C where there is a compiler, else interpreted.

A program is a handful of CasADi functions: explicit sub-steps, and a plan that says for a vehicle at this moment which
of them to take, how often, and at which moments a sub-step has to end. `CompiledStep` and `InterpretedStep` run the
same program, each vehicle by itself, so a vehicle moves alike alone and in any batch, compiled or not. Positions are
integrated from the step's start: far coordinates cost no precision.
"""

import ctypes
import shutil
import subprocess
import tempfile
from abc import ABC, abstractmethod
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np

from olt_closed_loop.vehicle.buffered import BufferedFunction
from olt_closed_loop.vehicle.state import STATE
from olt_generator.errors import InputError
from olt_generator.poses import Array

MOST_SUBSTEPS = 4096
"""In one step. Where more are needed an implicit method is cheaper."""
KINKS = 3
PLAN_SIZE = 3 + KINKS


class StepProgram(NamedTuple):
    """What happens in one step.

    Attributes:
        substeps: functions (state, control, numbers, length) -> state.
        plan: (state, control, numbers, step) -> (`PLAN_SIZE`,): index into `substeps`; how many; either 0 or a
            tolerance in metres, to which the sub-steps are doubled until twice as many change the end by less, be it
            at once or, by its heading and speeds, a step later;
            and in rising order the `KINKS` moments within the step (s) at which a sub-step ends, with sub-steps
            between them no longer than an even share of the step.
    """

    substeps: tuple[ca.Function, ...]
    plan: ca.Function


class BatchStep(ABC):
    """The map over one step of n vehicles whose states have s numbers.

    A vehicle that would need more than `MOST_SUBSTEPS` is not moved, and its plan names one past the last sub-step.

    Args:
        numbers: (n, `NUMBERS_SIZE`) of the vehicles.
        step: seconds.
        state_size: s.
        ways: how many sub-step functions there are.

    Attributes:
        numbers: as given; what is written into them holds from the next call on.
        plans: (n, `PLAN_SIZE`) what the last call did, in the form of `StepProgram.plan`.
        taken: (sub-step functions + 1, 2) how many steps were taken with each, and how many sub-steps.
    """

    def __init__(self, numbers: Array, step: float, state_size: int, ways: int) -> None:
        self.numbers, self._step = np.array(numbers, dtype=np.float64), step
        self._ends = np.zeros((len(numbers), state_size))
        self.plans, self.taken = np.zeros((len(numbers), PLAN_SIZE)), np.zeros((ways + 1, 2))

    @abstractmethod
    def __call__(self, states: Array, controls: Array) -> Array:
        """States (n, s) one step later; overwritten by the next call. Raises `InputError` for what is not finite."""


class SerialStep(BatchStep):
    """Moves one vehicle after the other."""

    def __call__(self, states: Array, controls: Array) -> Array:
        """See `BatchStep`."""
        states, controls = np.atleast_2d(states, controls)
        check_finite(states, controls)
        for index, vehicle in enumerate(zip(states, controls, self.numbers, strict=True)):
            self._ends[index], self.plans[index] = self.step_one(*vehicle)
            self.taken[int(self.plans[index, 0])] += 1.0, self.plans[index, 1]
        return self._ends

    @abstractmethod
    def step_one(self, state: Array, control: Array, numbers: Array) -> tuple[Array, Array]:
        """The state (s,) of one vehicle a step later, and its plan (`PLAN_SIZE`,)."""


def make_explicit_step(program: StepProgram, numbers: Array, step: float) -> BatchStep:
    """The map over `step` seconds of vehicles with the given numbers (n, `NUMBERS_SIZE`)."""
    library = compile_program(program)
    if library is None:
        return InterpretedStep(program, numbers, step)
    return CompiledStep(library, program, numbers, step)


def check_finite(states: Array, controls: Array) -> None:
    """Raise `InputError` naming the first vehicle whose state (n, s) or control (n, 2) holds a NaN or an infinity."""
    for index, (state, control) in enumerate(zip(states, controls, strict=True)):
        for name, values in (("state", state), ("control", control)):
            if not np.isfinite(values).all():
                raise InputError(f"vehicle {index}: its {name} is {values.tolist()}; every number must be finite")


class CompiledStep(BatchStep):
    """Runs a program in C."""

    def __init__(self, library: ctypes.CDLL, program: StepProgram, numbers: Array, step: float) -> None:
        super().__init__(numbers, step, program.plan.size1_in(0), len(program.substeps))
        self._states, self._controls = np.zeros_like(self._ends), np.zeros((len(numbers), program.plan.size1_in(1)))
        arrays = (self._states, self._controls, self.numbers, self._ends, self.plans, self.taken)
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
        self._arguments = (ctypes.c_longlong(len(numbers)), ctypes.c_double(step), *pointers)
        self._step_all = library.step_all

    def __call__(self, states: Array, controls: Array) -> Array:
        """See `BatchStep`."""
        self._states[...] = states
        self._controls[...] = controls
        if not self._step_all(*self._arguments):
            check_finite(self._states, self._controls)
        return self._ends


class InterpretedStep(SerialStep):
    """Runs a program in CasADi's virtual machine: the same numbers, some fifteen times slower."""

    def __init__(self, program: StepProgram, numbers: Array, step: float) -> None:
        super().__init__(numbers, step, program.plan.size1_in(0), len(program.substeps))
        self._substeps = [BufferedFunction(function) for function in program.substeps]
        self._plan = BufferedFunction(program.plan)

    def step_one(self, state: Array, control: Array, numbers: Array) -> tuple[Array, Array]:
        """See `SerialStep`."""
        (plan,) = self._plan(state, control, numbers, self._step)
        end = self._advance(state, control, numbers, plan)
        while plan[2] and plan[1] <= MOST_SUBSTEPS:
            coarse, plan[1] = end, 2.0 * plan[1]
            end = self._advance(state, control, numbers, plan)
            if self._difference(end, coarse) < plan[2]:
                break
        if plan[1] > MOST_SUBSTEPS:
            plan[0] = len(self._substeps)
            return state, plan
        end[: STATE.yaw] += state[: STATE.yaw]
        return end, plan

    def _difference(self, end: Array, other: Array) -> float:
        """Metres between two ends of a step, at the rig or a metre from it, now and, as speeds differ, a step later."""
        off = np.abs(end - other)
        speeds = off[STATE.speed], abs(end[STATE.speed]) * off[STATE.yaw], *off[STATE.lateral_speed :]
        return max(np.hypot(off[STATE.x], off[STATE.y]), self._step * max(speeds))

    def _advance(self, state: Array, control: Array, numbers: Array, plan: Array) -> Array:
        """The state after the planned sub-steps, its position counted from the start."""
        state = np.concatenate([[0.0, 0.0], state[STATE.yaw :]])
        began = 0.0
        for ends in (*plan[3:], self._step) if plan[1] <= MOST_SUBSTEPS else ():
            count = np.ceil((ends - began) / self._step * plan[1])
            for _ in range(int(count)):
                (state,) = self._substeps[int(plan[0])](state, control, numbers, (ends - began) / count)
            began = ends
        return state


_STEP_ALL = """
#include <math.h>
#include <string.h>
typedef int (*function)(const double **, double **, long long int *, double *, int);
static const function substeps[] = {{{names}}};

/* The state after the planned sub-steps, its position counted from the start. */
static void advance(double step, const double *state, const double *control, const double *numbers,
                    const double *chosen, double *end) {{
  double work[{work}], buffers[2][{size}], began = 0.0, ends, count, length;
  long long int integers[{integers}], k, kink, reached = 0;
  const double *inputs[{inputs}];
  double *outputs[{outputs}];
  memcpy(buffers[0], state, sizeof(buffers[0]));
  buffers[0][0] = buffers[0][1] = 0.0;
  for (kink = 0; kink <= {kinks} && chosen[1] <= {most}; ++kink, began = ends) {{
    ends = kink < {kinks} ? chosen[3 + kink] : step;
    count = ceil((ends - began) / step * chosen[1]);
    length = (ends - began) / count;
    for (k = 0; k < (long long int) count; ++k, reached = !reached) {{
      inputs[0] = buffers[reached]; inputs[1] = control; inputs[2] = numbers; inputs[3] = &length;
      outputs[0] = buffers[!reached];
      substeps[(long long int) chosen[0]](inputs, outputs, integers, work, 0);
    }}
  }}
  memcpy(end, buffers[reached], sizeof(buffers[0]));
}}

/* Metres between two ends of a step, at the rig or a metre from it, now and, as speeds differ, a step later. */
static double difference(double step, const double *end, const double *other) {{
  double speeds = fmax(fabs(end[3] - other[3]), fabs(end[3]) * fabs(end[2] - other[2]));
  if ({size} > 6) speeds = fmax(speeds, fmax(fabs(end[6] - other[6]), fabs(end[7] - other[7])));
  return fmax(hypot(end[0] - other[0], end[1] - other[1]), step * speeds);
}}

static void step_one(double step, const double *state, const double *control, const double *numbers, double *end,
                     double *chosen) {{
  double work[{work}], coarse[{size}];
  long long int integers[{integers}];
  const double *inputs[{inputs}];
  double *outputs[{outputs}];
  inputs[0] = state; inputs[1] = control; inputs[2] = numbers; inputs[3] = &step;
  outputs[0] = chosen;
  {plan}(inputs, outputs, integers, work, 0);
  advance(step, state, control, numbers, chosen, end);
  while (chosen[2] && chosen[1] <= {most}) {{
    memcpy(coarse, end, sizeof(coarse));
    chosen[1] *= 2.0;
    advance(step, state, control, numbers, chosen, end);
    if (difference(step, end, coarse) < chosen[2]) break;
  }}
  if (chosen[1] > {most}) {{
    chosen[0] = {count};
    memcpy(end, state, sizeof(coarse));
    return;
  }}
  end[0] += state[0];
  end[1] += state[1];
}}

/* Returns 0, with nothing done, where a state or control is not finite. */
int step_all(long long int count, double step, const double *states, const double *controls, const double *numbers,
          double *ends, double *plans, double *taken) {{
  long long int i, which;
  for (i = 0; i < {size} * count; ++i) if (!isfinite(states[i])) return 0;
  for (i = 0; i < {controls} * count; ++i) if (!isfinite(controls[i])) return 0;
  for (i = 0; i < count; ++i) {{
    step_one(step, states + {size} * i, controls + {controls} * i, numbers + {parameters} * i, ends + {size} * i,
              plans + {plan_size} * i);
    which = (long long int) plans[{plan_size} * i];
    taken[2 * which] += 1.0;
    taken[2 * which + 1] += plans[{plan_size} * i + 1];
  }}
  return 1;
}}
"""


@lru_cache(maxsize=32)
def compile_program(program: StepProgram) -> ctypes.CDLL | None:
    """The program as a loaded library, or None where it cannot be built or loaded; built once a process."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    functions, generator = (*program.substeps, program.plan), ca.CodeGenerator("functions.c")
    for function in functions:
        generator.add(function)
    step_all = _STEP_ALL.format(
        names=", ".join(function.name() for function in program.substeps),
        plan=program.plan.name(),
        count=len(program.substeps),
        most=MOST_SUBSTEPS,
        kinks=KINKS,
        plan_size=PLAN_SIZE,
        size=program.plan.size1_in(0),
        controls=program.plan.size1_in(1),
        parameters=program.plan.size1_in(2),
        work=1 + max(function.sz_w() for function in functions),
        integers=1 + max(function.sz_iw() for function in functions),
        inputs=max(function.sz_arg() for function in functions),
        outputs=max(function.sz_res() for function in functions),
    )
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "program.c"), Path(folder, "program.so")
        source.write_text(generator.dump() + step_all)
        # Without contraction into fused operations the numbers are those of the interpreter.
        flags = ["-O2", "-ffp-contract=off", "-shared", "-fPIC"]
        built = subprocess.run([compiler, *flags, str(source), "-o", str(library), "-lm"], capture_output=True)
        if built.returncode:
            return None
        try:
            return ctypes.CDLL(str(library))
        except OSError:  # temporary folders that may hold no programs
            return None
