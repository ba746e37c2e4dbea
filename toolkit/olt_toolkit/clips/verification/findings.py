"""What a check says: passed, failed, or not compared and why."""

import math
from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """What became of a check; one that could not look is never one that passed."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_COMPARED = "not compared"


@dataclass(frozen=True)
class Finding:
    """What one check says of one thing.

    Attributes:
        check: name of the check, such as "tele inside front".
        where: what it looked at: file, clip, camera or frame, as precisely as it can be told.
        detail: for people, in a sentence: what was found or why nothing could be compared, and what to do about it.
        measured, limit: the number that was measured and the one from which on it fails, in the unit that `detail`
            names; None where the check is no measurement or could not be made.
    """

    check: str
    where: str
    verdict: Verdict
    detail: str
    measured: float | None = None
    limit: float | None = None


def judge(check: str, where: str, measured: float, limit: float, detail: str) -> Finding:
    """A measurement that fails beyond its limit, and where it is no number; `detail` names it, its unit and advice."""
    if not math.isfinite(measured):
        return Finding(check, where, Verdict.FAILED, f"{detail} (what was measured is no number)", None, limit)
    verdict = Verdict.PASSED if measured <= limit else Verdict.FAILED
    return Finding(check, where, verdict, detail, measured, limit)


def not_compared(check: str, where: str, why: str) -> Finding:
    """A check that could not be made, with the reason."""
    return Finding(check, where, Verdict.NOT_COMPARED, why)


def state(check: str, where: str, holds: bool, detail: str) -> Finding:
    """A check that measures nothing: it holds or it does not."""
    return Finding(check, where, Verdict.PASSED if holds else Verdict.FAILED, detail)
