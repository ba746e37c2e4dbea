"""Trajectories as the tokens `<i0>` ... `<i3999>` of a language model (docs/formats/alpamayo.md).

Tokens 0 to 2,999 stand for future actions, tokens 3,000 to 3,999 for steps of the history. Indices count from the first
trajectory token; a real vocabulary adds the id of `<i0>`.
"""

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_toolkit.policy.action_space import ACTION_LIMIT
from olt_toolkit.policy.contract import FUTURE_STEPS, HISTORY_STEPS

Tokens = NDArray[np.int64]

FUTURE_BINS = 3000
HISTORY_BINS = 1000
VOCABULARY_SIZE = FUTURE_BINS + HISTORY_BINS
FUTURE_TOKENS = 2 * FUTURE_STEPS
HISTORY_TOKENS = 3 * HISTORY_STEPS

# Metres in x, y and z; the range is symmetric.
STEP_LIMITS = np.array([4.0, 4.0, 10.0])


def encode_actions(actions: Array) -> tuple[Tokens, int]:
    """Tokens (..., 128) of normalised actions (..., 64, 2), in the order a0, k0, a1, k1, ...

    Returns:
        The tokens, and how many of them are saturated: the end of the range in place of a value beyond it.
    """
    scaled = (np.asarray(actions, dtype=np.float64) + ACTION_LIMIT) / (2.0 * ACTION_LIMIT)
    tokens, saturated = _quantise(scaled, FUTURE_BINS)
    return tokens.reshape(*tokens.shape[:-2], -1), saturated


def decode_actions(tokens: Tokens) -> Array:
    """Normalised actions (..., 64, 2) of future tokens (..., 128)."""
    scaled = np.asarray(tokens) / (FUTURE_BINS - 1)
    actions = scaled * 2.0 * ACTION_LIMIT - ACTION_LIMIT
    return actions.reshape(*actions.shape[:-1], -1, 2)


def encode_history(history_xyz: Array) -> Tokens:
    """Tokens (..., 48) of a history (..., 16, 3) in metres in the rig frame at t0, in the order dx0, dy0, dz0, dx1, ...

    The first step leads from the origin, where the history ends, to its oldest point: above 2.7 m/s its dx is cut off
    at token 3,000. That is how the released model was trained.
    """
    history_xyz = np.asarray(history_xyz, dtype=np.float64)
    steps = np.diff(history_xyz, axis=-2, prepend=0.0)
    tokens, _ = _quantise((steps + STEP_LIMITS) / (2.0 * STEP_LIMITS), HISTORY_BINS)
    return FUTURE_BINS + tokens.reshape(*tokens.shape[:-2], -1)


def _quantise(scaled: Array, bins: int) -> tuple[Tokens, int]:
    """Nearest of `bins` values spread evenly over 0 to 1 (halves go to the even one), and how many were cut off."""
    index = np.rint(scaled * (bins - 1)).astype(np.int64)
    kept = np.clip(index, 0, bins - 1)
    return kept, int(np.count_nonzero(index != kept))
