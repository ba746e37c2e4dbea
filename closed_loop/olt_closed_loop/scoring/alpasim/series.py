"""Values of one metric over time, and how they fold into one number."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array

Fold = Literal["max", "min", "mean", "last"]


class UnmeasuredError(Exception):
    """A metric cannot be had from this drive; the message says why."""


@dataclass(frozen=True)
class MetricSeries:
    """Values (n,) at times (n,); NaN is an invalid value, which no fold looks at."""

    times_us: NDArray[np.int64]
    values: Array
    fold: Fold

    def folded(self) -> float | None:
        """All valid values as one; None when there is none."""
        valid = self.values[~np.isnan(self.values)]
        if len(valid) == 0:
            return None
        folds = {"max": np.max, "min": np.min, "mean": np.mean, "last": lambda values: values[-1]}
        return float(folds[self.fold](valid))

    def within(self, start_us: int, end_us: int) -> "MetricSeries":
        """The values from `start_us` to `end_us`, both included."""
        kept = (self.times_us >= start_us) & (self.times_us <= end_us)
        return MetricSeries(self.times_us[kept], self.values[kept], self.fold)
