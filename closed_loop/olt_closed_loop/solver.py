"""What a solver of the tracking problem is asked, and how it says that it has no answer."""

from typing import Protocol

from olt_generator.poses import Array


class SolveFailed(Exception):
    """No commands were found; the message says why."""


class Solver(Protocol):
    """Finds the commands of the horizon."""

    def solve(self, start: Array, controls: Array, target: Array) -> Array:
        """Commands (horizon, 2) within the vehicle's limits.

        Args:
            start: (states,) of the vehicle in its own rig frame.
            controls: (horizon, 2) first guess, within the limits.
            target: (horizon, 3) poses x, y, yaw at the ends of the steps, in the same frame.

        Raises:
            SolveFailed: there is no solution, or not within the solver's iterations.
        """
        ...
