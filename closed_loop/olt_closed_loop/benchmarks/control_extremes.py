"""Tracking where it is hard: all speeds, ice, standstill, reversing, jumps, and plans that are short, old or unusable.

Each case is driven for eight seconds by a vehicle that moves as its own equations say. It ends as one of

- `tracked`: in the last second the vehicle is within 0.1 m of where the plan wants it;
- `held`: solves failed or were late, were counted, and the last feasible commands went on;
- `refused`: in words, before anything was commanded;
- `off the plan`: none of these. Some plans no vehicle can follow; they end here by right.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from olt_closed_loop.benchmarks.alpasim_vehicle import alpasim_vehicle
from olt_closed_loop.control.plans import PlanRefused, WorldPlan
from olt_closed_loop.control.tracking import ControlMethod, ControlSettings, SolveCounts, TrackingController
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import VehicleParameters, with_rolling_tyres
from olt_closed_loop.vehicle.tyres import GRAVITY
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.bench.benchmark import Grid
from olt_toolkit.policy.contract import STEP_SECONDS, STEP_US
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

VEHICLES: dict[str, VehicleParameters] = {
    "kinematic": VehicleParameters.from_dimensions(DEFAULT_VEHICLE),
    "linear tyres": alpasim_vehicle(),
    "friction 0.9": alpasim_vehicle(0.9),
    "friction 0.3": alpasim_vehicle(0.3),
    "friction 0.05": alpasim_vehicle(0.05),
}
WAYS: tuple[tuple[str, ControlMethod], ...] = (
    *((vehicle, "linear") for vehicle in VEHICLES),
    ("friction 0.9", "lqr"),
    ("friction 0.9", "nonlinear"),
)
"""Every vehicle by the default method, and the other methods with one."""
SPEEDS = (0.0, 0.3, 1.0, 5.0, 15.0, 30.0, 45.0, 60.0)
SECONDS = 8.0
LATERAL_ACCELERATION, DECELERATION = 2.0, 3.0
"""m/s^2 of curves and of coming to rest; on slippery roads at most half of what the friction gives."""
JUMP_AFTER = 2.0
TRACKED = 0.1
OUT_OF_REACH = 1e200
"""Metres: the square of such an error is not finite, so no solver has an answer."""

Path = Callable[[Array], Array]
"""Times (n,) in seconds -> poses (n, 3)."""


@dataclass(frozen=True)
class Case:
    """Something to track.

    Attributes:
        name: what it is.
        path: where to be at which time.
        speed: of the vehicle at the start, m/s.
        possible: whether a vehicle could be on the plan in the end.
        jump: metres to the left by which plans differ from `JUMP_AFTER` seconds on.
        plan_seconds: how far a plan reaches.
        last_plan: time of the last plan; it is followed to its end and beyond.
        age: how old a plan is when it is first followed, seconds.
        deadline: of a solve, seconds.
        lost: seconds from when to when plans are `OUT_OF_REACH`.
        reverse: whether the reverse gear is in.
    """

    name: str
    path: Path
    speed: float
    possible: bool = True
    jump: float = 0.0
    plan_seconds: float = 5.0
    last_plan: float = np.inf
    age: float = 0.0
    deadline: float | None = None
    lost: tuple[float, float] = (np.inf, np.inf)
    reverse: bool = False

    def plan(self, now: float, meant: bool = False) -> WorldPlan:
        """The plan that the controller is given at a time, or the one `meant`, which the vehicle is judged by."""
        made = min(now, self.last_plan) - self.age
        steps = np.arange(round(self.plan_seconds / STEP_SECONDS) + 1, dtype=np.int64)
        poses = self.path(made + STEP_SECONDS * steps.astype(np.float64))
        poses[:, 1] += self.jump * (made >= JUMP_AFTER)
        poses += OUT_OF_REACH * (not meant and self.lost[0] <= now < self.lost[1])
        return WorldPlan(round(1e6 * made) + STEP_US * steps, poses)


@dataclass(frozen=True)
class DrivenCase:
    """What became of a case.

    Attributes:
        errors: (80,) distances in metres to where the plan wants the rig, at the end of every step.
        counts: how the controller's calls went.
        refused: why it was not driven, or nothing.
    """

    errors: Array = field(default_factory=lambda: np.full(1, np.nan))
    counts: SolveCounts = field(default_factory=SolveCounts)
    refused: str = ""

    @property
    def last_error(self) -> float:
        """Mean distance (m) to the plan in the last second."""
        return float(self.errors[-round(1.0 / STEP_SECONDS) :].mean())

    @property
    def outcome(self) -> str:
        """How it ended, in a word of the module's text."""
        if self.refused:
            return "refused"
        if self.counts.failed or self.counts.late:
            return "held"
        return "tracked" if self.last_error <= TRACKED else "off the plan"


def cases(friction: float = np.inf) -> Iterator[Case]:
    """All cases, for vehicles on a road of this friction."""
    grip = friction * GRAVITY
    lateral = min(LATERAL_ACCELERATION, 0.5 * grip)
    for speed in SPEEDS:
        yield Case(f"straight at {speed:g} m/s", straight(speed), speed)
        yield Case(f"curve at {speed:g} m/s", curve(speed, lateral), speed)
        yield Case(f"jump of 1 m at {speed:g} m/s", straight(speed), speed, possible=speed > 0.0, jump=1.0)
    yield Case("curve beyond the grip at 15 m/s", curve(15.0, min(1.5 * grip, 15.0)), 15.0, possible=False)
    yield Case("15 m/s to rest", to_rest(15.0, min(DECELERATION, 0.5 * grip)), 15.0)
    yield Case("standstill, then 5 m/s", lambda time: straight(min(5.0, 2.0 * grip))(np.maximum(time - 3.0, 0.0)), 0.0)
    yield Case("reversing at 3 m/s", straight(-3.0), -3.0, reverse=True)
    yield Case("backwards from the forward gear", straight(-min(3.0, grip)), 0.0)
    yield Case("forwards and back", forth_and_back(min(DECELERATION, 0.4 * grip)), 0.0)
    yield Case("the plan ends after 3 s", straight(10.0), 10.0, possible=False, plan_seconds=3.0, last_plan=0.0)
    yield Case("plans 1 s old", curve(15.0, lateral), 15.0, age=1.0)
    yield Case("every solve late", curve(15.0, lateral), 15.0, deadline=0.0)
    yield Case("every solve of 1 s fails", curve(15.0, lateral), 15.0, lost=(4.0, 5.0))
    yield Case("NaN in the plan", lambda time: straight(15.0)(np.where(time > 6.0, np.nan, time)), 15.0)
    yield Case("NaN in the state", straight(15.0), np.nan)
    yield Case("a plan at 75 m/s", straight(75.0), 60.0)


def straight(speed: float) -> Path:
    """Along x."""
    return lambda time: np.stack([speed * time, 0.0 * time, 0.0 * time], axis=-1)


def to_rest(speed: float, deceleration: float) -> Path:
    """Along x, from `speed` two seconds from now on evenly to standstill."""

    def path(time: Array) -> Array:
        braking = np.clip(time - 2.0, 0.0, speed / deceleration)
        return straight(1.0)(speed * np.minimum(time, 2.0) + (speed - 0.5 * deceleration * braking) * braking)

    return path


def forth_and_back(acceleration: float) -> Path:
    """Along x for three seconds up and down at this many m/s^2, half a second of rest, and the same way back."""
    times = np.array([0.0, 1.5, 3.0, 3.5, 5.0, 6.5])
    speeds = acceleration * np.array([0.0, 1.5, 0.0, 0.0, -1.5, 0.0])
    fine = np.arange(0.0, 2.0 * SECONDS, 1e-3)
    x = np.cumsum(np.interp(fine, times, speeds)) * 1e-3
    return lambda time: np.stack([np.interp(time, fine, x), 0.0 * time, 0.0 * time], axis=-1)


def curve(speed: float, lateral_acceleration: float) -> Path:
    """A left turn: within 2 s to its lateral acceleration, or to a radius of 12 m where that is reached first."""
    yaw_rate = min(lateral_acceleration / speed, speed / 12.0) if speed else 0.0
    fine = np.arange(0.0, 2.0 * SECONDS, 1e-3)
    yaw = np.cumsum(yaw_rate * np.clip(fine / 2.0, 0.0, 1.0)) * 1e-3
    x, y = (np.cumsum(speed * direction(yaw)) * 1e-3 for direction in (np.cos, np.sin))
    return lambda time: np.stack([np.interp(time, fine, column) for column in (x, y, yaw)], axis=-1)


def drive(case: Case, parameters: VehicleParameters, method: ControlMethod) -> DrivenCase:
    """Track a case with a vehicle that moves as its own equations say."""
    parameters = replace(parameters, reverse_gear=case.reverse)
    controller = TrackingController(parameters, ControlSettings(method=method, deadline_seconds=case.deadline))
    stepper = VehicleStepper(parameters)
    state = with_rolling_tyres(np.array([0.0, 0.0, 0.0, case.speed, 0.0, 0.0]), parameters)
    errors = np.zeros(round(SECONDS / STEP_SECONDS))
    try:
        for step in range(len(errors)):
            now = step * STEP_SECONDS
            control = controller.control(state, case.plan(now), step * STEP_US)
            stepper.shift(controller.parameters.reverse_gear)
            state = stepper(state, control)
            wanted = case.plan(now, meant=True).at(np.array([(step + 1) * STEP_US]))[0]
            errors[step] = np.linalg.norm(state[:2] - wanted[:2])
    except (PlanRefused, InputError) as refusal:
        return DrivenCase(refused=str(refusal))
    return DrivenCase(errors, controller.counts)


def control_grid() -> Grid:
    """Drive every case in every way."""
    rows: list[dict[str, object]] = []
    summary = [f"extreme cases of {SECONDS:g} s; tracked: within {TRACKED:g} m in the last second"]
    for vehicle, method in WAYS:
        parameters, counts, missed = VEHICLES[vehicle], Counter[str](), []
        for case in cases(parameters.friction):
            driven = drive(case, parameters, method)
            counts[driven.outcome] += 1
            if case.possible and driven.outcome == "off the plan":
                missed.append(f"{case.name} ({driven.last_error:.2f} m)")
            rows.append(
                {
                    "case": case.name,
                    "possible": case.possible,
                    "vehicle": vehicle,
                    "method": method,
                    "outcome": driven.outcome,
                    "largest_error_m": None if driven.refused else float(driven.errors.max()),
                    "last_error_m": None if driven.refused else driven.last_error,
                    "events": asdict(driven.counts),
                    "refused": driven.refused,
                }
            )
        told = ", ".join(f"{counts[word]} {word}" for word in ("tracked", "held", "refused", "off the plan"))
        summary.append(f"{vehicle}, {method}: {told}; could have been tracked: {', '.join(missed) or 'none'}")
    return Grid(rows, summary)
