"""Tracking where it is hard: all speeds, standstill, reversing, jumps, and plans that are short, old or unusable.

`python -m olt_closed_loop.benchmarks.control_extremes` prints the table.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from olt_closed_loop.control import ControlMethod, ControlSettings, TrackingController
from olt_closed_loop.integrators import make_stepper
from olt_closed_loop.plans import PlanRefused, WorldPlan
from olt_closed_loop.vehicle import VehicleParameters, with_rolling_tyres
from olt_closed_loop.vehicle_presets import alpasim_vehicle
from olt_generator.poses import Array
from olt_toolkit.policy import STEP_SECONDS, STEP_US
from olt_toolkit.rig import DEFAULT_VEHICLE

VEHICLES: dict[str, VehicleParameters] = {
    "kinematic": VehicleParameters.from_dimensions(DEFAULT_VEHICLE),
    "linear tyres": alpasim_vehicle(),
    "friction 0.9": alpasim_vehicle(0.9),
}
METHODS: tuple[ControlMethod, ...] = ("lqr", "linear", "nonlinear")
SPEEDS = (0.0, 0.3, 1.0, 5.0, 15.0, 30.0, 45.0, 60.0)
SECONDS = 8.0
LATERAL_ACCELERATION = 2.0
JUMP_AFTER = 2.0

Path = Callable[[Array], Array]
"""Times (n,) in seconds -> poses (n, 3)."""


@dataclass(frozen=True)
class Case:
    """Something to track.

    Attributes:
        name: what it is.
        path: where to be at which time.
        speed: of the vehicle at the start, m/s.
        jump: metres to the left by which plans differ from `JUMP_AFTER` seconds on.
        plan_seconds: how far a plan reaches.
        last_plan: time of the last plan; it is followed to its end and beyond.
        age: how old a plan is when it is first followed, seconds.
        deadline: of a solve, seconds.
        reverse: whether the reverse gear is in.
    """

    name: str
    path: Path
    speed: float
    jump: float = 0.0
    plan_seconds: float = 5.0
    last_plan: float = np.inf
    age: float = 0.0
    deadline: float | None = None
    reverse: bool = False

    def plan(self, now: float) -> WorldPlan:
        """The plan that is followed at a time."""
        made = min(now, self.last_plan) - self.age
        steps = np.arange(round(self.plan_seconds / STEP_SECONDS) + 1, dtype=np.int64)
        poses = self.path(made + STEP_SECONDS * steps.astype(np.float64))
        poses[:, 1] += self.jump * (made >= JUMP_AFTER)
        return WorldPlan(round(1e6 * made) + STEP_US * steps, poses)


@dataclass(frozen=True)
class Outcome:
    """What became of a case.

    Attributes:
        errors: (80,) distances in metres to where the plan wants the rig, at the end of every step.
        failed, late: counted events.
        refused: why it was not driven, or nothing.
    """

    errors: Array = field(default_factory=lambda: np.full(1, np.nan))
    failed: int = 0
    late: int = 0
    refused: str = ""


def cases() -> Iterator[Case]:
    """All cases, for any vehicle and method."""
    for speed in SPEEDS:
        yield Case(f"straight at {speed:g} m/s", straight(speed), speed)
        yield Case(f"curve at {speed:g} m/s", curve(speed), speed)
        yield Case(f"jump of 1 m at {speed:g} m/s", straight(speed), speed, jump=1.0)
    yield Case("standstill, then 5 m/s", lambda time: straight(5.0)(np.maximum(time - 3.0, 0.0)), 0.0)
    yield Case("reversing at 3 m/s", straight(-3.0), -3.0, reverse=True)
    yield Case("backwards in the forward gear", straight(-3.0), 0.0)
    yield Case("the plan ends after 3 s", straight(10.0), 10.0, plan_seconds=3.0, last_plan=0.0)
    yield Case("plans 1 s old", curve(15.0), 15.0, age=1.0)
    yield Case("every solve late", curve(15.0), 15.0, deadline=0.0)
    yield Case("NaN in the plan", lambda time: straight(15.0)(np.where(time > 6.0, np.nan, time)), 15.0)
    yield Case("a plan at 75 m/s", straight(75.0), 60.0)


def straight(speed: float) -> Path:
    """Along x."""
    return lambda time: np.stack([speed * time, 0.0 * time, 0.0 * time], axis=-1)


def curve(speed: float) -> Path:
    """A left turn: within 2 s to LATERAL_ACCELERATION, or to a radius of 12 m where that is reached first."""
    yaw_rate = min(LATERAL_ACCELERATION / speed, speed / 12.0) if speed else 0.0
    fine = np.arange(0.0, 2.0 * SECONDS, 1e-3)
    yaw = np.cumsum(yaw_rate * np.clip(fine / 2.0, 0.0, 1.0)) * 1e-3
    x, y = (np.cumsum(speed * direction(yaw)) * 1e-3 for direction in (np.cos, np.sin))
    return lambda time: np.stack([np.interp(time, fine, column) for column in (x, y, yaw)], axis=-1)


def drive(case: Case, parameters: VehicleParameters, method: ControlMethod) -> Outcome:
    """Track a case with a vehicle that moves as its own equations say."""
    parameters = replace(parameters, reverse_gear=case.reverse)
    controller = TrackingController(parameters, ControlSettings(method=method, deadline_seconds=case.deadline))
    stepper = make_stepper(parameters)
    state = with_rolling_tyres(np.array([0.0, 0.0, 0.0, case.speed, 0.0, 0.0]), parameters)
    errors = np.zeros(round(SECONDS / STEP_SECONDS))
    try:
        for step in range(len(errors)):
            plan = case.plan(step * STEP_SECONDS)
            state = stepper(state, controller.control(state, plan, step * STEP_US))
            wanted = plan.at(np.array([(step + 1) * STEP_US]))[0]
            errors[step] = np.linalg.norm(state[:2] - wanted[:2])
    except PlanRefused as refusal:
        return Outcome(refused=str(refusal))
    return Outcome(errors, controller.events.failed, controller.events.late)


def main() -> None:
    """Print what becomes of every case."""
    for case in cases():
        for (vehicle, parameters), method in product(VEHICLES.items(), METHODS):
            outcome = drive(case, parameters, method)
            told = outcome.refused or (
                f"largest error {outcome.errors.max():8.3f} m, last {outcome.errors[-1]:8.3f} m, "
                f"{outcome.failed} failed, {outcome.late} late"
            )
            print(f"{case.name:30} {vehicle:14} {method:10} {told}")


if __name__ == "__main__":
    main()
