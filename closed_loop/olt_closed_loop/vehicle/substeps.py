"""Explicit sub-steps of the vehicle models: the midpoint rule and the classical Runge-Kutta method of fourth order.

Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.1. The actuators are not integrated:
their closed form gives steering and acceleration wherever the equations are evaluated (`vehicle.actuators`).
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Literal

import casadi as ca

from olt_closed_loop.vehicle.actuators import actuator_after
from olt_closed_loop.vehicle.models import limited_commands, motion_derivative, motion_of, step_symbols, within_limits
from olt_closed_loop.vehicle.parameters import Model, VehicleNumbers, model_state_size
from olt_closed_loop.vehicle.state import STATE

ExplicitMethod = Literal["midpoint", "rk4"]
EXPLICIT_METHODS: tuple[ExplicitMethod, ...] = ("midpoint", "rk4")
EVALUATIONS: dict[ExplicitMethod, int] = {"midpoint": 2, "rk4": 4}
"""Of the equations, in one sub-step."""


Slope = Callable[[Any, float], Any]
"""(motion, share of the sub-step that has passed) -> derivative of the motion."""


def midpoint(slope: Slope, motion: Any, length: Any) -> Any:
    """The motion after a sub-step of the midpoint rule."""
    return motion + length * slope(motion + 0.5 * length * slope(motion, 0.0), 0.5)


def rk4(slope: Slope, motion: Any, length: Any) -> Any:
    """The motion after a sub-step of the classical Runge-Kutta method."""
    k1 = slope(motion, 0.0)
    k2 = slope(motion + 0.5 * length * k1, 0.5)
    k3 = slope(motion + 0.5 * length * k2, 0.5)
    k4 = slope(motion + length * k3, 1.0)
    return motion + length / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@lru_cache(maxsize=32)
def substep_function(model: Model, method: ExplicitMethod, state_size: int) -> ca.Function:
    """(state, control, numbers of the vehicle, length in seconds) -> state after one sub-step.

    A state larger than the model's is one of a model with tyres: its last two entries come out as those of tyres that
    roll without slip.
    """
    full, control, numbers, length = step_symbols(state_size)
    vehicle = VehicleNumbers(*ca.vertsplit(numbers))
    state = within_limits(full[: model_state_size(model)], vehicle)
    steering, acceleration = limited_commands(control, vehicle)

    def actuators(time: Any) -> tuple[Any, Any]:
        return (
            actuator_after(time, state[STATE.steering], steering, vehicle.steering_lag, vehicle.max_steering_rate),
            actuator_after(time, state[STATE.acceleration], acceleration, vehicle.acceleration_lag, vehicle.max_jerk),
        )

    held = {share: actuators(share * length) for share in (0.5, 1.0)}
    held[0.0] = state[STATE.steering], state[STATE.acceleration]
    motion = {"midpoint": midpoint, "rk4": rk4}[method](
        lambda motion, share: motion_derivative(model, motion, *held[share], vehicle), motion_of(state), length
    )
    following = ca.vertcat(motion[: STATE.steering], *held[1.0], motion[STATE.steering :])
    if following.numel() < state_size:
        yaw_rate = following[STATE.speed] * ca.tan(following[STATE.steering]) / vehicle.wheelbase
        following = ca.vertcat(following, 0.0, yaw_rate)
    return ca.Function(f"{model}_{method}", [full, control, numbers, length], [ca.densify(ca.cse(following))])
