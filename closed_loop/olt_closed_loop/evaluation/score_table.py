"""Scores of many rollouts put together: AS and CR by category and overall, with what they rest on.

AS is the mean scene score over rollouts, so that in the overall row a category weighs as much as it has valid rollouts:
the paper's Table 1 is averaged like that, not over its columns. CR is the share of valid rollouts in which the ego
touched anything, at fault or not. Intervals hold the true value in 95 of 100 repetitions if rollouts are independent;
rollouts of one scene are not quite. The distance between incidents is all that was driven over all incidents, as
AlpaSim has it, where an incident is a collision or leaving the road.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtrit

from olt_closed_loop.scoring.definitions import RolloutScore
from olt_generator.errors import InputError

OVERALL = "overall"
Interval = tuple[float, float]


@dataclass(frozen=True)
class ScoreRow:
    """One line of the table; None is "not measured".

    Attributes:
        category: long-tail category, or "overall".
        rollouts, valid: how many were driven, and how many of them could be scored.
        scenes: how many scenes they are of.
        seeds: which seeds they were driven with, in order.
        alpasim_score: AS, mean score of the valid rollouts.
        alpasim_score_interval: 95 % interval of AS (Student t, cut to 0..1); needs two different scores.
        collision_rate: CR, share of valid rollouts with any collision.
        collision_rate_interval: 95 % interval of CR (Wilson).
        rollout_incidents: what went wrong, counted over all rollouts (`rollouts.rollout.Incidents`).
        plan_deviation_max: the largest of all rollouts, metres: what no car can follow shows here, beside saturations.
        km_between_incidents, km_between_incidents_at_fault: driven by valid rollouts per incident; None without one.
    """

    category: str
    rollouts: int
    valid: int
    scenes: int
    seeds: tuple[int, ...]
    alpasim_score: float | None
    alpasim_score_interval: Interval | None
    collision_rate: float | None
    collision_rate_interval: Interval | None
    rollout_incidents: dict[str, int]
    plan_deviation_max: float | None
    km_between_incidents: float | None
    km_between_incidents_at_fault: float | None


@dataclass(frozen=True)
class ScoreTable:
    """One row per category in alphabetical order, then the overall row."""

    definition: str
    rows: tuple[ScoreRow, ...]

    @property
    def overall(self) -> ScoreRow:
        """The row over all rollouts."""
        return self.rows[-1]

    def to_dict(self) -> dict[str, Any]:
        """The table as JSON can hold it."""
        return {"definition": self.definition, "rows": [asdict(row) for row in self.rows]}


def summarize_scores(scores: Sequence[RolloutScore]) -> ScoreTable:
    """Put the scores of one policy together; those that are not valid are counted and hide no other.

    Raises:
        InputError: the scores are of two definitions.
    """
    definitions = sorted({score.definition for score in scores})
    if len(definitions) > 1:
        raise InputError(f"scores by {' and '.join(definitions)} cannot be averaged; use one definition")
    categories = sorted({score.category for score in scores})
    rows = [_row(category, [s for s in scores if s.category == category]) for category in categories]
    return ScoreTable(definitions[0] if definitions else "strict", (*rows, _row(OVERALL, scores)))


def _row(category: str, scores: Sequence[RolloutScore]) -> ScoreRow:
    scored = [score for score in scores if score.valid]
    values = np.array([score.score for score in scored])
    collided = sum(bool(score.collided) for score in scored)
    valid = len(scored)
    driven_km = 1e-3 * sum(score.distance_m or 0.0 for score in scored)
    incidents = sum(score.incidents or 0 for score in scored)
    at_fault = sum(score.incidents_at_fault or 0 for score in scored)
    rollout_incidents: Counter[str] = Counter()
    for score in scores:
        rollout_incidents.update(score.rollout_incidents or {})
    deviations = [score.plan_deviation_max for score in scores if score.plan_deviation_max is not None]
    return ScoreRow(
        category=category,
        rollouts=len(scores),
        valid=valid,
        scenes=len({score.scene for score in scores}),
        seeds=tuple(sorted({score.seed for score in scores if score.seed is not None})),
        alpasim_score=float(values.mean()) if valid else None,
        alpasim_score_interval=mean_interval(values),
        collision_rate=collided / valid if valid else None,
        collision_rate_interval=wilson_interval(collided, valid) if valid else None,
        rollout_incidents=dict(rollout_incidents),
        plan_deviation_max=max(deviations, default=None),
        km_between_incidents=driven_km / incidents if incidents else None,
        km_between_incidents_at_fault=driven_km / at_fault if at_fault else None,
    )


def mean_interval(values: np.ndarray) -> Interval | None:
    """95 % Student t interval of the mean of values (n,) in 0..1, cut to 0..1.

    None where all values are equal, or there is but one: they say nothing of the spread, and an interval of no width
    would claim a certainty that nobody measured.
    """
    if len(values) < 2 or np.ptp(values) == 0.0:
        return None
    spread = stdtrit(len(values) - 1, 0.975) * values.std(ddof=1) / np.sqrt(len(values))
    return max(float(values.mean() - spread), 0.0), min(float(values.mean() + spread), 1.0)


def wilson_interval(successes: int, count: int) -> Interval:
    """95 % interval of a share (Wilson, J. Am. Stat. Assoc. 22, 1927), count >= 1."""
    z = float(ndtri(0.975))
    share = successes / count
    centre = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * np.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    # At the ends the limits are exactly 0 and 1; rounding would leave a little.
    return float(centre - half) if successes else 0.0, float(centre + half) if successes < count else 1.0
