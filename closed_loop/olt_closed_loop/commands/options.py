"""Options that several commands take.

The choices are those of the modules named beside them, which are loaded only when a command runs.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from olt_closed_loop.simulation.policy_hosts import PolicyLimits

Definition = Literal["strict", "alpasim", "alpasim@3032e0c", "alpasim@challenge-2026-09"]  # scoring.definitions
Traffic = Literal["recorded", "idm"]  # rollouts.rollout
Vehicle = Literal["kinematic", "tyres"]  # simulation.settings
Controller = Literal["lqr", "linear", "nonlinear"]  # control.tracking
Integrator = Literal["auto", "midpoint", "rk4", "radau", "cvodes"]  # vehicle.integrators
Light = Literal["day", "low_sun", "night"]  # scenes.conditions
Isolation = Literal["auto", "none", "process"]  # simulation.policy_hosts
HostOption = Annotated[str, typer.Option(help="Address to listen at; 0.0.0.0 for other machines.")]
SessionsOption = Annotated[int, typer.Option(min=1, help="Most sessions at once.")]
IdleOption = Annotated[float, typer.Option(min=0.1, help="Seconds without a call after which a session is dropped.")]
IsolationOption = Annotated[
    Isolation, typer.Option(help="Where the policy runs; auto: a process of its own for all but the toolkit's own.")
]
PolicyTimeoutOption = Annotated[
    float | None, typer.Option(help="Seconds for one answer in a process of its own; 30 by default.")
]
PolicyMemoryOption = Annotated[
    float | None, typer.Option(help="GiB that it may allocate there; 8 by default, 0 for any.")
]


def check_picture(path: Path | None) -> None:
    """Refuse the name of a picture that cannot be drawn; None is no picture."""
    if path is not None and path.suffix not in (".png", ".svg", ".pdf"):
        raise typer.BadParameter(f"{path}: give a file ending in .png, .svg or .pdf")


def policy_limits(isolate: Isolation, timeout: float | None, memory: float | None) -> "PolicyLimits":
    """What the policy may take. Limits that are given ask for a process of its own."""
    from olt_closed_loop import PolicyLimits

    given = timeout is not None or memory is not None
    if given and isolate == "none":
        raise typer.BadParameter("--policy-timeout and --policy-memory hold in a process; leave out --isolate none")
    defaults = PolicyLimits()
    return PolicyLimits(
        isolate="process" if given else isolate,
        call_seconds=defaults.call_seconds if timeout is None else timeout,
        memory_bytes=defaults.memory_bytes if memory is None else round(memory * 2**30) or None,
    )
