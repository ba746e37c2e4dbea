"""Tracking control: how far each way of control is from AlpaSim's references, and what its solves cost."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from olt_closed_loop.benchmarks.alpasim_vehicle import REAR_TO_GRAVITY, alpasim_vehicle, drive_step
from olt_closed_loop.benchmarks.control_extremes import control_grid
from olt_closed_loop.benchmarks.control_references import Reference, alpasim_references
from olt_closed_loop.benchmarks.noisy_plans import smoothing_rows, told
from olt_closed_loop.control.tracking import ControlSettings, TrackingController
from olt_closed_loop.vehicle.parameters import VehicleParameters
from olt_generator.poses import Array
from olt_toolkit.bench.benchmark import Benchmark, Grid, Setting
from olt_toolkit.policy.contract import STEP_SECONDS, STEP_US
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

STEPS = 100
TIMED_DRIVES = (9, 27, 45, 63)
"""Of the 70 different drives: a straight, a circle, a turn of changing speed, a stop. 400 calls are timed."""
KINEMATIC = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)
WITH_TYRES = alpasim_vehicle()


@dataclass(frozen=True)
class Tracking:
    """How a set of drives went.

    Attributes:
        errors: (drives, 100) distances in metres of the rig to its reference at the end of every step.
        copies: (drives,) how often each counts.
        seen: (100, drives, states) states that the controllers were given.
        seconds: (100, drives) what each call took: CPU time, as another process on the machine is no part of it.
        failed: solves without a solution.
    """

    errors: Array
    copies: Array
    seen: Array
    seconds: Array
    failed: int

    @property
    def rms(self) -> float:
        """Root mean square of the errors over all copies, metres."""
        return float(np.sqrt(np.average(np.square(self.errors).mean(axis=1), weights=self.copies)))


def track(references: Sequence[Reference], parameters: VehicleParameters, settings: ControlSettings) -> Tracking:
    """Drive AlpaSim's vehicle along references with controllers that take it for one of `parameters`."""
    controllers = [TrackingController(parameters, settings) for _ in references]
    states = np.zeros((len(references), 8))
    states[:, 3] = [reference.speed for reference in references]
    errors, seen, seconds = np.zeros((len(references), STEPS)), [], np.zeros((STEPS, len(references)))
    for step in range(STEPS):
        # AlpaSim's states in the order of `vehicle.state`, as many numbers as the controller's vehicle has.
        x, y, yaw, forward, left, yaw_rate, steering, acceleration = states.T
        rear_left = left - REAR_TO_GRAVITY * yaw_rate
        ordered = [x, y, yaw, forward, steering, acceleration, rear_left, yaw_rate]
        seen.append(np.stack(ordered[: parameters.state_size], axis=-1))
        controls = np.zeros((len(references), 2))
        for row, (reference, controller) in enumerate(zip(references, controllers, strict=True)):
            plan, began = reference.plan(step), time.thread_time()
            controls[row] = controller.control(seen[-1][row], plan, step * STEP_US)
            seconds[step, row] = time.thread_time() - began
        states = drive_step(states, controls, STEP_SECONDS)
        wanted = np.stack([reference.poses[step + 1] for reference in references])
        errors[:, step] = np.linalg.norm(states[:, :2] - wanted[:, :2], axis=1)
    copies = np.array([reference.copies for reference in references], dtype=np.float64)
    failed = sum(controller.counts.failed for controller in controllers)
    return Tracking(errors, copies, np.stack(seen), seconds, failed)


DEFAULT = "linear MPC, 1 s ahead"
WAYS: dict[str, tuple[VehicleParameters, ControlSettings]] = {
    "LQR, 1 s ahead": (WITH_TYRES, ControlSettings(method="lqr")),
    "linear MPC, 0.5 s ahead": (WITH_TYRES, ControlSettings(horizon=5)),
    DEFAULT: (WITH_TYRES, ControlSettings()),
    "linear MPC, 2 s ahead": (WITH_TYRES, ControlSettings(horizon=20)),
    "linear MPC, 4 s ahead": (WITH_TYRES, ControlSettings(horizon=40)),
    "linear MPC, 1 s, 3 rounds": (WITH_TYRES, ControlSettings(rounds=3)),
    "linear MPC, 1 s, blind to tyres": (KINEMATIC, ControlSettings()),
    "nonlinear MPC, 1 s ahead": (WITH_TYRES, ControlSettings(method="nonlinear")),
}


def _prepare(parameters: VehicleParameters, settings: ControlSettings) -> Callable[[], Tracking]:
    """All drives, once; the call that is timed makes the solves of some again, from what was seen there."""
    references = list(alpasim_references())
    tracking = track(references, parameters, settings)

    def solve_again() -> Tracking:
        for row in TIMED_DRIVES:
            controller = TrackingController(parameters, settings)
            for step in range(STEPS):
                controller.control(tracking.seen[step, row], references[row].plan(step), step * STEP_US)
        return tracking

    return solve_again


def tracking_figures(tracking: Tracking) -> dict[str, float]:
    """The largest position error, and the CPU time of a call over all of the 70 drives."""
    median, slow = np.quantile(1e3 * tracking.seconds, (0.5, 0.99))
    return {
        "largest error (m)": float(tracking.errors.max()),
        "call, median (ms)": float(median),
        "call, p99 (ms)": float(slow),
        "failed solves": tracking.failed,
    }


def extremes_and_noise() -> Grid:
    """The extreme cases, and what smoothing does to noisy plans."""
    extremes, smoothings = control_grid(), smoothing_rows()
    return Grid([*extremes.rows, *smoothings], [*extremes.summary, *map(told, smoothings)])


BENCHMARK = Benchmark(
    title="Tracking of AlpaSim's 120 references of 10 s on AlpaSim's vehicle; time of 400 calls",
    error_name="position error, rms",
    error_unit="m",
    reference="the references themselves; the vehicle is AlpaSim's, written a second time in numpy",
    settings=lambda: [Setting(name, partial(_prepare, *way), name == DEFAULT) for name, way in WAYS.items()],
    measure_error=lambda tracking: tracking.rms,
    figures=tracking_figures,
    grid=extremes_and_noise,
)
