"""Serve a policy, or the vehicle, to AlpaSim."""

from contextlib import closing
from typing import Annotated

import typer

from olt_closed_loop.commands.options import (
    Controller,
    HostOption,
    IdleOption,
    Integrator,
    IsolationOption,
    PolicyMemoryOption,
    PolicyTimeoutOption,
    SessionsOption,
    Vehicle,
    policy_limits,
)


def serve(
    policy: Annotated[str, typer.Option(help="NAME or NAME:PATH, as `run` takes it.")],
    host: HostOption = "127.0.0.1",
    port: Annotated[int, typer.Option(help="0 for any free one.", envvar="ALPASIM_DRIVER_PORT")] = 6789,
    sessions: SessionsOption = 64,
    idle_timeout: IdleOption = 600.0,
    isolate: IsolationOption = "auto",
    policy_timeout: PolicyTimeoutOption = None,
    policy_memory: PolicyMemoryOption = None,
) -> None:
    """Serve a policy as a driver of AlpaSim (gRPC service egodriver), until told to end.

    Whoever reaches the port can drive with the policy: there are no passwords.
    """
    from olt_closed_loop.drivers.driver_service import DriverService
    from olt_closed_loop.drivers.server import serving, wait_for_end
    from olt_toolkit.runtime.console import print_line

    service = DriverService(policy, sessions, policy_limits(isolate, policy_timeout, policy_memory), idle_timeout)
    with closing(service), serving(service, host, port, sessions) as bound:
        print_line(f"{policy} serves egodriver.EgodriverService at {host}:{bound}")
        wait_for_end()


def serve_vehicle(
    vehicle: Annotated[Vehicle, typer.Option(help="How it moves.")] = "tyres",
    controller: Annotated[
        Controller, typer.Option(help="What follows the plan: LQR, linear or nonlinear MPC.")
    ] = "linear",
    integrator: Annotated[Integrator, typer.Option(help="How the vehicle is integrated.")] = "auto",
    host: HostOption = "127.0.0.1",
    port: Annotated[int, typer.Option(help="0 for any free one.")] = 6790,
    sessions: SessionsOption = 64,
    idle_timeout: IdleOption = 600.0,
) -> None:
    """Serve the vehicle and its controller to AlpaSim (gRPC service VDCService), until told to end."""
    from olt_closed_loop import ControlSettings
    from olt_closed_loop.drivers.driven_vehicle import DrivenVehicle
    from olt_closed_loop.drivers.server import serving, wait_for_end
    from olt_closed_loop.drivers.vehicle_service import VehicleService
    from olt_closed_loop.vehicle.parameters import VehicleParameters, vehicle_with_tyres
    from olt_toolkit.rigs.rig import DEFAULT_VEHICLE
    from olt_toolkit.runtime.console import print_line

    make = vehicle_with_tyres if vehicle == "tyres" else VehicleParameters.from_dimensions
    parameters, settings = make(DEFAULT_VEHICLE), ControlSettings(method=controller)
    name = f"{vehicle}-{controller}"
    service = VehicleService(lambda: DrivenVehicle(parameters, settings, integrator), name, sessions, idle_timeout)
    with closing(service), serving(service, host, port, sessions) as bound:
        print_line(f"{name} serves controller.VDCService at {host}:{bound}")
        wait_for_end()
