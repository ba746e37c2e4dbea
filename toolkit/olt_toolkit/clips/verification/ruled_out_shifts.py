"""Which shifts in time a check that found none has ruled out, and whether that is enough to pass."""

from collections.abc import Mapping

from olt_toolkit.clips.verification.findings import Finding, Verdict, not_compared

COARSEST_PASSED = 0.3
"""Seconds that the four images of a sample span: a shift as long leaves none of them within its own sample."""


def judge_ruled_out(check: str, where: str, ruled_out: Mapping[float, bool], subject: str, otherwise: str) -> Finding:
    """Passed where all shifts are ruled out from `COARSEST_PASSED` or less on; else not compared.

    Args:
        check: name of the check.
        where: what it looked at.
        ruled_out: shifts in seconds, all above 0, that were tried, and whether each is ruled out both ways.
        subject: what is not shifted, as "the images were taken".
        otherwise: why nothing may be told where none is ruled out.

    Returns:
        The finding; `measured` is the smallest shift from which on all are ruled out.
    """
    finest = None
    for seconds in sorted(ruled_out, reverse=True):
        if not ruled_out[seconds]:
            break
        finest = seconds
    if finest is None:
        return not_compared(check, where, otherwise)
    longest = max(ruled_out)
    span = f"{finest:.1f} s" if finest == longest else f"{finest:.1f} to {longest:.1f} s"
    says = f"{subject} neither earlier nor later by {span}"
    if finest > COARSEST_PASSED:
        return not_compared(check, where, f"what is seen tells only that {says}, and nothing of shorter shifts")
    return Finding(check, where, Verdict.PASSED, says, finest, COARSEST_PASSED)
