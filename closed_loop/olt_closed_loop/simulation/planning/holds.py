"""Which lines a scene holds, and when: red lights, and people whose hands stop traffic."""

import numpy as np

from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.planning.truth import Hold


def holds_of(scene: Scene) -> tuple[Hold, ...]:
    """The held lines."""
    return ()
