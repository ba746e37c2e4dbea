"""One family of planar vehicle models, as CasADi equations: kinematic bicycle, linear tyres, saturating tyres.

States and controls are laid out in `vehicle.state`.

Kinematic: the rear axle does not slip, so the rig, whose origin lies under it, moves along its own x axis (Rajamani,
Vehicle Dynamics and Control, 2nd ed., section 2.2, with the reference point on the rear axle):

    x' = v cos(yaw)    y' = v sin(yaw)    yaw' = v tan(steering) / wheelbase    v' = a

It has no tyres but it has grip: a and v yaw', the acceleration of the rear axle that is asked for along and across, are
scaled by the one factor that brings them within the friction circle (`vehicle.tyres`). Beyond it the vehicle turns less
than it is steered and brakes less than it is asked to.

With tyres: Newton and Euler for the body, with the forces of `vehicle.tyres` in the axes of each wheel (the
same book, section 2.3, without its small angles). Without slip these are the kinematic equations again, plus the
energy that turning takes up, so the family has no seam. The acceleration is a force at both axles in proportion to
their loads; on saturating tyres it shares the friction circle with cornering.

Standstill: brakes stop a vehicle, they do not push it. Driving acts as set; braking acts against the motion and fades
below about two times v_stand as v / (v^4 + v_stand^4)^(1/4). Speed decays towards 0 and never passes it; a held
brake keeps a standing vehicle exactly still. In the reverse gear negative acceleration drives and positive brakes.
"""

from functools import lru_cache
from typing import Any

import casadi as ca

from olt_closed_loop.vehicle.actuators import actuator_rate, clip
from olt_closed_loop.vehicle.parameters import NUMBERS_SIZE, Model, VehicleNumbers, VehicleParameters
from olt_closed_loop.vehicle.state import CONTROL_SIZE, STATE
from olt_closed_loop.vehicle.tyres import GRAVITY, friction_share, inverse_speed, linear_force


def step_symbols(state_size: int) -> tuple[Any, Any, Any, Any]:
    """Symbols of a step: state, control, numbers of the vehicle in the order of `VehicleNumbers`, length in seconds."""
    sizes = {"state": state_size, "control": CONTROL_SIZE, "numbers": NUMBERS_SIZE, "step": 1}
    state, control, numbers, step = (ca.SX.sym(name, size) for name, size in sizes.items())
    return state, control, numbers, step


@lru_cache(maxsize=32)
def vehicle_equations(parameters: VehicleParameters) -> ca.Function:
    """The right-hand side: a CasADi function of (state, control) that gives the time derivative of the state."""
    state, control = ca.SX.sym("state", parameters.state_size), ca.SX.sym("control", CONTROL_SIZE)
    numbers = VehicleNumbers(*parameters.numbers)
    derivative = state_derivative(parameters.model, state, control, numbers)
    return ca.Function("vehicle", [state, control], [derivative], ["state", "control"], ["derivative"])


def state_derivative(model: Model, state: Any, control: Any, vehicle: VehicleNumbers) -> Any:
    """Time derivative of a state, the lags of the actuators included."""
    steering, acceleration = state[STATE.steering], state[STATE.acceleration]
    steering_command, acceleration_command = limited_commands(control, vehicle)
    moving = motion_derivative(model, motion_of(state), steering, acceleration, vehicle)
    return ca.vertcat(
        moving[: STATE.steering],
        actuator_rate(steering, steering_command, vehicle.steering_lag, vehicle.max_steering_rate),
        actuator_rate(acceleration, acceleration_command, vehicle.acceleration_lag, vehicle.max_jerk),
        moving[STATE.steering :],
    )


def limited_commands(control: Any, vehicle: VehicleNumbers) -> tuple[Any, Any]:
    """Commanded steering and acceleration, cut at their limits."""
    steering = clip(control[0], -vehicle.max_steering, vehicle.max_steering)
    return steering, clip(control[1], vehicle.min_acceleration, vehicle.max_acceleration)


def within_limits(state: Any, vehicle: VehicleNumbers) -> Any:
    """The state with its actuators cut at the limits of their commands: none stands beyond them."""
    actuators = limited_commands(state[STATE.steering : STATE.lateral_speed], vehicle)
    return ca.vertcat(state[: STATE.steering], *actuators, state[STATE.lateral_speed :])


def motion_of(state: Any) -> Any:
    """The part of a state that is not an actuator: x, y, yaw, speed and, with tyres, lateral speed and yaw rate."""
    return ca.vertcat(state[: STATE.steering], state[STATE.lateral_speed :])


def motion_derivative(model: Model, motion: Any, steering: Any, acceleration: Any, vehicle: VehicleNumbers) -> Any:
    """Time derivative of `motion_of` a state, the actuators being where they are."""
    yaw, speed = motion[STATE.yaw], motion[STATE.speed]
    driving = ca.fmax(vehicle.gear * acceleration, 0.0)
    braking = ca.fmax(-vehicle.gear * acceleration, 0.0)
    pull = vehicle.gear * driving - braking * speed * inverse_speed(speed, vehicle.standing_speed)
    if model == "kinematic":
        yaw_rate = speed * ca.tan(steering) / vehicle.wheelbase
        given = friction_share(pull, speed * yaw_rate, vehicle.friction * GRAVITY)
        return ca.vertcat(speed * ca.cos(yaw), speed * ca.sin(yaw), given * yaw_rate, given * pull)
    lateral_speed, yaw_rate = motion[4], motion[5]
    velocity = ca.vertcat(
        speed * ca.cos(yaw) - lateral_speed * ca.sin(yaw), speed * ca.sin(yaw) + lateral_speed * ca.cos(yaw)
    )
    forward, sideways, turning = _body_accelerations(model, speed, lateral_speed, yaw_rate, steering, pull, vehicle)
    return ca.vertcat(velocity, yaw_rate, forward, sideways, turning)


def _body_accelerations(
    model: Model, speed: Any, lateral_speed: Any, yaw_rate: Any, steering: Any, pull: Any, vehicle: VehicleNumbers
) -> tuple[Any, Any, Any]:
    """Time derivatives of speed, of the rear axle's lateral speed, and of the yaw rate."""
    to_front, to_rear = vehicle.front_axle_to_centre, vehicle.rear_axle_to_centre
    front_share, rear_share = to_rear / vehicle.wheelbase, to_front / vehicle.wheelbase
    cos, sin = ca.cos(steering), ca.sin(steering)
    front_lateral = lateral_speed + vehicle.wheelbase * yaw_rate
    rolling, slipping = speed * cos + front_lateral * sin, front_lateral * cos - speed * sin
    front_along, rear_along = vehicle.mass * pull * front_share, vehicle.mass * pull * rear_share
    front_across = linear_force(vehicle.front_stiffness, slipping, rolling, vehicle.slip_speed)
    rear_across = linear_force(vehicle.rear_stiffness, lateral_speed, speed, vehicle.slip_speed)
    if model == "saturating":
        grip = vehicle.friction * vehicle.mass * GRAVITY
        front = friction_share(front_along, front_across, grip * front_share)
        rear = friction_share(rear_along, rear_across, grip * rear_share)
        front_along, front_across = front * front_along, front * front_across
        rear_along, rear_across = rear * rear_along, rear * rear_across
    force_x = front_along * cos - front_across * sin + rear_along
    front_y = front_along * sin + front_across * cos
    turning = (to_front * front_y - to_rear * rear_across) / vehicle.yaw_inertia
    centre_lateral = lateral_speed + to_rear * yaw_rate
    forward = force_x / vehicle.mass + centre_lateral * yaw_rate
    sideways = (front_y + rear_across) / vehicle.mass - speed * yaw_rate - to_rear * turning
    return forward, sideways, turning
