"""How fast a path is driven: the paces that are tried along each. Toy only.

A pace is an acceleration for FIRST_SECONDS and another after that, down to a stand or up to a speed that is not
exceeded. Plans are made anew all the time, so what matters is what is done first, and that something safe can follow.
"""

import numpy as np

from olt_generator.poses import Array
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS

FIRST: Array = np.array([-7.0, -5.0, -3.0, -1.5, -0.7, 0.0, 0.7, 1.5])
SECOND: Array = np.array([-6.0, -3.0, -1.0, 0.0, 1.5])
"""Accelerations, m/s2."""
FIRST_SECONDS = 1.0
ACCELERATIONS: Array = np.stack([np.repeat(FIRST, len(SECOND)), np.tile(SECOND, len(FIRST))])
"""Those of each pace (2, paces), m/s2."""


def pace_ways(speed: float, most: float) -> tuple[Array, Array]:
    """Metres made and speeds in m/s, each (paces, 64), of all paces from a speed, which speed up to `most` m/s."""
    first = np.arange(FUTURE_STEPS) * STEP_SECONDS < FIRST_SECONDS
    rates = np.where(first, *ACCELERATIONS[..., None])
    speeds = np.empty((len(rates), FUTURE_STEPS + 1))
    speeds[:, 0] = speed
    for step, rate in enumerate(rates.T):
        now = speeds[:, step]
        faster = np.maximum(np.minimum(now + rate * STEP_SECONDS, most), now)
        speeds[:, step + 1] = np.where(rate > 0.0, faster, np.maximum(now + rate * STEP_SECONDS, 0.0))
    return np.cumsum(0.5 * STEP_SECONDS * (speeds[:, 1:] + speeds[:, :-1]), axis=1), speeds[:, 1:]
