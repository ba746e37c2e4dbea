"""Scores of many rollouts put together: AS and CR by category and overall, with what they rest on.

AS is the mean scene score over rollouts, so that in the overall row a category weighs as much as it has valid rollouts:
the paper's Table 1 is averaged like that, not over its columns. CR is the share of valid rollouts in which the ego
touched anything, at fault or not. The distance between incidents is all that was driven over all incidents, as AlpaSim
has it for one rollout a scene, where an incident is a collision or leaving the road. By AlpaSim's definitions a rollout
ends at its first incident, so it counts one at most.

Intervals hold the true value in 95 of 100 repetitions with other scenes of the same kind. Rollouts of one scene
resemble each other, and those of a policy that draws nothing at random are the same drive twice: they narrow none.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, ndtr, ndtri, stdtrit

from olt_closed_loop.scoring.definitions import RolloutScore
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.seeds import make_generator

OVERALL = "overall"
RESAMPLES = 10_000
_AT_ONCE = 500
_ROUNDING = 1e-12
Interval = tuple[float, float]
OpenInterval = tuple[float, float | None]
"""An interval that has no upper end where that is None."""


@dataclass(frozen=True)
class ScoreRow:
    """One line of the table; None is "not measured".

    Attributes:
        category: long-tail category, or "overall".
        rollouts, valid: how many were driven, and how many of them could be scored.
        failed: how many broke off.
        scenes: how many scenes they are of.
        seeds: which seeds they were driven with, in order.
        alpasim_score: AS, mean score of the valid rollouts, and by `alpasim@challenge-2026-09` of the failed ones as 0.
        alpasim_score_interval: 95 % interval of AS (Student t over scenes, cut to 0..1); needs two scenes that differ.
        collision_rate: CR, share of valid rollouts with any collision.
        collision_rate_interval: 95 % interval of CR (Wilson, for as many rollouts as the scenes are worth).
        rollout_incidents: what went wrong, counted over all rollouts (`rollouts.rollout.Incidents`).
        plan_deviation_max: the largest of all rollouts, metres: what no car can follow shows here, beside saturations.
        driven_km: driven by valid rollouts.
        incidents, incidents_at_fault: in them.
        km_between_incidents, km_between_incidents_at_fault: the ratio of both; None without an incident.
        km_between_incidents_interval, km_between_incidents_at_fault_interval: their 95 % intervals
            (`distance_interval`), without an incident of what it is at least.
    """

    category: str
    rollouts: int
    valid: int
    failed: int
    scenes: int
    seeds: tuple[int, ...]
    alpasim_score: float | None
    alpasim_score_interval: Interval | None
    collision_rate: float | None
    collision_rate_interval: Interval | None
    rollout_incidents: dict[str, int]
    plan_deviation_max: float | None
    driven_km: float
    incidents: int
    incidents_at_fault: int
    km_between_incidents: float | None
    km_between_incidents_interval: OpenInterval | None
    km_between_incidents_at_fault: float | None
    km_between_incidents_at_fault_interval: OpenInterval | None


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
    counted = [score for score in scores if score.score is not None]
    values = np.array([score.score for score in counted], dtype=np.float64)
    collided = np.array([bool(score.collided) for score in scored], dtype=np.float64)
    driven = np.array([1e-3 * (score.distance_m or 0.0) for score in scored])
    incidents, at_fault = (
        np.array([getattr(score, name) or 0 for score in scored], dtype=np.int64)
        for name in ("incidents", "incidents_at_fault")
    )
    scenes = [score.scene for score in scored]
    rollout_incidents: Counter[str] = Counter()
    for score in scores:
        rollout_incidents.update(score.rollout_incidents or {})
    deviations = [score.plan_deviation_max for score in scores if score.plan_deviation_max is not None]
    return ScoreRow(
        category=category,
        rollouts=len(scores),
        valid=len(scored),
        failed=sum(score.failed for score in scores),
        scenes=len({score.scene for score in scores}),
        seeds=tuple(sorted({score.seed for score in scores if score.seed is not None})),
        alpasim_score=float(values.mean()) if counted else None,
        alpasim_score_interval=mean_interval(values, [score.scene for score in counted]),
        collision_rate=float(collided.mean()) if scored else None,
        collision_rate_interval=share_interval(collided, scenes) if scored else None,
        rollout_incidents=dict(rollout_incidents),
        plan_deviation_max=max(deviations, default=None),
        driven_km=float(driven.sum()),
        incidents=int(incidents.sum()),
        incidents_at_fault=int(at_fault.sum()),
        km_between_incidents=_ratio(driven, incidents),
        km_between_incidents_interval=distance_interval(driven, incidents, scenes),
        km_between_incidents_at_fault=_ratio(driven, at_fault),
        km_between_incidents_at_fault_interval=distance_interval(driven, at_fault, scenes),
    )


def mean_interval(values: Array, groups: Sequence[str] | None = None) -> Interval | None:
    """95 % Student t interval of the mean of values (n,) in 0..1 of independent groups, cut to 0..1.

    Without `groups` each value is one of its own. None where the groups do not differ, or there is but one: they say
    nothing of the spread, and an interval of no width would claim a certainty that nobody measured.
    """
    count, variance = _mean_variance(values, groups)
    if variance == 0.0:
        return None
    spread = stdtrit(count - 1, 0.975) * np.sqrt(variance)
    return max(float(values.mean() - spread), 0.0), min(float(values.mean() + spread), 1.0)


def share_interval(hits: Array, groups: Sequence[str]) -> Interval:
    """95 % interval of the share of hits (n,), 0 or 1, of independent groups; n >= 1.

    It is Wilson's for as many hits as would vary as much (Korn and Graubard, Surv. Methodol. 24, 1998), and for one
    each group where the share is 0 or 1.
    """
    share = float(hits.mean())
    count, variance = _mean_variance(hits, groups)
    if variance > 0.0:
        count = min(share * (1.0 - share) / variance, len(hits))
    return wilson_interval(share * count, count)


def _mean_variance(values: Array, groups: Sequence[str] | None) -> tuple[int, float]:
    """How many groups, and the variance of the mean of values (n,) that their differences show; 0 for one group."""
    _, group = np.unique(np.arange(len(values)) if groups is None else np.array(groups), return_inverse=True)
    count = int(group.max(initial=-1)) + 1
    if count < 2:
        return count, 0.0
    residuals = np.bincount(group, values - values.mean()) / len(values)
    # Where all are equal, what rounding leaves is no difference.
    return count, float(count / (count - 1) * (residuals**2).sum()) if np.abs(residuals).max() > _ROUNDING else 0.0


def wilson_interval(successes: float, count: float) -> Interval:
    """95 % interval of a share (Wilson, J. Am. Stat. Assoc. 22, 1927), count > 0."""
    z = float(ndtri(0.975))
    share = successes / count
    centre = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * np.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    # At the ends the limits are exactly 0 and 1; rounding would leave a little.
    return float(centre - half) if successes else 0.0, float(centre + half) if successes < count else 1.0


def distance_interval(driven: Array, incidents: NDArray[np.int64], groups: Sequence[str]) -> OpenInterval | None:
    """95 % interval of distances driven (n,) per incident (n,), of independent groups, in the unit of the distances.

    The groups are drawn anew (`bootstrap_interval`); draws without any incident leave it open above. Where there is no
    incident at all it is from what a steady rate would give in 39 of 40 repetitions (Garwood, Biometrika 28, 1936).
    None with one group, or where nothing was driven.
    """
    if driven.sum() <= 0.0:
        return None
    if not incidents.any():
        return float(driven.sum() / gammaincinv(1.0, 0.975)), None
    _, group = np.unique(np.array(groups), return_inverse=True)
    interval = bootstrap_interval(
        np.column_stack([np.bincount(group, incidents), np.bincount(group, driven)]).astype(np.float64)
    )
    if interval is None:
        return None
    fewest, most = interval
    return 1.0 / most, 1.0 / fewest if fewest > 0.0 else None


def bootstrap_interval(pairs: Array, *names: str) -> Interval | None:
    """95 % interval of sum(first) / sum(second) over pairs (n, 2), by drawing them anew; the same for the same names.

    Percentiles of the bootstrap are too narrow for few pairs; these are farther out, so that the interval is as wide as
    Student's (Hesterberg, Am. Stat. 69, 2015, the "expanded percentile" interval). None where all ratios are equal or
    there is but one: they say nothing of the spread.
    """
    count = len(pairs)
    ratio = pairs[:, 0].sum() / pairs[:, 1].sum()
    if count < 2 or np.allclose(pairs[:, 0], ratio * pairs[:, 1], rtol=0.0, atol=_ROUNDING):
        return None
    generator = make_generator("bootstrap", *names)
    blocks = (
        pairs[generator.integers(count, size=(_AT_ONCE, count))].sum(axis=1) for _ in range(RESAMPLES // _AT_ONCE)
    )
    ratios = np.concatenate([block[:, 0] / block[:, 1] for block in blocks])
    tail = ndtr(-np.sqrt(count / (count - 1)) * stdtrit(count - 1, 0.975))
    low, high = np.quantile(ratios, (tail, 1.0 - tail))
    return float(low), float(high)


def _ratio(driven: Array, incidents: NDArray[np.int64]) -> float | None:
    return float(driven.sum() / incidents.sum()) if incidents.any() else None
