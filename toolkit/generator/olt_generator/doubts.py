"""Reasons not to trust a result that was given all the same."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Doubt:
    """One reason.

    Attributes:
        what: name of what is in doubt, the same in every clip: "direction", "speed", "view direction", ...
        why: what disagreed or was missing, with its numbers, in a sentence.
    """

    what: str
    why: str
