"""Actuators of steering and acceleration: limits, rate limits, and a first-order lag.

    value' = (command - value) / lag, within +-max_rate

While the command is held this has a closed form: a ramp at max_rate until the distance to the command has shrunk to
lag * max_rate, then an exponential. Explicit integrators use the closed form, so that the lags cost no accuracy and no
stability; implicit ones use the equation.
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
