"""Names that command lines take, in a module that loads nothing."""

from enum import StrEnum


class PolicyName(StrEnum):
    """Policies whose training can be looked at."""

    TOY = "toy"
    ALPAMAYO_R1 = "alpamayo-r1"
    ALPAMAYO_1_5 = "alpamayo-1.5"
    ALPAMAYO_2 = "alpamayo-2"


class StageChoice(StrEnum):
    """Which stages run."""

    FIRST = "1"
    SECOND = "2"
    BOTH = "both"
