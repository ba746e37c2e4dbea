"""How far the futures of a clip are from what the policy's actions can express, sample by sample."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.policy.action_space import ROUND_TRIP_TOLERANCE, round_trip_errors
from olt_toolkit.rigs.contracts import widest_contract
from olt_toolkit.rigs.names import ContractName

# Micrometres: beyond them the numbers are those of the machine's arithmetic.
_DIGITS = 6


def measure_action_errors(motion: EgoMotion, t0_us: Sequence[int], cameras: Collection[str]) -> tuple[float, ...]:
    """For each time t0 of a motion that covers it, the `round_trip_errors` of its future in metres.

    They are those of the policy with the most cameras of those that the clip's `cameras` are enough for.

    Raises:
        InputError: a history or a future lies outside the motion.
    """
    if not len(t0_us):
        return ()
    history, future = motion.around(np.asarray(t0_us, np.int64))
    policy = ContractName(widest_contract(cameras).name)
    poses = (history[..., :3, 3], history[..., :3, :3], future[..., :3, 3], future[..., :3, :3])
    errors = round_trip_errors(*poses, policy)
    return tuple(errors.round(_DIGITS).tolist())


def summarize_action_errors(errors: Sequence[float] | None) -> dict[str, Any] | None:
    """Median and worst in metres, and how many samples are beyond the tolerance; None where none was measured."""
    if not errors:
        return None
    return {
        "samples": len(errors),
        "median_m": float(np.median(errors)),
        "worst_m": max(errors),
        "tolerance_m": ROUND_TRIP_TOLERANCE,
        "beyond_tolerance": sum(error > ROUND_TRIP_TOLERANCE for error in errors),
    }
