"""What a solver of the tracking problem is asked, what it answers, and how it says that it has no answer."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from olt_generator.poses import Array


class SolveFailed(Exception):
    """No commands were found; the message says why.

    Attributes:
        given_up: as of `Solution`.
    """

    def __init__(self, reason: str, given_up: bool = False) -> None:
        super().__init__(reason)
        self.given_up = given_up


class Solution(NamedTuple):
    """What a solver found.

    Attributes:
        commands: (horizon, 2) within the vehicle's limits.
        given_up: whether the solver's own iteration gave up and its fallback found them.
    """

    commands: Array
    given_up: bool = False


class Solver(Protocol):
    """Finds the commands of the horizon."""

    def solve(self, start: Array, guesses: Sequence[Array], target: Array) -> Solution:
        """The commands that a vehicle at `start` should be given.

        Args:
            start: (states,) of the vehicle in its own rig frame.
            guesses: commands (horizon, 2) within the limits; the solver starts from those of the lowest cost.
            target: (horizon, 3) poses x, y, yaw at the ends of the steps, in the same frame.

        Raises:
            SolveFailed: there is no solution, or not within the solver's iterations.
        """
        ...
