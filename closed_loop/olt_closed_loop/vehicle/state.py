"""How states and controls of a vehicle are laid out, whatever integrates, tracks or scores it.

State (6,) of the kinematic model: x, y (m) and yaw (rad) of the rig in the world, speed of the rear axle (m/s),
steering angle of the front wheel (rad, left positive), acceleration that drive and brakes are set to (m/s^2). Models
with tyres append lateral speed of the rear axle (m/s, left positive) and yaw rate (rad/s): state (8,).
Control (2,): commanded steering angle (rad) and acceleration (m/s^2, along the rig's x).
"""

from typing import NamedTuple

import numpy as np

from olt_generator.poses import Array

STATE_SIZE = 6
"""Size of the kinematic state, with which every state begins."""
TYRE_STATE_SIZE = 8
CONTROL_SIZE = 2


class StateIndex(NamedTuple):
    """Where each quantity stands in a state."""

    x: int = 0
    y: int = 1
    yaw: int = 2
    speed: int = 3
    steering: int = 4
    acceleration: int = 5
    lateral_speed: int = 6
    yaw_rate: int = 7


STATE = StateIndex()


def steering_for(yaw_rate: Array, speed: Array, wheelbase: float) -> Array:
    """Steering angle (n,) rad that turns at `yaw_rate` (n,) rad/s at `speed` (n,) m/s; `wheelbase` in metres.

    The curvature is the ridge estimate v w / (v^2 + 0.25): yaw noise of a vehicle that hardly moves asks for no
    steering.
    """
    return np.arctan(wheelbase * speed * yaw_rate / (speed**2 + 0.25))
