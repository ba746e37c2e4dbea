"""The kinematic bicycle with lagging actuators, as CasADi equations.

State (6,): x, y (m) and yaw (rad) of the rig in the world, speed of the rear axle (m/s), steering angle of the front
wheel (rad, left positive), acceleration that the drive and the brakes are set to (m/s^2).
Control (2,): commanded steering angle (rad) and acceleration (m/s^2).

The rear axle does not slip, so the rig, whose origin lies under it, moves along its own x axis (Rajamani, Vehicle
Dynamics and Control, 2nd ed., section 2.2, with the reference point on the rear axle):

    x' = v cos(yaw)    y' = v sin(yaw)    yaw' = v tan(steering) / wheelbase

Both actuators follow their commands, cut at the limits, with a first-order lag. There is no tyre model: the equations
hold at every speed from standstill on, but they know no friction limit.

Standstill: brakes stop a vehicle, they do not push it backwards, and there is no reverse. So v' = a when a drives, and
v' = a tanh(v / v_stand) when a brakes: the full braking above about 3 v_stand, none at v = 0, smooth in v. Speed
decays towards 0 from above and never passes it; a held brake keeps a standing vehicle exactly still.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from olt_generator.poses import Array
from olt_toolkit.rig import VehicleDimensions

STATE_SIZE = 6
CONTROL_SIZE = 2


class Index(NamedTuple):
    """Where each quantity stands in a state."""

    x: int = 0
    y: int = 1
    yaw: int = 2
    speed: int = 3
    steering: int = 4
    acceleration: int = 5


STATE = Index()


@dataclass(frozen=True)
class VehicleParameters:
    """What the equations need to know of a vehicle.

    Lags and acceleration limits are AlpaSim's (facts sheet alpasim, section 4). The steering limit is its 45 degrees
    too: on the default wheelbase that is a curvature of 0.35 1/m, just above the 0.33 1/m that a policy can ask for
    (facts sheet alpamayo_interface, section 3), so every plan within the policy's bounds can be steered.

    Attributes:
        wheelbase: metres.
        steering_lag, acceleration_lag: time constants of the actuators, seconds.
        max_steering: largest steering angle to either side, radians.
        min_acceleration, max_acceleration: limits of the acceleration command, m/s^2.
        standing_speed: v_stand of the module's equations, m/s: below about three times this the brakes fade.
    """

    wheelbase: float
    steering_lag: float = 0.1
    acceleration_lag: float = 0.1
    max_steering: float = np.pi / 4
    min_acceleration: float = -8.0
    max_acceleration: float = 6.0
    standing_speed: float = 0.5

    @classmethod
    def from_dimensions(cls, dimensions: VehicleDimensions) -> "VehicleParameters":
        """The parameters of a vehicle of the given size."""
        return cls(wheelbase=dimensions.wheelbase)

    @property
    def control_limits(self) -> Array:
        """Lowest and highest control, (2, 2): rows low and high, columns steering and acceleration."""
        return np.array(
            [[-self.max_steering, self.min_acceleration], [self.max_steering, self.max_acceleration]], dtype=np.float64
        )


@lru_cache(maxsize=32)
def vehicle_equations(parameters: VehicleParameters) -> ca.Function:
    """The right-hand side: a CasADi function of (state, control) that gives the time derivative of the state."""
    state, control = ca.SX.sym("state", STATE_SIZE), ca.SX.sym("control", CONTROL_SIZE)
    yaw, speed, steering, acceleration = ca.vertsplit(state)[STATE.yaw :]
    low, high = parameters.control_limits
    command = ca.fmin(ca.fmax(control, low), high)
    braking, driving = ca.fmin(acceleration, 0.0), ca.fmax(acceleration, 0.0)
    derivative = ca.vertcat(
        speed * ca.cos(yaw),
        speed * ca.sin(yaw),
        speed * ca.tan(steering) / parameters.wheelbase,
        driving + braking * ca.tanh(speed / parameters.standing_speed),
        (command[0] - steering) / parameters.steering_lag,
        (command[1] - acceleration) / parameters.acceleration_lag,
    )
    return ca.Function("vehicle", [state, control], [derivative], ["state", "control"], ["derivative"])


def steering_for(yaw_rate: Array, speed: Array, wheelbase: float) -> Array:
    """Steering angle (n,) that turns at `yaw_rate` (n,) rad/s at `speed` (n,) m/s.

    The curvature is the ridge estimate v w / (v^2 + 0.25): yaw noise of a vehicle that hardly moves asks for no
    steering.
    """
    return np.arctan(wheelbase * speed * yaw_rate / (speed**2 + 0.25))
