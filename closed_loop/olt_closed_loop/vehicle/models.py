"""One family of planar vehicle models, as CasADi equations: kinematic bicycle, linear tyres, saturating tyres.

States and controls are laid out in `vehicle.state`.

Kinematic: the rear axle does not slip, so the rig, whose origin lies under it, moves along its own x axis (Rajamani,
Vehicle Dynamics and Control, 2nd ed., section 2.2, with the reference point on the rear axle):

    x' = v cos(yaw)    y' = v sin(yaw)    yaw' = v tan(steering) / wheelbase    v' = a

With tyres: Newton and Euler for the body, with the forces of `vehicle.tyres` in the axes of each wheel (the
same book, section 2.3, without its small angles). Without slip these are the kinematic equations again, plus the
energy that turning takes up, so the family has no seam. The acceleration is a force at both axles in proportion to
their loads; on saturating tyres it shares the friction circle with cornering.

Standstill: brakes stop a vehicle, they do not push it. Driving acts as set; braking acts against the motion and fades
below about two times v_stand as v / (v^4 + v_stand^4)^(1/4). Speed decays towards 0 and never passes it; a held
brake keeps a standing vehicle exactly still. In the reverse gear negative acceleration drives and positive brakes.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from olt_closed_loop.vehicle.actuators import actuator_rate, clip
from olt_closed_loop.vehicle.state import CONTROL_SIZE, STATE, STATE_SIZE, TYRE_STATE_SIZE
from olt_closed_loop.vehicle.tyres import GRAVITY, friction_share, inverse_speed, linear_force
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import VehicleDimensions

Model = Literal["kinematic", "linear", "saturating"]
MODELS: tuple[Model, ...] = ("kinematic", "linear", "saturating")


@dataclass(frozen=True)
class TyreParameters:
    """What tyres and body add to the kinematic bicycle.

    Attributes:
        mass: kg.
        yaw_inertia: about the centre of gravity, kg m^2.
        rear_axle_to_centre: from the rear axle forward to the centre of gravity, metres.
        front_stiffness, rear_stiffness: cornering stiffness of a whole axle, N/rad.
        friction: between tyres and road; infinite for linear tyres.
        slip_speed: v_slip of `vehicle.tyres`, m/s.
    """

    mass: float
    yaw_inertia: float
    rear_axle_to_centre: float
    front_stiffness: float
    rear_stiffness: float
    friction: float = np.inf
    slip_speed: float = 3.0


@dataclass(frozen=True)
class VehicleParameters:
    """What the equations need to know of a vehicle; `vehicle.presets` makes those with tyres.

    Lags and acceleration limits are AlpaSim's (docs/formats/alpasim.md). The steering limit is its 45 degrees
    too: on the default wheelbase that is a curvature of 0.35 1/m, just above the 0.33 1/m that a policy can ask for
    (docs/formats/alpamayo.md), so every plan within the policy's bounds can be steered.

    Attributes:
        wheelbase: metres.
        steering_lag, acceleration_lag: time constants of the actuators, seconds.
        max_steering: largest steering angle to either side, radians.
        min_acceleration, max_acceleration: limits of the acceleration command, m/s^2; the reverse gear swaps them.
        standing_speed: v_stand of the module's equations, m/s.
        max_steering_rate: of the front wheel, rad/s.
        max_jerk: of the set acceleration, m/s^3.
        reverse_gear: whether negative acceleration drives and positive brakes.
        tyres: None for the kinematic model.
    """

    wheelbase: float
    steering_lag: float = 0.1
    acceleration_lag: float = 0.1
    max_steering: float = np.pi / 4
    min_acceleration: float = -8.0
    max_acceleration: float = 6.0
    standing_speed: float = 0.5
    max_steering_rate: float = np.inf
    max_jerk: float = np.inf
    reverse_gear: bool = False
    tyres: TyreParameters | None = None

    @classmethod
    def from_dimensions(cls, dimensions: VehicleDimensions) -> "VehicleParameters":
        """The kinematic parameters of a vehicle of the given size."""
        return cls(wheelbase=dimensions.wheelbase)

    @property
    def model(self) -> Model:
        """The member of the family that these parameters describe."""
        if self.tyres is None:
            return "kinematic"
        return "saturating" if np.isfinite(self.tyres.friction) else "linear"

    @property
    def state_size(self) -> int:
        """How many numbers a state of this vehicle has."""
        return model_state_size(self.model)

    @property
    def control_limits(self) -> Array:
        """Lowest and highest control, (2, 2): rows low and high, columns steering and acceleration."""
        low, high = self.min_acceleration, self.max_acceleration
        if self.reverse_gear:
            low, high = -high, -low
        return np.array([[-self.max_steering, low], [self.max_steering, high]], dtype=np.float64)

    @property
    def numbers(self) -> Array:
        """The parameters in the order of `VehicleNumbers`; those of absent tyres are 1."""
        (_, low), (_, high) = self.control_limits
        tyres = self.tyres or TyreParameters(*np.ones(7))
        return np.array(
            [
                *(self.wheelbase, self.steering_lag, self.acceleration_lag, self.max_steering, low, high),
                *(self.standing_speed, self.max_steering_rate, self.max_jerk, -1.0 if self.reverse_gear else 1.0),
                *(tyres.mass, tyres.yaw_inertia, tyres.rear_axle_to_centre),
                *(tyres.front_stiffness, tyres.rear_stiffness, tyres.friction, tyres.slip_speed),
            ]
        )


class VehicleNumbers(NamedTuple):
    """The parameters as the equations use them: numbers or CasADi symbols. `gear` is 1 or, in reverse, -1."""

    wheelbase: Any
    steering_lag: Any
    acceleration_lag: Any
    max_steering: Any
    min_acceleration: Any
    max_acceleration: Any
    standing_speed: Any
    max_steering_rate: Any
    max_jerk: Any
    gear: Any
    mass: Any
    yaw_inertia: Any
    rear_axle_to_centre: Any
    front_stiffness: Any
    rear_stiffness: Any
    friction: Any
    slip_speed: Any

    @property
    def front_axle_to_centre(self) -> Any:
        """From the centre of gravity forward to the front axle, metres."""
        return self.wheelbase - self.rear_axle_to_centre


NUMBERS_SIZE = len(VehicleNumbers._fields)


def model_state_size(model: Model) -> int:
    """How many numbers a state of this model has."""
    return STATE_SIZE if model == "kinematic" else TYRE_STATE_SIZE


def with_rolling_tyres(states: Array, parameters: VehicleParameters) -> Array:
    """States (..., 6) continued to the size that `parameters` need, as if no tyre slipped yet."""
    if parameters.tyres is None:
        return states
    yaw_rate = states[..., STATE.speed] * np.tan(states[..., STATE.steering]) / parameters.wheelbase
    return np.concatenate([states, np.zeros_like(yaw_rate)[..., None], yaw_rate[..., None]], axis=-1)


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


def motion_of(state: Any) -> Any:
    """The part of a state that is not an actuator: x, y, yaw, speed and, with tyres, lateral speed and yaw rate."""
    return ca.vertcat(state[: STATE.steering], state[STATE.lateral_speed :])


def motion_derivative(model: Model, motion: Any, steering: Any, acceleration: Any, vehicle: VehicleNumbers) -> Any:
    """Time derivative of `motion_of` a state, the actuators being where they are."""
    yaw, speed = motion[STATE.yaw], motion[STATE.speed]
    pull = _effective_acceleration(speed, acceleration, vehicle)
    if model == "kinematic":
        yaw_rate = speed * ca.tan(steering) / vehicle.wheelbase
        return ca.vertcat(speed * ca.cos(yaw), speed * ca.sin(yaw), yaw_rate, pull)
    lateral_speed, yaw_rate = motion[4], motion[5]
    velocity = ca.vertcat(
        speed * ca.cos(yaw) - lateral_speed * ca.sin(yaw), speed * ca.sin(yaw) + lateral_speed * ca.cos(yaw)
    )
    forward, sideways, turning = _body_accelerations(model, speed, lateral_speed, yaw_rate, steering, pull, vehicle)
    return ca.vertcat(velocity, yaw_rate, forward, sideways, turning)


def _effective_acceleration(speed: Any, acceleration: Any, vehicle: VehicleNumbers) -> Any:
    driving = ca.fmax(vehicle.gear * acceleration, 0.0)
    braking = ca.fmax(-vehicle.gear * acceleration, 0.0)
    return vehicle.gear * driving - braking * speed * inverse_speed(speed, vehicle.standing_speed)


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
