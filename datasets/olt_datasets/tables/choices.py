"""What users choose by name when they index, split and build clips; commands load it, so it imports nothing heavy."""

from enum import StrEnum

PAPER_FRAMES = 41
PAPER_STRIDE = 42


class SampleChoice(StrEnum):
    """Which of the times t0 that a window can give are taken."""

    EVERY = "every"
    KEYFRAME = "keyframe"
    EVENTS = "events"


class SplitRule(StrEnum):
    """How clips come into splits; see `tables.splits`."""

    SEEN = "seen"
    UNSEEN = "unseen"
    EXTERNAL = "external"
    OWN = "own"


class BuiltKind(StrEnum):
    """What an indexed clip is built as: with true views of all policy cameras, or with synthesized ones."""

    GT = "GT"
    SYN = "Syn"
