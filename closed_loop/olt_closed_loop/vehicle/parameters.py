"""The numbers of a vehicle: of the kinematic bicycle, of what tyres add to it, and of AlpaSim's car at any size."""

from collections import namedtuple
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from olt_closed_loop.vehicle.state import STATE, STATE_SIZE, TYRE_STATE_SIZE
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, VehicleDimensions

DRY_FRICTION = 1.0
"""Of a dry road. The tyres of CommonRoad's vehicle models have 1.05 across and 1.17 along; this stays below both."""
STEERING_RATE = 0.4
"""Of a car's front wheel, rad/s: the limit of all three cars of CommonRoad's vehicle models."""

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
        slip_speed: v_slip of `vehicle.tyres`, m/s.
    """

    mass: float
    yaw_inertia: float
    rear_axle_to_centre: float
    front_stiffness: float
    rear_stiffness: float
    slip_speed: float = 3.0


@dataclass(frozen=True)
class VehicleParameters:
    """What the equations need to know of a vehicle; `vehicle_with_tyres` makes those with tyres.

    Lags and acceleration limits are AlpaSim's (docs/formats/alpasim.md). The steering limit is its 45 degrees
    too: on the default wheelbase that is a curvature of 0.35 1/m, just above the 0.33 1/m that a policy can ask for
    (docs/formats/alpamayo.md), so every plan within the policy's bounds can be steered. Grip and steering rate, which
    AlpaSim does not limit, are those of CommonRoad's vehicle models (Althoff, Koschi, Manzinger, IV 2017; vehicle
    models 2020a, appendix of parameters).

    Attributes:
        wheelbase: metres.
        steering_lag, acceleration_lag: time constants of the actuators, seconds.
        max_steering: largest steering angle to either side, radians.
        min_acceleration, max_acceleration: limits of the acceleration command, m/s^2; the reverse gear swaps them.
        standing_speed: v_stand of `vehicle.models`, m/s.
        friction: between tyres and road, the radius of the friction circle over the load; infinite for none.
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
    friction: float = DRY_FRICTION
    max_steering_rate: float = STEERING_RATE
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
        return "saturating" if np.isfinite(self.friction) else "linear"

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
        """The parameters (`NUMBERS_SIZE`,) in the order of `VehicleNumbers`, SI units; those of absent tyres are 1."""
        (_, low), (_, high) = self.control_limits
        tyres = self.tyres or TyreParameters(*np.ones(6))
        return np.array(
            [
                *(self.wheelbase, self.steering_lag, self.acceleration_lag, self.max_steering, low, high),
                *(self.standing_speed, self.friction, self.max_steering_rate, self.max_jerk),
                -1.0 if self.reverse_gear else 1.0,
                *(tyres.mass, tyres.yaw_inertia, tyres.rear_axle_to_centre),
                *(tyres.front_stiffness, tyres.rear_stiffness, tyres.slip_speed),
            ]
        )


class VehicleNumbers(
    namedtuple(
        "VehicleNumbers",
        "wheelbase steering_lag acceleration_lag max_steering min_acceleration max_acceleration standing_speed "
        "friction max_steering_rate max_jerk gear mass yaw_inertia rear_axle_to_centre front_stiffness rear_stiffness "
        "slip_speed",
    )
):
    """The parameters as the equations use them: numbers or CasADi symbols. `gear` is 1 or, in reverse, -1."""

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


def on_the_brake(states: Array, parameters: VehicleParameters) -> Array:
    """States (..., s) as a shift of gear leaves them: what was set, drive or brake, is brake of the new gear."""
    shifted = states.copy()
    shifted[..., STATE.acceleration] = np.abs(states[..., STATE.acceleration])
    if not parameters.reverse_gear:
        shifted[..., STATE.acceleration] *= -1.0
    return shifted


def vehicle_with_tyres(dimensions: VehicleDimensions, friction: float = DRY_FRICTION) -> VehicleParameters:
    """AlpaSim's car (docs/formats/alpasim.md) scaled to a box; with infinite friction its tyres are linear.

    Mass goes with the volume of the box, the inertia with mass times (length^2 + width^2), the centre of gravity with
    the wheelbase, and each axle's cornering stiffness with its load.
    """
    box = DEFAULT_VEHICLE
    heavier = (dimensions.length * dimensions.width * dimensions.height) / (box.length * box.width * box.height)
    wider = (dimensions.length**2 + dimensions.width**2) / (box.length**2 + box.width**2)
    tyres = TyreParameters(
        mass=2014.4 * heavier,
        yaw_inertia=3414.2 * heavier * wider,
        rear_axle_to_centre=1.59 * dimensions.wheelbase / box.wheelbase,
        # The source gives the stiffness of one tyre, of which an axle has two.
        front_stiffness=2 * 93534.5 * heavier,
        rear_stiffness=2 * 176162.1 * heavier,
    )
    return replace(VehicleParameters.from_dimensions(dimensions), friction=friction, tyres=tyres)
