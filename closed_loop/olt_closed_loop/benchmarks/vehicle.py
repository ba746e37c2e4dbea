"""Vehicle integration: how far each integrator is from the exact motion, and what a step of it costs."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from scipy.integrate import solve_ivp

from olt_closed_loop.integrators import DEFAULT_METHOD, DEFAULT_SUBSTEPS, Method, make_stepper
from olt_closed_loop.vehicle import STATE, VehicleParameters
from olt_generator.poses import Array
from olt_toolkit.benchmark import Benchmark, Setting
from olt_toolkit.rig import DEFAULT_VEHICLE

STEP = 0.1
STEPS = 20
PARAMETERS = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)

_INTEGRATORS: dict[str, tuple[Method, int]] = {
    "Euler 10 ms": ("euler", 10),
    "midpoint 10 ms": ("midpoint", 10),
    "RK4 100 ms": ("rk4", 1),
    "RK4 50 ms": ("rk4", 2),
    "RK4 25 ms": ("rk4", 4),
    "RK4 10 ms": ("rk4", 10),
    "CVODES 1e-10": ("cvodes", 1),
}


def manoeuvres() -> tuple[Array, Array]:
    """First states (n, 6) and held controls (n, 20, 2) of the grid: steering steps, braking, slalom, moving off."""
    time = STEP * np.arange(STEPS)
    rows: list[tuple[float, Array, Array]] = [
        (speed, np.full(STEPS, 0.3), np.zeros(STEPS)) for speed in (10.0, 20.0, 30.0, 40.0)
    ]
    rows.append((10.0, np.full(STEPS, 0.1), np.full(STEPS, -8.0)))
    rows.append((15.0, 0.1 * np.sin(np.pi * time), np.zeros(STEPS)))
    rows.append((0.0, np.full(STEPS, 0.2), np.full(STEPS, 3.0)))
    states = np.zeros((len(rows), 6))
    states[:, STATE.speed] = [speed for speed, _, _ in rows]
    return states, np.stack([np.stack([steering, acceleration], axis=-1) for _, steering, acceleration in rows])


def exact_derivative(_time: float, state: Array, control: Array) -> Array:
    """The equations of `olt_closed_loop.vehicle`, written a second time without CasADi."""
    _x, _y, yaw, speed, steering, acceleration = state
    command = np.clip(control, *PARAMETERS.control_limits)
    fade = np.tanh(speed / PARAMETERS.standing_speed) if acceleration < 0.0 else 1.0
    return np.array(
        [
            speed * np.cos(yaw),
            speed * np.sin(yaw),
            speed * np.tan(steering) / PARAMETERS.wheelbase,
            acceleration * fade,
            (command[0] - steering) / PARAMETERS.steering_lag,
            (command[1] - acceleration) / PARAMETERS.acceleration_lag,
        ]
    )


@lru_cache(maxsize=1)
def reference_positions() -> Array:
    """Positions (n, 20, 2) after every step, by DOP853 at 1e-12, started anew where the control changes."""
    states, controls = manoeuvres()
    positions = np.zeros((*controls.shape[:2], 2))
    for row, (state, held) in enumerate(zip(states, controls, strict=True)):
        for index, control in enumerate(held):
            solution = solve_ivp(
                exact_derivative, (0.0, STEP), state, method="DOP853", rtol=1e-12, atol=1e-12, args=(control,)
            )
            state = solution.y[:, -1]
            positions[row, index] = state[:2]
    return positions


def _prepare(method: Method, substeps: int) -> Callable[[], Array]:
    states, controls = manoeuvres()
    stepper = make_stepper(PARAMETERS, method, substeps, STEP)

    def drive() -> Array:
        positions = np.zeros((*controls.shape[:2], 2))
        for row, (state, held) in enumerate(zip(states, controls, strict=True)):
            for index, control in enumerate(held):
                state = stepper(state, control)
                positions[row, index] = state[:2]
        return positions

    return drive


def _settings() -> Sequence[Setting]:
    default = (DEFAULT_METHOD, DEFAULT_SUBSTEPS)
    return [
        Setting(name, lambda choice=choice: _prepare(*choice), default=choice == default)
        for name, choice in _INTEGRATORS.items()
    ]


def _measure_error(positions: Array) -> float:
    return float(np.linalg.norm(positions - reference_positions(), axis=-1).max())


BENCHMARK = Benchmark(
    name="vehicle",
    title="Kinematic bicycle, 140 steps of 0.1 s: 7 manoeuvres of 2 s",
    error_name="largest position error",
    error_unit="m",
    reference="the same equations written in numpy, integrated by DOP853 (scipy) at tolerance 1e-12",
    settings=_settings,
    measure_error=_measure_error,
)
