"""Single steps of `auto` from random states under random controls: whether each keeps the tolerance, and its cost.

States and controls are drawn so that every regime comes up: standing and creeping in both directions, up to 60 m/s,
ice to dry road, wheels that are turned through, drive that becomes brake, either gear, steps of 1 ms to 0.5 s. The
reference takes 1024 sub-steps of Runge-Kutta 4.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from olt_closed_loop.vehicle.integrators import DEFAULT_TOLERANCE, VehicleStepper
from olt_closed_loop.vehicle.parameters import MODELS, Model, VehicleParameters, vehicle_with_tyres
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import Array
from olt_generator.seeds import make_generator
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

STEPS = (0.001, 0.01, 0.1, 0.5)
FRICTIONS = (0.1, 0.3, 0.7, 1.0)
REFERENCE_SUBSTEPS = 1024


class RandomSteps(NamedTuple):
    """What a batch of n steps starts from: vehicles, states (n, s) and controls (n, 2)."""

    vehicles: Sequence[VehicleParameters]
    states: Array
    controls: Array


class StepErrors(NamedTuple):
    """How far n steps are from the reference, and what they cost.

    Attributes:
        position: (n,) metres, in tolerances of the step.
        yaw, speed: (n,) radians and m/s.
        microseconds: of CPU time a step.
    """

    position: Array
    yaw: Array
    speed: Array
    microseconds: float


def draw_steps(model: Model, count: int, seed: int) -> RandomSteps:
    """Random starts of a model."""
    generator = make_generator(seed, "vehicle", model)

    def often_small(low: float, high: float) -> Array:
        small = generator.uniform(size=count) < 0.5
        return generator.uniform(low, high, count) * np.where(small, 10.0 ** generator.uniform(-3.0, 0.0, count), 1.0)

    slow = generator.uniform(size=count) < 0.3
    speed = np.where(slow, often_small(-5.0, 5.0), generator.uniform(0.0, 60.0, count))
    steering, acceleration = often_small(-0.8, 0.8), often_small(-8.0, 6.0)
    held = generator.uniform(size=count) < 0.3
    controls = np.stack([np.where(held, steering, often_small(-0.8, 0.8)), often_small(-9.0, 7.0)], axis=-1)
    states = np.zeros((count, 6 if model == "kinematic" else 8))
    states[:, STATE.yaw] = generator.uniform(-np.pi, np.pi, count)
    states[:, STATE.speed : STATE.lateral_speed] = np.stack([speed, steering, acceleration], axis=-1)
    if model != "kinematic":
        rolling = np.clip(speed * np.tan(steering) / DEFAULT_VEHICLE.wheelbase, -1.0, 1.0)
        states[:, STATE.lateral_speed] = often_small(-0.2, 0.2) * np.minimum(np.abs(speed), 10.0)
        states[:, STATE.yaw_rate] = rolling + often_small(-0.3, 0.3)
    frictions, reverse = generator.choice(FRICTIONS, count), generator.uniform(size=count) < 0.2
    choices = zip(frictions.tolist(), reverse.tolist(), strict=True)
    return RandomSteps([_vehicle(model, friction, gear) for friction, gear in choices], states, controls)


def _vehicle(model: Model, friction: float, reverse: bool) -> VehicleParameters:
    if model == "kinematic":
        vehicle = replace(VehicleParameters.from_dimensions(DEFAULT_VEHICLE), friction=friction)
    else:
        vehicle = vehicle_with_tyres(DEFAULT_VEHICLE, np.inf if model == "linear" else friction)
    return replace(vehicle, reverse_gear=reverse)


def step_errors(steps: RandomSteps, seconds: float) -> StepErrors:
    """Errors of `auto` over one step of so many seconds."""
    stepper = VehicleStepper(steps.vehicles, step=seconds)
    began = time.thread_time()
    ends = stepper(steps.states, steps.controls)
    spent = time.thread_time() - began
    exact = VehicleStepper(steps.vehicles, "rk4", REFERENCE_SUBSTEPS, step=seconds)(steps.states, steps.controls)
    off = np.abs(ends - exact)
    tolerance = DEFAULT_TOLERANCE * seconds / 0.1
    position = np.hypot(off[:, STATE.x], off[:, STATE.y]) / tolerance
    return StepErrors(position, off[:, STATE.yaw], off[:, STATE.speed], 1e6 * spent / len(ends))


def random_step_rows(count: int = 4000, seed: int = 0) -> Iterator[dict[str, Any]]:
    """One row for each model and length of the step."""
    for model in MODELS:
        steps = draw_steps(model, count, seed)
        for seconds in STEPS:
            errors = step_errors(steps, seconds)
            yield {
                "model": model,
                "step": seconds,
                "steps": count,
                "above_tolerance": int((errors.position > 1.0).sum()),
                "largest_error_tolerances": float(errors.position.max()),
                "largest_yaw_error": float(errors.yaw.max()),
                "largest_speed_error": float(errors.speed.max()),
                "microseconds": errors.microseconds,
            }
