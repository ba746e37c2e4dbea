"""Names that command lines take, in a module that loads nothing."""

from enum import StrEnum


class ContractName(StrEnum):
    """Camera contracts by name (`olt_toolkit.rigs.contracts`)."""

    ALPAMAYO_R1 = "alpamayo-r1"
    ALPAMAYO_1_5 = "alpamayo-1.5"
    ALPAMAYO_2 = "alpamayo-2"


class FrontLens(StrEnum):
    """With which lens the front-wide view of a clip is made (`olt_toolkit.clips.front`)."""

    AS_NAMED = "as-named"
    AS_IS = "as-is"


class Backend(StrEnum):
    """What makes the views that no camera recorded (`olt_toolkit.clips.backends`)."""

    GEOMETRIC = "geometric"
    WAN_VACE = "wan-vace"


class MotionLabels(StrEnum):
    """How motion that a data set measured becomes the labels of a clip (`olt_toolkit.clips.given_motion`)."""

    AS_MEASURED = "as-measured"
    SMOOTHED = "smoothed"
