"""How much better another hypothesis explains what a camera shows than what the clip says does.

Points of one image move together, and images of one second show the same things: single points and steps are no
independent witnesses. So gains are taken over stretches of the clip, and a hypothesis is believed, or ruled out, where
nearly all of the stretches that tell anything say the same and all steps together say it clearly.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from olt_generator.poses import Array
from olt_toolkit.clips.verification.image_steps import ImageSteps

# A clip is taken apart into so many stretches of equal time; fewer than this must tell something.
STRETCHES = 16
LEAST_TELLING = 3
# A stretch tells something where its gain is at least this share of the largest.
TELLING_SHARE = 0.1
# Points of a step that count as independent, and the evidence (nats) from which on it is clear.
INDEPENDENT_POINTS = 10.0
CLEAR = 15.0
# How much of all gains and losses must point the same way: their sum over the sum of their sizes.
AGREEMENT = 0.75


# A step with fewer points tells nothing.
LEAST_POINTS = 8
# A point speaks for or against a hypothesis from so many nats on, and of those that speak at most this share may speak
# against one that is believed: things that move by themselves fill a picture, but hardly ever leave nothing else.
CLEAR_POINT, MOST_DEFENDED = 1.0, 0.2


@dataclass(frozen=True)
class Gain:
    """The gain of a hypothesis over what the clip says.

    Attributes:
        mean: nats a point, over the stretches that tell something; 0 where none does.
        evidence: nats of all steps together.
        agreement: -1 to 1, how far the stretches point the same way.
        telling: stretches that tell something.
        against: share of the points against the hypothesis, of those that speak for or against it; NaN without any.
    """

    mean: float
    evidence: float
    agreement: float
    telling: int
    against: float

    def wins(self, least: float, clear: float = CLEAR) -> bool:
        """Whether the hypothesis explains the images better: by so many nats a point and `clear` nats in all."""
        return (
            self.telling >= LEAST_TELLING
            and self.mean > least
            and self.evidence > clear
            and self.agreement > AGREEMENT
            and not self.against > MOST_DEFENDED
        )

    def loses(self, least: float) -> bool:
        """Whether what the clip says explains the images better, by at least so many nats a point."""
        return self.mean < -least and self.evidence < -CLEAR and self.agreement < -AGREEMENT


NOTHING = Gain(0.0, 0.0, 0.0, 0, float("nan"))


def stretch_gains(steps: ImageSteps, said: Array, other: Array) -> Array:
    """Gains (STRETCHES, 4) of a hypothesis by stretch, from log-likelihoods (n,) of points.

    Returns:
        Mean in nats a point, number of steps, and shares of points that speak for and against it; NaN without steps.
    """
    times_us = steps.images.times_us
    middle = 0.5 * (times_us[steps.first] + times_us[steps.second])
    place = np.minimum((middle - times_us[0]) / max(int(times_us[-1] - times_us[0]), 1) * STRETCHES, STRETCHES - 1)
    point = other - said
    columns = [point, point > CLEAR_POINT, point < -CLEAR_POINT]
    points = np.bincount(steps.step, minlength=len(steps.first))
    totals = [np.bincount(steps.step, column, minlength=len(steps.first)) for column in columns]
    by_step = np.stack(totals, axis=1) / np.maximum(points, 1)[:, None]
    known = (points >= LEAST_POINTS) & np.isfinite(by_step[:, 0])
    stretch = place[known].astype(int)
    count = np.bincount(stretch, minlength=STRETCHES)
    sums = np.stack([np.bincount(stretch, column, minlength=STRETCHES) for column in by_step[known].T], axis=1)
    means = np.where(count[:, None] > 0, sums / np.maximum(count, 1)[:, None], np.nan)
    return np.concatenate([means[:, :1], count[:, None].astype(np.float64), means[:, 1:]], axis=1)


def sum_up(gains: Array) -> Gain:
    """The gain over all stretches, from the gains (STRETCHES, 4) of each."""
    means, counts, supports, opposes = gains[np.isfinite(gains[:, 0])].T
    size = np.abs(means)
    telling = size > TELLING_SHARE * size.max(initial=0.0)
    if not telling.any():
        return NOTHING
    weighted = means * counts
    speaking = float(np.sum(counts * (supports + opposes)))
    return Gain(
        float(np.average(means[telling], weights=counts[telling])),
        float(INDEPENDENT_POINTS * weighted.sum()),
        float(weighted.sum() / np.abs(weighted).sum()),
        int(telling.sum()),
        float(np.sum(counts * opposes)) / speaking if speaking > 0.0 else float("nan"),
    )


def over_cameras(gains: Sequence[Array]) -> Array:
    """Gains (STRETCHES, 4) that hold for cameras together: the medians, which a single faulty camera does not move."""
    return _combine(gains, np.nanmedian)


def average(gains: Sequence[Array]) -> Array:
    """Mean gains (STRETCHES, 4) of several cameras that would all be at fault."""
    return _combine(gains, np.nanmean)


def _combine(gains: Sequence[Array], statistic: Callable[..., Array]) -> Array:
    stacked = np.stack(gains)
    known = np.isfinite(stacked[..., 0]).any(axis=0)
    joint = np.full(stacked.shape[1:], np.nan)
    joint[known] = statistic(stacked[:, known], axis=0)
    joint[:, 1] = stacked[..., 1].max(axis=0)
    return joint
