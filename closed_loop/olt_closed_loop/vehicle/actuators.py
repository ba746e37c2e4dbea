"""Actuators of steering and acceleration: limits, rate limits, and a first-order lag.

    value' = (command - value) / lag, within +-max_rate

While the command is held this has a closed form: a ramp at max_rate until the distance to the command has shrunk to
lag * max_rate, then an exponential. Explicit integrators use the closed form, so that the lags cost no accuracy and no
stability; implicit ones use the equation. The closed form also tells when the ramp ends and when the value changes its
sign, which are the kinks of the motion: explicit sub-steps end there.
"""

from typing import Any

import casadi as ca


def clip(value: Any, low: Any, high: Any) -> Any:
    """`value`, cut at `low` and `high`."""
    return ca.fmin(ca.fmax(value, low), high)


def actuator_rate(value: Any, command: Any, lag: Any, max_rate: Any) -> Any:
    """Time derivative of an actuator's value."""
    return clip((command - value) / lag, -max_rate, max_rate)


def actuator_after(time: Any, value: Any, command: Any, lag: Any, max_rate: Any) -> Any:
    """Value of an actuator `time` > 0 seconds after it was `value`, its command held."""
    distance = command - value
    too_far = distance - clip(distance, -lag * max_rate, lag * max_rate)
    ramped = clip(too_far, -max_rate * time, max_rate * time)
    ramping_time = ca.fmin(ca.fabs(too_far) / max_rate, time)
    return command - (distance - ramped) * ca.exp((ramping_time - time) / lag)


def ramp_seconds(value: Any, command: Any, lag: Any, max_rate: Any) -> Any:
    """How long the ramp lasts; 0 where there is none."""
    distance = command - value
    return ca.fmax(ca.fabs(distance) - lag * max_rate, 0.0) / max_rate


def seconds_to_zero(value: Any, command: Any, lag: Any, max_rate: Any) -> Any:
    """When the value changes its sign; 0 where it does not."""
    ramp = ramp_seconds(value, command, lag, max_rate)
    ramped = actuator_after(ramp, value, command, lag, max_rate)
    decaying = ramp + lag * ca.log((command - ramped) / command)
    seconds = ca.if_else(ramped * command < 0.0, decaying, ca.fabs(value) / max_rate)
    return ca.if_else(value * command < 0.0, seconds, 0.0)
