"""What tracking a plan well means: the one cost that every solver of `control.tracking` minimises.

    sum of (along^2 + across^2) / position_scale^2 + yaw^2 / yaw_scale^2
        + (change of steering)^2 / steering_change^2 + (change of acceleration)^2 / acceleration_change^2

over the steps of 0.1 s of the horizon. along, across and yaw are the errors to the plan at the end of a step, in the
plan's own axes; a change is that of a command from step to step, the first against where the actuators are.
"""

from dataclasses import dataclass

import casadi as ca

from olt_closed_loop.vehicle.state import STATE

ACTUATORS = [STATE.steering, STATE.acceleration]
"""Where a state holds what the commands act on, in the order of the commands."""


@dataclass(frozen=True)
class TrackingCost:
    """Scales of the cost: what weighs as much as what.

    Attributes:
        position_scale: metres of position error.
        yaw_scale: radians of yaw error.
        steering_change: radians of change in the steering command from step to step.
        acceleration_change: m/s^2 of change in the acceleration command from step to step.
    """

    position_scale: float = 0.1
    yaw_scale: float = 0.1
    steering_change: float = 0.1
    acceleration_change: float = 1.0

    @property
    def change_scales(self) -> tuple[float, float]:
        """The scales of the two commands' changes."""
        return self.steering_change, self.acceleration_change

    def pose_errors(self, pose: ca.SX, target: ca.SX) -> ca.SX:
        """Scaled errors (3,) along, across and in yaw of a pose (x, y, yaw) to its target."""
        x, y, yaw = ca.vertsplit(pose - target)
        cos, sin = ca.cos(target[STATE.yaw]), ca.sin(target[STATE.yaw])
        along, across = cos * x + sin * y, cos * y - sin * x
        return ca.vertcat(along / self.position_scale, across / self.position_scale, yaw / self.yaw_scale)
