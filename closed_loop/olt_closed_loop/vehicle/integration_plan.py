"""Which model, which explicit method and how many sub-steps a vehicle needs at this moment, as CasADi equations.

The cheapest of the family that moves the vehicle within `tolerance` metres of the full model in this one step:

- Tyres are left out (the kinematic model) where the lateral acceleration that they have to give, and the slip that
  they have now, could not move the vehicle by half the tolerance within the step even if they gave nothing.
- Saturation is left out (linear tyres) where its share (`vehicle.tyres`) could not.
- Sub-steps are as many as stability asks for (rate times sub-step below 2; the limit of Runge-Kutta 4 is 2.8) and as
  the error asks for. For a method of order q with sub-steps of h it is h^q times the sum of three terms: swaying
  (1 + v) rate slipping, with the steering still to come after the ramp, the present slip and that of the bend; bending
  (v yaw rate + acceleration) step (yaw rate)^(q - 1); and pulling, the change of acceleration over lag^(q - 2). The
  forms follow the leading errors; the constants bound what was measured over the grid of
  `olt_closed_loop.benchmarks.vehicle_grid`. The cheaper method is taken.
- Tyres, and grip that is asked for a good share of what there is, have no such bound. There the drive starts with fewer
  sub-steps and doubles them until two results agree well within the tolerance. With Runge-Kutta 4 the finer one is then
  some fifteen times closer. The first must be fine enough to see the grip run out while the wheel is turned.
- Sub-steps end where the motion has kinks: where a ramp of the actuators ends, and where drive changes to brake. Their
  moments are known in advance (`vehicle.actuators`).
"""

from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca

from olt_closed_loop.vehicle.actuators import clip, ramp_seconds, seconds_to_zero
from olt_closed_loop.vehicle.compiled import MOST_SUBSTEPS
from olt_closed_loop.vehicle.models import limited_commands, step_symbols, within_limits
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
AGREEMENT = 0.3
"""Of the tolerance, within which two results have to agree: sometimes they are alike by chance."""
SLIDING = 0.4
"""Share of the grip beyond which the error of the kinematic model is measured instead of estimated."""
FIRST_SHARES: dict[Model, float] = {"kinematic": 0.4, "linear": 0.6, "saturating": 1.0}
"""Of the estimated sub-steps, those with which measuring starts: one doubling does. Where brakes fade: all."""


def candidates(model: Model) -> tuple[tuple[Model, ExplicitMethod], ...]:
    """The models and methods that the plan chooses from, in the order of its answers."""
    with_tyres: tuple[tuple[Model, ExplicitMethod], ...] = (("linear", "rk4"), ("saturating", "rk4"))
    return (("kinematic", "midpoint"), ("kinematic", "rk4"), *with_tyres[: MODELS.index(model)])


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
    """How to integrate a model, as an answer of the plan: measured or, where the estimate holds, the cheaper method."""
    midpoint, rk4 = (demands.substeps(model, method, tolerance) for method in EXPLICIT_METHODS)
    first_share = ca.if_else(demands.fading, 1.0, FIRST_SHARES[model])
    measured = ca.vertcat(1 + MODELS.index(model), ca.ceil(first_share * rk4), AGREEMENT * tolerance)
    if model != "kinematic":
        return measured
    cheaper = EVALUATIONS["midpoint"] * midpoint < EVALUATIONS["rk4"] * rk4
    answer = ca.if_else(cheaper, ca.vertcat(0.0, midpoint, 0.0), ca.vertcat(1.0, rk4, 0.0))
    return ca.if_else(demands.asked_force(model) / demands.vehicle.friction > SLIDING, measured, answer)


class _Demands:
    """What a vehicle does now and is asked to do in the step."""

    def __init__(self, model: Model) -> None:
        self.arguments = step_symbols(model_state_size(model))
        given, control, numbers, self.step = self.arguments
        self.vehicle = vehicle = VehicleNumbers(*ca.vertsplit(numbers))
        state = within_limits(given, vehicle)
        steering_command, acceleration_command = limited_commands(control, vehicle)
        steering, speed = state[STATE.steering], ca.fabs(state[STATE.speed])
        self.steering = steering, steering_command
        self.acceleration = state[STATE.acceleration], acceleration_command
        self.steering_change = ca.fabs(steering_command - steering)
        self.steering_rate = ca.fmin(self.steering_change / vehicle.steering_lag, vehicle.max_steering_rate)
        self.commanded_change = ca.fabs(acceleration_command - state[STATE.acceleration])
        along = vehicle.gear * state[STATE.acceleration], vehicle.gear * acceleration_command
        self.driving, self.braking = ca.fmax(ca.fmax(*along), 0.0), ca.fmax(-ca.fmin(*along), 0.0)
        self.pull = ca.fmax(self.driving, self.braking)
        # The least and the greatest speed that it can have within the step: brakes add none.
        self.lowest_speed = ca.fmax(speed - self.pull * self.step, 0.0)
        self.highest_speed = speed + self.driving * self.step
        # Rolling without slip along the sharpest curve of the step: yaw rate (rad/s), lateral acceleration (m/s^2).
        turned_through = steering * steering_command < 0.0
        self.least_steering = ca.if_else(turned_through, 0.0, ca.fmin(ca.fabs(steering), ca.fabs(steering_command)))
        sharpest = ca.fmax(ca.fabs(steering), ca.fabs(steering_command))
        self.turning_rate = self.highest_speed * ca.tan(sharpest) / vehicle.wheelbase
        self.turning = self.highest_speed * self.turning_rate
        # A pull along a bend turns the vehicle faster and faster; without tyres no faster than grip lets it.
        self.rolling_up = self.pull * ca.tan(sharpest)
        self.gripped_rate = ca.fmin(self.turning_rate, vehicle.friction * GRAVITY / self.lowest_speed)
        self.fading = self.lowest_speed < 4.0 * vehicle.standing_speed
        # How far it is from that now.
        rolling = state[STATE.speed] * ca.tan(steering) / vehicle.wheelbase
        self.has_tyres = model != "kinematic"
        self.lateral_speed = ca.fabs(state[STATE.lateral_speed]) if self.has_tyres else 0.0
        self.yaw_rate = ca.fabs(state[STATE.yaw_rate] - rolling) if self.has_tyres else 0.0
        self.slowness = inverse_speed(self.lowest_speed, vehicle.slip_speed)
        self.front_slip = (self.lateral_speed + vehicle.wheelbase * self.yaw_rate) * self.slowness
        self.rear_slip = self.lateral_speed * self.slowness

    def plan(self, answer: Any) -> ca.Function:
        """The plan that answers so, and with the kinks."""
        return ca.Function("plan", list(self.arguments), [ca.densify(ca.cse(ca.vertcat(answer, self.kinks())))])

    def kinks(self) -> Any:
        """When the actuators' ramps end and the acceleration changes between drive and brake, in rising order."""
        vehicle = self.vehicle
        acceleration = (*self.acceleration, vehicle.acceleration_lag, vehicle.max_jerk)
        moments = [
            ramp_seconds(*self.steering, vehicle.steering_lag, vehicle.max_steering_rate),
            ramp_seconds(*acceleration),
            seconds_to_zero(*acceleration),
        ]
        first, second, third = (ca.fmin(moment, self.step) for moment in moments)
        first, second = ca.fmin(first, second), ca.fmax(first, second)
        second, third = ca.fmin(second, third), ca.fmax(second, third)
        return ca.vertcat(ca.fmin(first, second), ca.fmax(first, second), third)

    def tyre_deviation(self) -> Any:
        """Metres by which tyres could move it away from rolling without slip."""
        vehicle, speed = self.vehicle, self.highest_speed
        swinging = speed * self.steering_change / vehicle.steering_lag
        drifting = self.lateral_speed + (0.5 * speed * self.step + vehicle.wheelbase) * self.yaw_rate
        return (
            0.5 * (self.turning + swinging + self.rolling_up) * self.step**2
            + drifting * self.step
            + self.saturation_deviation()
        )

    def saturation_deviation(self) -> Any:
        """Metres by which saturation could move it away from linear tyres."""
        if not self.has_tyres:
            return 0.0
        asked = self.asked_force("saturating")
        share = asked / self.vehicle.friction
        return 0.5 * GRAVITY * asked * share**4 / 4.0 * self.step**2

    def asked_force(self, model: Model) -> Any:
        """The largest force that an axle could be asked for, over its load."""
        vehicle, speed = self.vehicle, self.highest_speed
        braking = self.braking * speed * inverse_speed(speed, vehicle.standing_speed)
        along = ca.fmax(self.driving, braking) / GRAVITY
        if model == "kinematic":
            return self.turning / GRAVITY + along
        front_load = vehicle.mass * GRAVITY * vehicle.rear_axle_to_centre / vehicle.wheelbase
        rear_load = vehicle.mass * GRAVITY - front_load
        front = vehicle.front_stiffness * (self.front_slip + self.steering_change) / front_load
        rear = vehicle.rear_stiffness * self.rear_slip / rear_load + self.turning / GRAVITY
        return ca.fmax(front, rear) + along

    def rate(self, model: Model) -> Any:
        """The fastest rate (1/s) at which the model moves or is moved."""
        vehicle = self.vehicle
        braking_rate = ca.if_else(self.fading, self.pull / vehicle.standing_speed, 0.0)
        if model == "kinematic":
            grip = vehicle.wheelbase * vehicle.friction * GRAVITY
            crossing = self.lowest_speed**2 * ca.tan(self.least_steering) < 3.0 * grip
            saturating = ca.if_else(crossing, 4.0 * self.highest_speed**2 * self.steering_rate / grip, 0.0)
            return 1.0 / vehicle.steering_lag + self.gripped_rate + braking_rate + saturating
        rate = 1.0 / vehicle.steering_lag + self.turning_rate + braking_rate
        if model == "saturating":
            front_grip = vehicle.friction * vehicle.mass * GRAVITY * vehicle.rear_axle_to_centre / vehicle.wheelbase
            rate += 2.0 * vehicle.front_stiffness * self.steering_rate / front_grip
        front, rear = vehicle.front_stiffness, vehicle.rear_stiffness
        lateral = (front + rear) / vehicle.mass
        to_front, to_rear = vehicle.front_axle_to_centre, vehicle.rear_axle_to_centre
        yawing = (front * to_front**2 + rear * to_rear**2) / vehicle.yaw_inertia
        swaying = ca.sqrt(ca.fabs(rear * to_rear - front * to_front) / vehicle.yaw_inertia)
        return ca.fmax(rate, ca.fmax((lateral + yawing) * self.slowness, swaying))

    def substeps(self, model: Model, method: ExplicitMethod, tolerance: float) -> Any:
        """Sub-steps that stability and the error ask for."""
        rate, errors, vehicle = self.rate(model), ERROR_MODELS[method], self.vehicle
        # While it ramps the steering is smooth: what counts is the distance from which it decays.
        slipping = vehicle.steering_lag * self.steering_rate + self.front_slip + self.rear_slip
        if model != "kinematic":
            slipping += vehicle.mass * self.turning / (vehicle.front_stiffness + vehicle.rear_stiffness)
        swaying = errors.swaying * (1.0 + self.highest_speed) * rate * slipping
        turning_rate = self.gripped_rate if model == "kinematic" else self.turning_rate
        bent = self.highest_speed * turning_rate + self.pull
        bending = errors.bending * bent * self.step * turning_rate ** (errors.order - 1)
        # How far the acceleration is from what it will be; close to standstill brakes fade, and all of it may go.
        pull_change = ca.if_else(self.fading, self.pull, self.commanded_change)
        pulling = errors.pulling * pull_change / vehicle.acceleration_lag ** (errors.order - 2)
        stable = rate * self.step / STABLE_RATE_TIMES_LENGTH
        accurate = self.step * ((swaying + bending + pulling) / tolerance) ** (1.0 / errors.order)
        return ca.ceil(clip(ca.fmax(stable, accurate), 1.0, MOST_SUBSTEPS + 1.0))
