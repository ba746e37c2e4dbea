"""Which model, which explicit method and how many sub-steps a vehicle needs at this moment, as CasADi equations.

The cheapest of the family that moves the vehicle within `tolerance` metres of the full model in this one step:

- Tyres are left out (the kinematic model) where the lateral acceleration that they have to give, and the slip that
  they have now, could not move the vehicle by half the tolerance within the step even if they gave nothing.
- Saturation is left out (linear tyres) where its share (`vehicle.tyres`) could not.
- Sub-steps are as many as stability asks for (rate times sub-step below 2; the limit of Runge-Kutta 4 is 2.8) and as
  the error asks for. For a method of order q with sub-steps of h it is h^q times the sum of three terms: swaying
  (1 + v) rate slipping, with the steering still to come and the present slip; bending (v yaw rate + acceleration) step
  (yaw rate)^(q - 1); and pulling, the change of acceleration over lag^(q - 2). The forms follow the leading errors; the
  constants bound what was measured over the grid of `olt_closed_loop.benchmarks.vehicle_grid`. The cheaper method is
  taken.
- Where tyres may slide the error has no such bound. There the drive starts with fewer sub-steps and doubles them until
  two results agree within the tolerance. With Runge-Kutta 4 the finer one is then some fifteen times closer.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca

from olt_closed_loop.vehicle.actuators import clip
from olt_closed_loop.vehicle.compiled import MOST_SUBSTEPS
from olt_closed_loop.vehicle.models import limited_commands, step_symbols
from olt_closed_loop.vehicle.parameters import MODELS, Model, VehicleNumbers, model_state_size
from olt_closed_loop.vehicle.state import STATE
from olt_closed_loop.vehicle.substeps import EVALUATIONS, EXPLICIT_METHODS, ExplicitMethod
from olt_closed_loop.vehicle.tyres import GRAVITY, inverse_speed

STABLE_RATE_TIMES_LENGTH = 2.0


class ErrorModel(NamedTuple):
    """The order of a method, and the constants of the three terms of its error."""

    order: int
    swaying: float
    bending: float
    pulling: float


ERROR_MODELS: dict[ExplicitMethod, ErrorModel] = {
    "midpoint": ErrorModel(2, swaying=0.05, bending=0.25, pulling=0.2),
    "rk4": ErrorModel(4, swaying=0.4, bending=0.005, pulling=0.02),
}
SLIDING = 0.4
"""Share of the friction limit beyond which the error is measured instead of estimated."""
FIRST_SHARE = 0.6
"""Of the estimated sub-steps, those with which measuring starts: one doubling makes up for it."""


def candidates(model: Model) -> tuple[tuple[Model, ExplicitMethod], ...]:
    """The models and methods that the plan chooses from, in the order of its answers."""
    family = MODELS[: MODELS.index(model) + 1]
    return tuple((each, method) for each in family for method in EXPLICIT_METHODS)


@lru_cache(maxsize=32)
def automatic_plan(model: Model, tolerance: float) -> ca.Function:
    """(state, control, numbers, step) -> (candidate, sub-steps, tolerance to check or 0)."""
    demands = _Demands(model)
    deviations = {"kinematic": demands.tyre_deviation(), "linear": demands.saturation_deviation()}
    chosen, half = _plan_of(demands, model, tolerance), 0.5 * tolerance
    for simpler in reversed(MODELS[: MODELS.index(model)]):
        chosen = ca.if_else(deviations[simpler] <= half, _plan_of(demands, simpler, half), chosen, True)
    return demands.plan(chosen)


@lru_cache(maxsize=32)
def stiffness_plan(model: Model, method: ExplicitMethod, tolerance: float) -> ca.Function:
    """The same for one method of the full model, the only sub-step of its program."""
    demands = _Demands(model)
    return demands.plan(ca.vertcat(0.0, demands.substeps(model, method, tolerance), 0.0))


@lru_cache(maxsize=32)
def fixed_plan(model: Model, substeps: int) -> ca.Function:
    """The same for a number of sub-steps that is given."""
    return _Demands(model).plan(ca.SX(ca.DM([0.0, substeps, 0.0])))


def _plan_of(demands: "_Demands", model: Model, tolerance: float) -> Any:
    """The cheaper of the methods for a model, as an answer of the plan."""
    midpoint, rk4 = (demands.substeps(model, method, tolerance) for method in EXPLICIT_METHODS)
    cheaper = EVALUATIONS["midpoint"] * midpoint < EVALUATIONS["rk4"] * rk4
    first = len(EXPLICIT_METHODS) * MODELS.index(model)
    answer = ca.if_else(cheaper, ca.vertcat(first, midpoint, 0.0), ca.vertcat(first + 1, rk4, 0.0))
    if model == "saturating":
        measured = ca.vertcat(first + 1, ca.ceil(FIRST_SHARE * rk4), tolerance)
        return ca.if_else(demands.asked_force() / demands.vehicle.friction > SLIDING, measured, answer)
    return answer


class _Demands:
    """What a vehicle does now and is asked to do in the step."""

    def __init__(self, model: Model) -> None:
        self.arguments = step_symbols(model_state_size(model))
        state, control, numbers, self.step = self.arguments
        self.vehicle = vehicle = VehicleNumbers(*ca.vertsplit(numbers))
        steering_command, acceleration_command = limited_commands(control, vehicle)
        steering, speed = state[STATE.steering], ca.fabs(state[STATE.speed])
        self.steering_change = ca.fabs(steering_command - steering)
        self.commanded_change = ca.fabs(acceleration_command - state[STATE.acceleration])
        along = vehicle.gear * state[STATE.acceleration], vehicle.gear * acceleration_command
        self.driving, self.braking = ca.fmax(ca.fmax(*along), 0.0), ca.fmax(-ca.fmin(*along), 0.0)
        self.pull = ca.fmax(self.driving, self.braking)
        # The least and the greatest speed that it can have within the step: brakes add none.
        self.lowest_speed = ca.fmax(speed - self.pull * self.step, 0.0)
        self.highest_speed = speed + self.driving * self.step
        # Rolling without slip along the sharpest curve of the step: yaw rate (rad/s), lateral acceleration (m/s^2).
        sharpest = ca.fmax(ca.fabs(steering), ca.fabs(steering_command))
        self.turning_rate = self.highest_speed * ca.tan(sharpest) / vehicle.wheelbase
        self.turning = self.highest_speed * self.turning_rate
        # How far it is from that now.
        rolling = state[STATE.speed] * ca.tan(steering) / vehicle.wheelbase
        self.has_tyres = model != "kinematic"
        self.lateral_speed = ca.fabs(state[STATE.lateral_speed]) if self.has_tyres else 0.0
        self.yaw_rate = ca.fabs(state[STATE.yaw_rate] - rolling) if self.has_tyres else 0.0
        self.slowness = inverse_speed(self.lowest_speed, vehicle.slip_speed)
        self.front_slip = (self.lateral_speed + vehicle.wheelbase * self.yaw_rate) * self.slowness
        self.rear_slip = self.lateral_speed * self.slowness

    def plan(self, answer: Any) -> ca.Function:
        """The plan that answers so."""
        return ca.Function("plan", list(self.arguments), [ca.densify(ca.cse(answer))])

    def tyre_deviation(self) -> Any:
        """Metres by which tyres could move it away from rolling without slip."""
        vehicle, speed = self.vehicle, self.highest_speed
        swinging = speed * self.steering_change / vehicle.steering_lag
        drifting = self.lateral_speed + (0.5 * speed * self.step + vehicle.wheelbase) * self.yaw_rate
        return 0.5 * (self.turning + swinging) * self.step**2 + drifting * self.step + self.saturation_deviation()

    def saturation_deviation(self) -> Any:
        """Metres by which saturation could move it away from linear tyres."""
        if not self.has_tyres:
            return 0.0
        asked = self.asked_force()
        share = asked / self.vehicle.friction
        return 0.5 * GRAVITY * asked * share**4 / 4.0 * self.step**2

    def asked_force(self) -> Any:
        """The largest force that an axle could be asked for, over its load."""
        vehicle, speed = self.vehicle, self.highest_speed
        front_load = vehicle.mass * GRAVITY * vehicle.rear_axle_to_centre / vehicle.wheelbase
        rear_load = vehicle.mass * GRAVITY - front_load
        front = vehicle.front_stiffness * (self.front_slip + self.steering_change) / front_load
        rear = vehicle.rear_stiffness * self.rear_slip / rear_load + self.turning / GRAVITY
        braking = self.braking * speed * inverse_speed(speed, vehicle.standing_speed)
        return ca.fmax(front, rear) + ca.fmax(self.driving, braking) / GRAVITY

    def rate(self, model: Model) -> Any:
        """The fastest rate (1/s) at which the model moves or is moved."""
        vehicle = self.vehicle
        rate = 1.0 / vehicle.steering_lag + self.turning_rate + self.pull / vehicle.standing_speed
        if model == "kinematic":
            return rate
        front, rear = vehicle.front_stiffness, vehicle.rear_stiffness
        lateral = (front + rear) / vehicle.mass
        to_front, to_rear = vehicle.front_axle_to_centre, vehicle.rear_axle_to_centre
        yawing = (front * to_front**2 + rear * to_rear**2) / vehicle.yaw_inertia
        swaying = ca.sqrt(ca.fabs(rear * to_rear - front * to_front) / vehicle.yaw_inertia)
        return ca.fmax(rate, ca.fmax((lateral + yawing) * self.slowness, swaying))

    def substeps(self, model: Model, method: ExplicitMethod, tolerance: float) -> Any:
        """Sub-steps that stability and the error ask for."""
        rate, errors, vehicle = self.rate(model), ERROR_MODELS[method], self.vehicle
        slipping = self.steering_change + self.front_slip + self.rear_slip
        swaying = errors.swaying * (1.0 + self.highest_speed) * rate * slipping
        bent = self.highest_speed * self.turning_rate + self.pull
        bending = errors.bending * bent * self.step * self.turning_rate ** (errors.order - 1)
        # How far the acceleration is from what it will be; close to standstill brakes fade, and all of it may go.
        fading = self.lowest_speed < 4.0 * vehicle.standing_speed
        pull_change = ca.if_else(fading, self.pull, self.commanded_change)
        pulling = errors.pulling * pull_change / vehicle.acceleration_lag ** (errors.order - 2)
        stable = rate * self.step / STABLE_RATE_TIMES_LENGTH
        accurate = self.step * ((swaying + bending + pulling) / tolerance) ** (1.0 / errors.order)
        return ca.ceil(clip(ca.fmax(stable, accurate), 1.0, MOST_SUBSTEPS + 1.0))
