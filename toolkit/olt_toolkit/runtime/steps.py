"""Named steps of long work: how long each took, and how far the whole is."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from olt_generator.progress import Progress, silent

OnStep = Callable[[str], None]
"""Called with the name of a step when it starts."""


def unnoticed(step: str) -> None:
    """Notice no step."""


class Steps:
    """Times steps and maps the progress of each to that of the whole.

    `shares` are those of the whole that each step is expected to take, in order; they are scaled to sum to 1.
    """

    def __init__(
        self, shares: Mapping[str, float], on_progress: Progress = silent, on_step: OnStep = unnoticed
    ) -> None:
        self.seconds: dict[str, float] = {}
        self._shares = {name: share / sum(shares.values()) for name, share in shares.items()}
        self._done = 0.0
        self._on_progress, self._on_step = on_progress, on_step

    @contextmanager
    def step(self, name: str) -> Iterator[Progress]:
        """Time one step; yields the callback that takes its own progress."""
        self._on_step(name)
        start, share = self._done, self._shares[name]
        began = time.perf_counter()
        yield lambda part: self._on_progress(start + share * part)
        self.seconds[name] = time.perf_counter() - began
        self._done = start + share
        self._on_progress(self._done)
