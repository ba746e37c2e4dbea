"""How alike two near-duplicates are."""

from dataclasses import dataclass

_SAME_TIME_S = 0.05


@dataclass(frozen=True)
class Match:
    """How alike a clip and its like clip are.

    Attributes:
        score: of the alignment (`thumbnail_alignment.Likeness.score`): up to 1.25, for the same images.
        lag_s: how many seconds later the second clip shows what the first shows, in the middle of what both show; times
            are those since the first image of each that tells something.
        mirrored: whether one is the mirror image of the other.
    """

    score: float
    lag_s: float
    mirrored: bool

    def __str__(self) -> str:
        lag = f"{abs(self.lag_s):.1f} s {'later' if self.lag_s > 0.0 else 'earlier'}"
        when = lag if abs(self.lag_s) >= _SAME_TIME_S else "at the same times"
        return f"score {self.score:.2f} of 1.25, {when}{', mirrored' if self.mirrored else ''}"
