"""AlpaSim's vehicle, written from its description (docs/formats/alpasim.md): what controllers are measured on.

It shares no code with `vehicle.models`, so an error in those equations shows as an error of tracking.
"""

from dataclasses import replace

import numpy as np

from olt_closed_loop.vehicle.parameters import VehicleParameters, vehicle_with_tyres
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

MASS, YAW_INERTIA = 2014.4, 3414.2
WHEELBASE, REAR_TO_GRAVITY = 2.85, 1.59
FRONT_STIFFNESS, REAR_STIFFNESS = 2.0 * 93534.5, 2.0 * 176162.1
"""N/rad of an axle."""
LAG = 0.1
SWITCH_SPEED = 5.0
SUBSTEPS = 10


def alpasim_vehicle(friction: float = np.inf) -> VehicleParameters:
    """The same vehicle for `vehicle.models`: it steers at any rate, on linear tyres unless a friction is given."""
    return replace(vehicle_with_tyres(DEFAULT_VEHICLE, friction), max_steering_rate=np.inf)


def drive_step(state: Array, control: Array, step: float) -> Array:
    """States (n, 8) one step later under controls (n, 2) of steering angle (rad) and acceleration (m/s^2).

    A state is x, y (m) and yaw (rad) of the rig, speed forward and to the left at the centre of gravity (m/s), yaw rate
    (rad/s), steering angle (rad), acceleration (m/s^2). Explicit midpoint rule in steps of a tenth, speed cut at 0.
    """
    length = step / SUBSTEPS
    for _ in range(SUBSTEPS):
        middle = state + 0.5 * length * _derivative(state, control)
        state = state + length * _derivative(middle, control)
        state[:, 3] = np.maximum(state[:, 3], 0.0)
    return state


def _derivative(state: Array, control: Array) -> Array:
    _, _, yaw, forward, left, yaw_rate, steering, acceleration = state.T
    fast, rolling = forward >= SWITCH_SPEED, np.maximum(forward, SWITCH_SPEED)
    # Linear tyres; below the switch speed relaxation towards rolling without slip.
    front_arm = WHEELBASE - REAR_TO_GRAVITY
    front = FRONT_STIFFNESS * (steering - (left + front_arm * yaw_rate) / rolling)
    rear = -REAR_STIFFNESS * (left - REAR_TO_GRAVITY * yaw_rate) / rolling
    slipping = (front + rear) / MASS - rolling * yaw_rate
    yawing = (front_arm * front - REAR_TO_GRAVITY * rear) / YAW_INERTIA
    turning = forward * steering / WHEELBASE
    sideways = np.where(fast, left - REAR_TO_GRAVITY * yaw_rate, 0.0)  # at the rear axle
    return np.stack(
        [
            forward * np.cos(yaw) - sideways * np.sin(yaw),
            forward * np.sin(yaw) + sideways * np.cos(yaw),
            yaw_rate,
            acceleration,
            np.where(fast, slipping, 10.0 * (turning * REAR_TO_GRAVITY - left)),
            np.where(fast, yawing, 10.0 * (turning - yaw_rate)),
            (control[:, 0] - steering) / LAG,
            (control[:, 1] - acceleration) / LAG,
        ],
        axis=-1,
    )
