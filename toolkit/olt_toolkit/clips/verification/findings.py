"""What a check says: passed, failed, or not compared and why."""

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
