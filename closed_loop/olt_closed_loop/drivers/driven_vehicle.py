"""A vehicle with its controller that is driven from call to call, in the plane of its rig.

As in AlpaSim (docs/formats/alpasim_services.md) the pose is the caller's, who may correct it for the ground between
two calls, and the rates, the wheel and the pedals are the vehicle's own, unless the caller takes them over. The
controller is asked every 0.1 s. A plan is given in the rig as it stood at the plan's first time: with a planner's delay
that is an earlier one, and where the rig was then is remembered. What is moved in a call is added to the pose that was
given, so slopes and coordinates of any size cost no precision.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.control.plans import PlanRefused, WorldPlan
from olt_closed_loop.control.tracking import ControlSettings, TrackingController
from olt_closed_loop.drivers.conversions import poses_at
from olt_closed_loop.vehicle.integrators import DEFAULT_METHOD, Method, VehicleStepper
from olt_closed_loop.vehicle.parameters import VehicleParameters, on_the_brake, with_rolling_tyres
from olt_closed_loop.vehicle.state import STATE, STATE_SIZE
from olt_generator.poses import Array, invert, planar_pose, yaw_of
from olt_toolkit.policy.contract import STEP_US

SLOWEST_TURN = 0.25
"""m/s from which on the angle of the wheel is reckoned from speed and yaw rate; AlpaSim's number."""
REMEMBERED_US = 5_000_000
"""How long it is remembered where the rig was, for plans that are older than now."""
_STEPPERS = 64


@dataclass(frozen=True)
class Rates:
    """How the rig moves, in its own frame: velocity (3,) m/s, angular velocity (3,) rad/s, and their changes."""

    velocity: Array
    angular_velocity: Array
    acceleration: Array
    angular_acceleration: Array


@dataclass(frozen=True)
class MovedVehicle:
    """Where the vehicle came to: time in microseconds, pose (4, 4) of the rig in the caller's frame, and rates."""

    time_us: int
    T_local_rig: Array
    rates: Rates


class DrivenVehicle:
    """See the module. `time_us` is when the last call ended, None before the first."""

    def __init__(
        self, parameters: VehicleParameters, settings: ControlSettings | None = None, method: Method = DEFAULT_METHOD
    ) -> None:
        self.time_us: int | None = None
        self._controller = TrackingController(parameters, settings)
        self._stepper = lru_cache(_STEPPERS)(
            lambda step_us, vehicle: VehicleStepper(vehicle, method, step=step_us * 1e-6)
        )
        self._state: Array = np.zeros(parameters.state_size)
        self._control: Array = np.zeros(2)
        self._asked_us: int | None = None
        self._way: dict[int, Array] = {}

    def take_over(self, rates: Rates) -> None:
        """Move from now on as the caller says; the wheel stands as speed and yaw rate need it."""
        vehicle = self._controller.parameters
        speed, yaw_rate = rates.velocity[0], rates.angular_velocity[2]
        turns = abs(speed) > SLOWEST_TURN
        steering = np.arctan(vehicle.wheelbase * yaw_rate / speed) if turns else 0.0
        (low_steering, low), (high_steering, high) = vehicle.control_limits
        state = np.zeros(STATE_SIZE)
        state[STATE.speed] = speed
        state[STATE.steering] = np.clip(steering, low_steering, high_steering)
        state[STATE.acceleration] = np.clip(rates.acceleration[0], low, high)
        self._state = with_rolling_tyres(state, vehicle)
        if vehicle.tyres is not None:
            self._state[STATE.lateral_speed], self._state[STATE.yaw_rate] = rates.velocity[1], yaw_rate

    def run(
        self, now_us: int, T_local_rig: Array, times_us: NDArray[np.int64], plan_rig: Array, stops_us: list[int]
    ) -> Iterator[MovedVehicle]:
        """Drive from a pose (4, 4) now, and tell where the vehicle is at the stops.

        Args:
            now_us: time.
            T_local_rig: where the rig is.
            times_us: (n,) of the plan, increasing; the first is now or within the last `REMEMBERED_US`.
            plan_rig: poses (n, 4, 4) in the rig at the first of these times.
            stops_us: times after now, increasing.

        Raises:
            PlanRefused: the plan is none (`control.plans.WorldPlan`), or begins when it is not known where the rig was.
            InputError: the vehicle's equations cannot be solved.
        """
        way = {**self._way, now_us: T_local_rig}
        if times_us[0] != now_us:
            plan_rig = invert(T_local_rig) @ _where_at(int(times_us[0]), way) @ plan_rig
        start = np.array([T_local_rig[0, 3], T_local_rig[1, 3], float(yaw_of(T_local_rig))])
        self._state[: STATE.speed] = start
        plan = _in_plane(times_us, plan_rig, start)
        due_us = now_us if self._asked_us is None else max(now_us, self._asked_us + STEP_US)
        asked = range(due_us, stops_us[-1], STEP_US)
        for target_us in sorted({*stops_us, *asked} - {now_us}):
            if now_us in asked:
                self._ask(plan, now_us)
            rates = self._step(target_us - now_us)
            now_us = target_us
            if now_us in stops_us:
                way[now_us] = T_local_rig @ _moved(start, self._state)
                yield MovedVehicle(now_us, way[now_us], rates)
        self.time_us = now_us
        self._way = {time_us: pose for time_us, pose in way.items() if time_us >= now_us - REMEMBERED_US}

    def _ask(self, plan: WorldPlan, now_us: int) -> None:
        reverse = self._controller.parameters.reverse_gear
        self._control, self._asked_us = self._controller.control(self._state, plan, now_us), now_us
        if self._controller.parameters.reverse_gear != reverse:
            self._state = on_the_brake(self._state, self._controller.parameters)

    def _step(self, step_us: int) -> Rates:
        """Move, and tell the rates at the end; their changes are those over the step."""
        before = self._motion()
        self._state = self._stepper(step_us, self._controller.parameters)(self._state, self._control)
        (ahead, left, turn), seconds = self._motion(), step_us * 1e-6
        faster, across, spin = (np.array([ahead, left, turn]) - before) / seconds
        return Rates(
            velocity=np.array([ahead, left, 0.0]),
            angular_velocity=np.array([0.0, 0.0, turn]),
            acceleration=np.array([faster - turn * left, across + turn * ahead, 0.0]),
            angular_acceleration=np.array([0.0, 0.0, spin]),
        )

    def _motion(self) -> Array:
        """Speed ahead and to the left (m/s) and yaw rate (rad/s) of the rig, (3,)."""
        state, vehicle = self._state, self._controller.parameters
        if vehicle.tyres is None:
            speed = state[STATE.speed]
            return np.array([speed, 0.0, speed * np.tan(state[STATE.steering]) / vehicle.wheelbase])
        return state[[STATE.speed, STATE.lateral_speed, STATE.yaw_rate]]


def _where_at(time_us: int, way: dict[int, Array]) -> Array:
    """Where the rig was, between poses by time; raises `PlanRefused` outside them."""
    known = np.array(sorted(way), dtype=np.int64)
    if not known[0] <= time_us <= known[-1]:
        raise PlanRefused(f"plan from {time_us} us; where the rig was is known from {known[0]} to {known[-1]} us")
    poses = np.stack([way[known_us] for known_us in known.tolist()])
    return poses_at(known, poses, np.array([time_us], dtype=np.int64))[0]


def _in_plane(times_us: NDArray[np.int64], plan_rig: Array, start: Array) -> WorldPlan:
    """The plan in the plane in which the rig stands at `start` (x, y, yaw)."""
    x, y, yaw = start
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead, left = plan_rig[:, 0, 3], plan_rig[:, 1, 3]
    turned = np.unwrap(np.concatenate([[0.0], yaw_of(plan_rig)]))[1:]
    poses = np.column_stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left, yaw + turned])
    return WorldPlan(times_us, poses)


def _moved(start: Array, state: Array) -> Array:
    """The pose (4, 4) of a state in the rig that stood at `start` (x, y, yaw)."""
    (x, y), yaw = state[: STATE.yaw] - start[:2], start[2]
    cos, sin = np.cos(yaw), np.sin(yaw)
    return planar_pose(cos * x + sin * y, cos * y - sin * x, state[STATE.yaw] - yaw)
