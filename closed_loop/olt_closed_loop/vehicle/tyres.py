"""Forces of a vehicle's two axles: tyres that are linear in slip, and their saturation at the limit of friction.

Slip is the lateral speed of a wheel over its rolling speed. That quotient has no limit at standstill, so the rolling
speed v is kept from vanishing: 1 / (v^4 + v_slip^4)^(1/4). It differs from 1 / |v| by less than 0.2 % at four times
v_slip, is smooth, holds in both directions, and makes a slow tyre a damper without any switch between models.

Saturation: the forces that an axle is asked for, along (drive and brakes) and across (stiffness times slip), are
scaled by one factor (1 + s^4)^(-1/4), where s is the length of the asked-for force over friction times load: the
friction circle, approached smoothly (an isotropic combined-slip tyre; Pacejka, Tyre and Vehicle Dynamics, 3rd ed.,
chapter 3, in form). At s = 0.3 it takes 0.2 %, at s = 1 it takes 16 %. Loads are those at rest: no load transfer. The
kinematic model's accelerations are kept within the same circle.
"""

from typing import Any

import casadi as ca

GRAVITY = 9.81


def share_left(ratio_squared: Any) -> Any:
    """(1 + r^4)^(-1/4), given r^2: what saturation leaves of a demand that is r times the limit."""
    return 1.0 / ca.sqrt(ca.sqrt(1.0 + ratio_squared**2))


def inverse_speed(speed: Any, least_speed: Any) -> Any:
    """1 / |speed|, smoothly kept below 1 / least_speed."""
    return share_left((speed / least_speed) ** 2) / least_speed


def linear_force(stiffness: Any, lateral_speed: Any, rolling_speed: Any, slip_speed: Any) -> Any:
    """Lateral force (N) of an axle of the given cornering stiffness (N/rad); it opposes the lateral speed."""
    return -stiffness * lateral_speed * inverse_speed(rolling_speed, slip_speed)


def friction_share(along: Any, across: Any, limit: Any) -> Any:
    """The factor that brings the asked-for forces within the friction circle of radius `limit`, both in N or m/s^2."""
    return share_left((along**2 + across**2) / limit**2)
