"""Who has stood for long takes more of a risk to get on. Toy only.

A sight that is unsure says the same again and again, and whoever stands waits for ever for what it takes for somebody.
"""

from olt_sft_recipes.toy.plan_choice import MOVING, WAY_WORTH

AT_ONCE, DOUBLES, MOST = 1.0, 2.0, 10.0
"""Seconds of standing that change nothing, those after which the way is worth twice as much, and at most how often."""


class Patience:
    """What the way is worth through one rollout (`plan_choice.choose_plan`)."""

    def __init__(self) -> None:
        self._moved_us: int | None = None

    def way_worth(self, time_us: int, speed: float) -> float:
        """What the way is worth at a time, no earlier than that asked before, and a speed in m/s."""
        if self._moved_us is None or speed > MOVING:
            self._moved_us = time_us
        waited = 1e-6 * (time_us - self._moved_us) - AT_ONCE
        return WAY_WORTH * min(1.0 + max(waited, 0.0) / DOUBLES, MOST)
