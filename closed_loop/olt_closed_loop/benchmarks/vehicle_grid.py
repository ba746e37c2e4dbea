"""Where the vehicle models and `auto` are stable, accurate or refused: a grid of stiff and extreme cases.

Each cell drives one second from straight travel under a steering step, coasting, from brake to drive or from drive to
brake; the reference is CVODES at 1e-12. Single steps from random states follow (`benchmarks.vehicle_steps`), and then
special cases: emergency braking to standstill, a held brake, reversing, far coordinates, a control of NaN.
"""

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from olt_closed_loop.benchmarks.alpasim_vehicle import alpasim_vehicle
from olt_closed_loop.benchmarks.vehicle_steps import random_step_rows
from olt_closed_loop.vehicle.implicit import cvodes_function
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import DRY_FRICTION, VehicleParameters
from olt_closed_loop.vehicle.state import STATE
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.bench.benchmark import Grid

SPEEDS = (0.0, 1.0, 5.0, 10.0, 20.0, 40.0, 60.0)
FRICTIONS = (0.05, 0.3, 0.7, 1.2)
STIFFNESSES = (0.2, 1.0, 2.5, 10.0)
MASSES = (0.3, 1.0, 3.0)
STEPS = (0.005, 0.025, 0.1, 0.2)
STEERINGS = (0.1, 0.3, 0.6)
ACCELERATIONS = ((0.0, 0.0), (-4.0, 4.0), (4.0, -8.0))
"""What drive and brakes are set to at the start, and what is commanded, m/s^2."""
SECONDS = 1.0
ACCURATE, STABLE = 1e-5, 1e-2
"""Metres of position error after a second, below which a cell is called so."""
FAR = 5e6


@dataclass(frozen=True)
class Cell:
    """One drive of the grid; stiffness and mass are factors on AlpaSim's."""

    speed: float
    friction: float
    stiffness: float
    mass: float
    step: float
    steering: float
    accelerations: tuple[float, float] = (0.0, 0.0)

    @property
    def vehicle(self) -> VehicleParameters:
        """AlpaSim's car with these factors."""
        vehicle = alpasim_vehicle(self.friction)
        assert vehicle.tyres is not None
        tyres = replace(
            vehicle.tyres,
            mass=self.mass * vehicle.tyres.mass,
            yaw_inertia=self.mass * vehicle.tyres.yaw_inertia,
            front_stiffness=self.stiffness * vehicle.tyres.front_stiffness,
            rear_stiffness=self.stiffness * vehicle.tyres.rear_stiffness,
        )
        return replace(vehicle, tyres=tyres)


def cell_errors(cells: Sequence[Cell]) -> Array:
    """Position errors (n,) of `auto` after a second, metres."""
    errors = np.zeros(len(cells))
    reference = reference_states(cells)
    for step in {cell.step for cell in cells}:
        rows = [index for index, cell in enumerate(cells) if cell.step == step]
        chosen = [cells[index] for index in rows]
        stepper = VehicleStepper([cell.vehicle for cell in chosen], step=step)
        states, controls = _start(chosen)
        for _ in range(round(SECONDS / step)):
            states = stepper(states, controls)
        errors[rows] = np.linalg.norm((states - reference[rows])[:, :2], axis=1)
    return errors


def reference_states(cells: Sequence[Cell]) -> Array:
    """States (n, 8) after a second, by CVODES at 1e-12; cells that differ in the step alone share one."""
    exact, known = cvodes_function("saturating", 1e-12), dict[Cell, Array]()
    for cell in {replace(cell, step=0.0) for cell in cells}:
        states, controls = _start([cell])
        known[cell] = exact(states[0], controls[0], cell.vehicle.numbers, SECONDS).full().ravel()
    return np.stack([known[replace(cell, step=0.0)] for cell in cells])


def _start(cells: Sequence[Cell]) -> tuple[Array, Array]:
    states, controls = np.zeros((len(cells), 8)), np.zeros((len(cells), 2))
    states[:, STATE.speed] = [cell.speed for cell in cells]
    controls[:, 0] = [cell.steering for cell in cells]
    states[:, STATE.acceleration], controls[:, 1] = zip(*(cell.accelerations for cell in cells), strict=True)
    return states, controls


class SpecialCase(NamedTuple):
    """A manoeuvre with a number that must stay at or below its limit; no number where it has to be refused."""

    name: str
    measure: Callable[[], float]
    limit: float


def special_cases() -> list[SpecialCase]:
    """Braking to standstill, a held brake, reversing, far coordinates, and a control of NaN."""

    def last_speed(*arguments: float, reverse: bool = False) -> float:
        return _drive_alone(*arguments, reverse=reverse)[-1, STATE.speed]

    def moved() -> float:
        return float(np.abs(_drive_alone(0.0, -2.0, 60.0)[-1, :3]).max())

    def far_difference() -> float:
        near, far = (_drive_alone(15.0, 0.0, 10.0, offset=offset)[:, :2] - offset for offset in (0.0, FAR))
        return float(np.abs(near - far).max())

    return [
        SpecialCase("braking from 60 m/s: speed left after 15 s (m/s)", lambda: last_speed(60.0, -8.0, 15.0), 1e-9),
        SpecialCase("braking: lowest speed (m/s, negated)", lambda: -_drive_alone(20.0, -8.0, 5.0)[:, 3].min(), 0.0),
        SpecialCase("held brake, 60 s: distance moved (m)", moved, 0.0),
        SpecialCase("reversing for 5 s: speed (m/s)", lambda: last_speed(0.0, -1.0, 5.0, reverse=True), -4.0),
        SpecialCase("coordinates at 5e6 m: distance to the same drive at 0 (m)", far_difference, 1e-7),
        SpecialCase("control of NaN: refused", lambda: last_speed(10.0, np.nan, 1.0), -np.inf),
    ]


def _drive_alone(
    speed: float, acceleration: float, seconds: float, reverse: bool = False, offset: float = 0.0
) -> Array:
    """States (n, 8), the steering commanded to 0.2 rad."""
    stepper = VehicleStepper(replace(alpasim_vehicle(DRY_FRICTION), reverse_gear=reverse))
    states = [np.array([offset, offset, 0.0, speed, 0.0, 0.0, 0.0, 0.0])]
    for _ in range(round(seconds / 0.1)):
        states.append(stepper(states[-1], np.array([0.2, acceleration])))
    return np.stack(states)


def special_row(case: SpecialCase) -> dict[str, object]:
    """Name, number and outcome of a case."""
    try:
        value = float(case.measure())
    except InputError:
        return {"case": case.name, "value": None, "outcome": "refused"}
    return {"case": case.name, "value": value, "outcome": "as it should" if value <= case.limit else "wrong"}


def vehicle_grid() -> Grid:
    """Drive every cell, random steps and every special case."""
    axes = (SPEEDS, FRICTIONS, STIFFNESSES, MASSES, STEPS, STEERINGS, ACCELERATIONS)
    cells = [Cell(*values) for values in itertools.product(*axes)]
    rows: list[dict[str, Any]] = []
    for cell, error in zip(cells, cell_errors(cells).tolist(), strict=True):
        outcome = "accurate" if error <= ACCURATE else "stable" if error <= STABLE else "unstable"
        rows.append({**asdict(cell), "error_m": error, "outcome": outcome})
    summary = [f"{len(cells)} cells of {SECONDS:g} s: accurate within {ACCURATE:g} m, stable within {STABLE:g} m"]
    for friction in FRICTIONS:
        chosen = [row for row in rows if row["friction"] == friction]
        counts, errors = Counter(row["outcome"] for row in chosen), [row["error_m"] for row in chosen]
        told = ", ".join(f"{counts[outcome]} {outcome}" for outcome in ("accurate", "stable", "unstable"))
        summary.append(
            f"friction {friction:g}: {told}; median error {np.median(errors):.1e} m, largest {max(errors):.1e} m"
        )
    random_steps = list(random_step_rows())
    for row in random_steps:
        told = f"random steps of {1e3 * row['step']:g} ms, {row['model']}: {row['above_tolerance']} of {row['steps']}"
        largest, cost = row["largest_error_tolerances"], row["microseconds"]
        summary.append(f"{told} above the tolerance, largest error {largest:.2f} of it, {cost:.1f} us a step")
    specials = [special_row(case) for case in special_cases()]
    return Grid(
        [*rows, *random_steps, *specials], [*summary, *(" | ".join(map(str, row.values())) for row in specials)]
    )
