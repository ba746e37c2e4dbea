"""Vehicles with tyres: AlpaSim's car, and that car scaled to the box of another ego."""

from dataclasses import replace

import numpy as np

from olt_closed_loop.vehicle.models import TyreParameters, VehicleParameters
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, VehicleDimensions

# Facts sheet alpasim, section 4; it gives the stiffness of one tyre, of which an axle has two.
ALPASIM_TYRES = TyreParameters(
    mass=2014.4,
    yaw_inertia=3414.2,
    rear_axle_to_centre=1.59,
    front_stiffness=2 * 93534.5,
    rear_stiffness=2 * 176162.1,
)
DRY_FRICTION = 1.0


def alpasim_vehicle(friction: float = np.inf) -> VehicleParameters:
    """AlpaSim's parameters, which do not follow the ego's box; linear tyres unless a friction is given."""
    return vehicle_with_tyres(DEFAULT_VEHICLE, friction)


def vehicle_with_tyres(dimensions: VehicleDimensions, friction: float = DRY_FRICTION) -> VehicleParameters:
    """AlpaSim's car scaled to a box: at AlpaSim's own box it is that car.

    Mass goes with the volume of the box, the inertia with mass times (length^2 + width^2), the centre of gravity with
    the wheelbase, and each axle's cornering stiffness with its load.
    """
    box = DEFAULT_VEHICLE
    heavier = (dimensions.length * dimensions.width * dimensions.height) / (box.length * box.width * box.height)
    wider = (dimensions.length**2 + dimensions.width**2) / (box.length**2 + box.width**2)
    tyres = TyreParameters(
        mass=ALPASIM_TYRES.mass * heavier,
        yaw_inertia=ALPASIM_TYRES.yaw_inertia * heavier * wider,
        rear_axle_to_centre=ALPASIM_TYRES.rear_axle_to_centre * dimensions.wheelbase / box.wheelbase,
        front_stiffness=ALPASIM_TYRES.front_stiffness * heavier,
        rear_stiffness=ALPASIM_TYRES.rear_stiffness * heavier,
        friction=friction,
    )
    return replace(VehicleParameters.from_dimensions(dimensions), tyres=tyres)
