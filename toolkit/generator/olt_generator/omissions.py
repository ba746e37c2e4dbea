"""What was left out of a computation: kept as data, worded once, where somebody reads it."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, order=True)
class Omission:
    """Something that was not computed because nothing that was asked for needs it.

    Attributes:
        what: what was left out, as a noun: "camera images", "frames of each view".
        why: the reason, as a clause: "the policy looks at none".
        count: how many of `what` were left out; None where it is not countable or all of it was.
        total: how many there would have been.
        seconds: run time that this is known to have saved; None where it was not measured.
    """

    what: str
    why: str
    count: int | None = None
    total: int | None = None
    seconds: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """The record as JSON can hold it; what is not known is None."""
        return asdict(self)


def word_omission(omission: Omission) -> str:
    """One line for people: "30 of 41 frames of each view: no sample shows them"."""
    amount = "" if omission.count is None else f"{omission.count} "
    if omission.count is not None and omission.total is not None:
        amount = f"{omission.count} of {omission.total} "
    saved = "" if omission.seconds is None else f" ({omission.seconds:.3g} s saved)"
    return f"{amount}{omission.what}: {omission.why}{saved}"
