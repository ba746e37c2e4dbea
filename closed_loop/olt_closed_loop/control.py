"""Tracking of a plan by model predictive control.

The commands of the next two seconds minimise, over the vehicle's own equations,

    sum of (along^2 + across^2) / position_scale^2 + yaw^2 / yaw_scale^2
        + (change of steering)^2 / steering_change^2 + (change of acceleration)^2 / acceleration_change^2

where along, across and yaw are the errors to the plan, in the plan's own axes, at every 0.1 s. The problem is solved by
Gauss-Newton steps in condensed form from the commands that the plan itself suggests, as in the real-time iteration
(Diehl, Bock, Schloeder, SIAM J. Control Optim. 43, 2005): predict, linearise along the prediction, solve one small
linear system, cut at the limits, repeat. The lags of the actuators are part of the equations and so are led.

The call is a pure function of its arguments. It works in the rig's own frame, so world coordinates of any size do not
cost precision.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from olt_closed_loop.buffered import BufferedFunction
from olt_closed_loop.integrators import step_function
from olt_closed_loop.plans import WorldPlan
from olt_closed_loop.vehicle import (
    CONTROL_SIZE,
    STATE,
    STATE_SIZE,
    VehicleParameters,
    steering_for,
)
from olt_generator.poses import Array
from olt_toolkit.policy import STEP_SECONDS, STEP_US


@dataclass(frozen=True)
class ControlSettings:
    """How a plan is tracked.

    Attributes:
        horizon: steps of 0.1 s that are looked ahead.
        iterations: Gauss-Newton steps a call.
        position_scale: metres of position error that weigh as much as
        yaw_scale: this many radians of yaw error, as
        steering_change: this many radians of change in the steering command from step to step, and as
        acceleration_change: this many m/s^2 of change in the acceleration command.
        standing_distance, standing_speed: a plan that moves less than this many metres within the horizon, at a
            vehicle slower than this many m/s, is a plan to stand.
        holding_brake: acceleration command that holds a standing vehicle, m/s^2.
    """

    horizon: int = 20
    iterations: int = 2
    position_scale: float = 0.1
    yaw_scale: float = 0.1
    steering_change: float = 0.05
    acceleration_change: float = 1.0
    standing_distance: float = 0.05
    standing_speed: float = 0.3
    holding_brake: float = -2.0


class TrackingController:
    """Follows plans with one vehicle."""

    def __init__(self, parameters: VehicleParameters, settings: ControlSettings | None = None) -> None:
        self._parameters = parameters
        self._settings = settings or ControlSettings()
        self._predict = BufferedFunction(_linearised_step(parameters).mapaccum("predict", self._settings.horizon))
        self._change_scale = np.array([self._settings.steering_change, self._settings.acceleration_change])
        self._changes = (
            _change_matrix(self._settings.horizon) / np.tile(self._change_scale, self._settings.horizon)[:, None]
        )

    def control(self, state: Array, plan: WorldPlan, time_us: int) -> Array:
        """The control (2,) to hold from `time_us` for 0.1 s, in the vehicle's limits.

        Args:
            state: (6,) of the vehicle at `time_us`.
            plan: what to follow; past its end it stands.
            time_us: now.
        """
        horizon_us = time_us + STEP_US * np.arange(self._settings.horizon + 1, dtype=np.int64)
        target = _in_rig(plan.at(horizon_us), state)
        if self._stands(target, state):
            return np.array([state[STATE.steering], self._settings.holding_brake])
        start = np.concatenate([np.zeros(3), state[STATE.speed :]])
        controls = self._suggested_controls(target)
        for _ in range(self._settings.iterations):
            controls = np.clip(controls + self._improvement(start, controls, target), *self._parameters.control_limits)
        return controls[0]

    def _stands(self, target: Array, state: Array) -> bool:
        moved = np.abs(np.diff(target[:, :2], axis=0)).sum()
        return bool(moved < self._settings.standing_distance and state[STATE.speed] < self._settings.standing_speed)

    def _suggested_controls(self, target: Array) -> Array:
        """Controls (horizon, 2) that roughly drive the target poses (horizon + 1, 3)."""
        moved = np.diff(target, axis=0)
        heading = target[:-1, 2] + 0.5 * moved[:, 2]
        speed = (moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading)) / STEP_SECONDS
        steering = steering_for(moved[:, 2] / STEP_SECONDS, speed, self._parameters.wheelbase)
        acceleration = np.gradient(speed, STEP_SECONDS)
        return np.clip(np.stack([steering, acceleration], axis=-1), *self._parameters.control_limits)

    def _improvement(self, start: Array, controls: Array, target: Array) -> Array:
        """One Gauss-Newton step: the change (horizon, 2) of the controls."""
        horizon = self._settings.horizon
        states, by_state, by_control = self._predict(start, controls)
        sensitivity = _sensitivities(
            by_state.reshape(horizon, STATE_SIZE, STATE_SIZE).swapaxes(1, 2),
            by_control.reshape(horizon, CONTROL_SIZE, STATE_SIZE).swapaxes(1, 2),
        )
        weight = self._error_weights(target[1:, 2])
        error = np.einsum("kij,kj->ki", weight, states[:, :3] - target[1:]).ravel()
        jacobian = (weight @ sensitivity[:, :3]).reshape(3 * horizon, -1)
        changed = self._changes @ controls.ravel()
        changed[:CONTROL_SIZE] -= start[STATE.steering :] / self._change_scale
        normal = jacobian.T @ jacobian + self._changes.T @ self._changes
        gradient = jacobian.T @ error + self._changes.T @ changed
        return -np.linalg.solve(normal, gradient).reshape(horizon, CONTROL_SIZE)

    def _error_weights(self, yaw: Array) -> Array:
        """Matrices (horizon, 3, 3) from errors in x, y, yaw to scaled errors along, across and in yaw."""
        cos, sin = np.cos(yaw), np.sin(yaw)
        weight = np.zeros((len(yaw), 3, 3))
        weight[:, 0, 0] = weight[:, 1, 1] = cos / self._settings.position_scale
        weight[:, 0, 1] = sin / self._settings.position_scale
        weight[:, 1, 0] = -weight[:, 0, 1]
        weight[:, 2, 2] = 1.0 / self._settings.yaw_scale
        return weight


def _linearised_step(parameters: VehicleParameters) -> ca.Function:
    """(state, control) -> next state and its derivatives by state (6, 6) and control (6, 2)."""
    state, control = ca.SX.sym("state", STATE_SIZE), ca.SX.sym("control", CONTROL_SIZE)
    step = step_function(parameters, "rk4", 2, STEP_SECONDS)
    following = step(state, control)
    by_state, by_control = (ca.densify(ca.jacobian(following, by)) for by in (state, control))
    return ca.Function("linearised_step", [state, control], ca.cse([following, by_state, by_control]))


def _sensitivities(by_state: Array, by_control: Array) -> Array:
    """Derivatives (n, 6, 2 n) of all predicted states by all controls, from those of each step."""
    horizon = len(by_state)
    result = np.zeros((horizon, STATE_SIZE, CONTROL_SIZE * horizon))
    current = np.zeros((STATE_SIZE, CONTROL_SIZE * horizon))
    for index in range(horizon):
        current = by_state[index] @ current
        current[:, CONTROL_SIZE * index : CONTROL_SIZE * (index + 1)] = by_control[index]
        result[index] = current
    return result


def _change_matrix(horizon: int) -> Array:
    """(2 n, 2 n): controls in a row -> their changes from step to step, the first against nothing."""
    size = CONTROL_SIZE * horizon
    return np.eye(size) - np.eye(size, k=-CONTROL_SIZE)


def _in_rig(poses: Array, state: Array) -> Array:
    """World poses (n, 3) in the frame of the vehicle's rig; the first yaw is within half a turn."""
    offset = poses[:, :2] - state[: STATE.yaw]
    cos, sin = np.cos(state[STATE.yaw]), np.sin(state[STATE.yaw])
    yaw = poses[:, 2] - state[STATE.yaw]
    yaw = yaw - 2.0 * np.pi * np.round(yaw[0] / (2.0 * np.pi))
    return np.stack([cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0], yaw], axis=-1)
