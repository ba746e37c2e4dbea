"""Solvers of the flow from noise (time 0) to actions (time 1): one, two or two evaluations a step.

Euler, explicit midpoint and Heun (Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", II.1); errors
fall with the step, and with its square for the other two, where the velocity is smooth.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from torch import Tensor

Velocity = Callable[["Tensor", "Tensor", Any], "Tensor"]


class Solver(NamedTuple):
    """A method with so many equal steps, whose step costs so many evaluations of the velocity."""

    method: str
    steps: int

    @property
    def evaluations(self) -> int:
        """Of the velocity, in all."""
        return self.steps * (1 if self.method == "euler" else 2)

    def __str__(self) -> str:
        return f"{self.method} {self.steps}"


SOLVERS: Sequence[Solver] = (
    *(Solver("euler", steps) for steps in (1, 2, 4, 10, 20)),
    *(Solver("midpoint", steps) for steps in (1, 2, 5, 10)),
    *(Solver("heun", steps) for steps in (1, 2, 5, 10)),
)
REFERENCE, COARSER = Solver("heun", 250), Solver("heun", 125)
"""What solvers are held against, and half its steps: how far these are apart is the reference's own doubt.

The toy is told the time by waves of up to 100 periods, so its velocity is smooth on no longer scale than 0.01.
"""


def integrate(velocity: Velocity, solver: Solver, noise: "Tensor", condition: Any) -> "Tensor":
    """Carry noise (n, 64, 2) to actions (n, 64, 2) along the velocity, which is asked with times (n,)."""
    import torch

    x, step = noise, 1.0 / solver.steps
    for number in range(solver.steps):
        start = torch.full((len(x),), number * step, dtype=x.dtype)
        first = velocity(x, start, condition)
        if solver.method == "euler":
            x = x + step * first
        elif solver.method == "midpoint":
            x = x + step * velocity(x + 0.5 * step * first, start + 0.5 * step, condition)
        else:
            x = x + 0.5 * step * (first + velocity(x + step * first, start + step, condition))
    return x
