"""Vehicle integration: how far each integrator is from the exact motion, and what a step of it costs."""

import time
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from olt_closed_loop.benchmarks.alpasim_vehicle import alpasim_vehicle
from olt_closed_loop.benchmarks.vehicle_grid import vehicle_grid
from olt_closed_loop.vehicle.integrators import Method, VehicleStepper
from olt_closed_loop.vehicle.parameters import DRY_FRICTION, MODELS, Model, VehicleParameters, with_rolling_tyres
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import Array
from olt_toolkit.bench.benchmark import Benchmark, Setting
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

HOLD = 0.2
"""Seconds for which a control is held, and after which positions are compared."""
HOLDS = 10
BATCH = 200
"""Vehicles of the batch whose steps are timed too."""
VEHICLES: dict[Model, VehicleParameters] = {
    "kinematic": VehicleParameters.from_dimensions(DEFAULT_VEHICLE),
    "linear": alpasim_vehicle(),
    "saturating": alpasim_vehicle(DRY_FRICTION),
}


class Integration(NamedTuple):
    """A way of integrating that the benchmark measures."""

    model: Model
    method: Method
    substeps: int | None
    step: float

    @property
    def name(self) -> str:
        """What it is called in the table."""
        substeps = "" if self.substeps is None else f" x {self.substeps}"
        return f"{self.model}, {self.method}{substeps}, step {1e3 * self.step:g} ms"


def integrations() -> Iterator[Integration]:
    """Everything that is measured."""
    for model in MODELS:
        for step in (0.02, 0.1, 0.2):
            yield Integration(model, "auto", None, step)
        for substeps in (None, 4, 10):
            yield Integration(model, "rk4", substeps, 0.1)
        yield Integration(model, "midpoint", 40, 0.1)
        yield Integration(model, "radau", 4, 0.1)
        yield Integration(model, "cvodes", None, 0.1)


def manoeuvres(model: Model) -> tuple[Array, Array]:
    """First states (n, s) and held controls (n, 10, 2): steering steps, braking in a bend, slalom, moving off."""
    times = HOLD * np.arange(HOLDS)
    rows: list[tuple[float, Array, Array]] = [
        (speed, np.full(HOLDS, 0.3), np.zeros(HOLDS)) for speed in (10.0, 20.0, 30.0, 40.0)
    ]
    rows.append((10.0, np.full(HOLDS, 0.1), np.full(HOLDS, -8.0)))
    rows.append((15.0, 0.1 * np.sin(np.pi * times), np.zeros(HOLDS)))
    rows.append((0.0, np.full(HOLDS, 0.2), np.full(HOLDS, 3.0)))
    states = np.zeros((len(rows), 6))
    states[:, STATE.speed] = [speed for speed, _, _ in rows]
    controls = np.stack([np.stack([steering, acceleration], axis=-1) for _, steering, acceleration in rows])
    return with_rolling_tyres(states, VEHICLES[model]), controls


def prepare_drive(integration: Integration) -> Callable[[], Array]:
    """The call that gives positions (n, 10, 2) after every hold, metres."""
    stepper = VehicleStepper(VEHICLES[integration.model], integration.method, integration.substeps, integration.step)
    return partial(_positions, stepper, *manoeuvres(integration.model), round(HOLD / integration.step))


def _positions(stepper: Callable[[Array, Array], Array], states: Array, controls: Array, steps: int) -> Array:
    positions = np.zeros((*controls.shape[:2], 2))
    for row, (state, held) in enumerate(zip(states, controls, strict=True)):
        for index, control in enumerate(held):
            for _ in range(steps):
                state = stepper(state, control)
            positions[row, index] = state[:2]
    return positions


@lru_cache(maxsize=3)
def reference_positions(model: Model) -> Array:
    """Positions (n, 10, 2) after every hold, by DOP853 at 1e-12, started anew where the control changes."""

    def advance(state: Array, control: Array) -> Array:
        arguments = (control, VEHICLES[model])
        solved = solve_ivp(exact_derivative, (0.0, HOLD), state, "DOP853", rtol=1e-12, atol=1e-12, args=arguments)
        return solved.y[:, -1]

    return _positions(advance, *manoeuvres(model), 1)


def exact_derivative(_time: float, state: Array, control: Array, vehicle: VehicleParameters) -> Array:
    """The equations of `vehicle.models` for a state (s,) in the forward gear, written a second time without CasADi."""
    yaw, speed, steering, acceleration = state[2:6]
    actuators = np.clip(control, *vehicle.control_limits) - state[4:6]
    actuators /= vehicle.steering_lag, vehicle.acceleration_lag
    actuators = np.clip(actuators, *np.outer([-1.0, 1.0], [vehicle.max_steering_rate, vehicle.max_jerk]))
    pull = acceleration * (speed / (speed**4 + vehicle.standing_speed**4) ** 0.25 if acceleration < 0.0 else 1.0)
    if vehicle.tyres is None:
        yaw_rate = speed * np.tan(steering) / vehicle.wheelbase
        given = 1.0 / (1.0 + (np.hypot(pull, speed * yaw_rate) / (9.81 * vehicle.friction)) ** 4) ** 0.25
        return np.array([speed * np.cos(yaw), speed * np.sin(yaw), given * yaw_rate, given * pull, *actuators])
    lateral, yaw_rate = state[6:8]
    body = _body_derivative(vehicle, np.array([speed, lateral]), yaw_rate, steering, pull)
    velocity = _rotation(yaw) @ [speed, lateral]
    return np.array([*velocity, yaw_rate, body[0], *actuators, body[1], body[2]])


def _body_derivative(
    vehicle: VehicleParameters, velocity: Array, yaw_rate: float, steering: float, pull: float
) -> Array:
    """Derivatives of the rear axle's velocity in the body's axes and of the yaw rate, from the forces of both axles."""
    tyres = vehicle.tyres
    assert tyres is not None
    places = np.array([vehicle.wheelbase - tyres.rear_axle_to_centre, -tyres.rear_axle_to_centre])
    force, torque = np.zeros(2), 0.0
    for place, angle, stiffness in zip(
        places, (steering, 0.0), (tyres.front_stiffness, tyres.rear_stiffness), strict=True
    ):
        load_share = (vehicle.wheelbase - abs(place)) / vehicle.wheelbase
        wheel = _rotation(-angle) @ (velocity + np.array([0.0, yaw_rate * (place - places[1])]))
        slip = wheel[1] / (wheel[0] ** 4 + tyres.slip_speed**4) ** 0.25
        asked = np.array([tyres.mass * pull * load_share, -stiffness * slip])
        ratio = np.linalg.norm(asked) / (vehicle.friction * tyres.mass * 9.81 * load_share)
        given = _rotation(angle) @ asked / (1.0 + ratio**4) ** 0.25
        force += given
        torque += place * given[1]
    yaw_acceleration = torque / tyres.yaw_inertia
    # Of the rear axle: the centre's acceleration, moved back by a rigid body and seen in turning axes.
    forward = force[0] / tyres.mass + yaw_rate**2 * tyres.rear_axle_to_centre + yaw_rate * velocity[1]
    sideways = force[1] / tyres.mass - yaw_acceleration * tyres.rear_axle_to_centre - yaw_rate * velocity[0]
    return np.array([forward, sideways, yaw_acceleration])


def _rotation(angle: float) -> Array:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def batch_microseconds(integration: Integration) -> float:
    """Median CPU time of a step for each vehicle of a batch, all under a steering step of 0.3 rad at 20 m/s."""
    vehicle = VEHICLES[integration.model]
    stepper = VehicleStepper([vehicle] * BATCH, integration.method, integration.substeps, integration.step)
    states = with_rolling_tyres(np.tile([0.0, 0.0, 0.0, 20.0, 0.0, 0.0], (BATCH, 1)), vehicle)
    controls = np.tile([0.3, 0.0], (BATCH, 1))
    seconds = []
    for _ in range(HOLDS):
        began = time.thread_time()
        states = stepper(states, controls)
        seconds.append(time.thread_time() - began)
    return 1e6 * float(np.median(seconds)) / BATCH


def _prepare(integration: Integration) -> Callable[[], tuple[Model, Array, float]]:
    call, batch = prepare_drive(integration), batch_microseconds(integration)
    return lambda: (integration.model, call(), batch)


def _measure_error(result: tuple[Model, Array, float]) -> float:
    model, positions, _ = result
    return float(np.linalg.norm(positions - reference_positions(model), axis=-1).max())


DEFAULT = Integration("kinematic", "auto", None, 0.1)
BENCHMARK = Benchmark(
    title="Vehicle models, 7 manoeuvres of 2 s: 140 steps of 0.1 s",
    error_name="largest position error",
    error_unit="m",
    reference="the same equations written in numpy, integrated by DOP853 (scipy) at tolerance 1e-12",
    settings=lambda: [Setting(each.name, partial(_prepare, each), default=each == DEFAULT) for each in integrations()],
    measure_error=_measure_error,
    figures=lambda result: {"batch (us a step)": result[2]},
    grid=vehicle_grid,
)
